//! Looks against directions drawn without them.

use super::*;
use crate::film::Sample;
use crate::flat::{self, LightShape, PreviewSurface, RenderSettings};
use crate::integrator::manifold::tests::ball_of;
use crate::math::Rgb;
use crate::medium::phase_eval;
use crate::sampling::direction_about;
use crate::subsurface::walk::Role;

/// Sum and sum of squares.
#[derive(Default)]
struct Sums {
    n: f64,
    moments: [f64; 2],
}

impl Sums {
    fn add(&mut self, x: f32) {
        let x = f64::from(x);
        self.n += 1.0;
        self.moments = [self.moments[0] + x, self.moments[1] + x * x];
    }

    /// Mean and its variance.
    fn mean(&self) -> (f64, f64) {
        let [mean, square] = self.moments.map(|moment| moment / self.n);
        (mean, (square - mean * mean) / self.n)
    }
}

fn at(shape: LightShape, p: [f64; 3]) -> flat::Light {
    let mut light = flat::Light { shape, ..flat::Light::default() };
    light.transform[3][..3].copy_from_slice(&p);
    light
}

/// A collision by itself, and one light.
struct Bench<'a> {
    to: CollisionLight<'a>,
    rough: Rough<'a>,
    enclosure: InstanceEnclosure<'a>,
    x: Vec3,
    g: f32,
}

impl Bench<'_> {
    /// Before it, light went along -z.
    fn phase(&self, d: Vec3) -> f32 {
        phase_eval(self.g, d.dot(Vec3::NEG_Z))
    }

    /// What looks bring.
    fn looks(&self, count: usize, sampler: &mut Sampler) -> Sums {
        let mut sums = Sums::default();
        let scatter = |d: Vec3| (self.phase(d), f32::NAN);
        let collision = Collision { p: self.x, weight: Rgb::ONE, walked: None, role: Role::Own, scatter: &scatter };
        for _ in 0..count {
            let mut sample = Sample::BLACK;
            let mut into = Into::new(&mut sample, &mut [], &mut []);
            if let Some(glance) = self.rough.glance(&self.to, &self.enclosure, self.x, sampler, &mut into) {
                self.rough.look(&self.to, &glance, &collision, &self.enclosure, sampler, &mut into);
            }
            sums.add(mean(sample.subsurface));
        }
        sums
    }

    /// What directions bring that are drawn around `axis` or anywhere else, in all and as far as MIS leaves it to looks.
    fn chance(&self, axis: Vec3, count: usize, sampler: &mut Sampler) -> [Sums; 2] {
        const SPAN: f32 = 0.2; // 1 - cos
        const WITHIN: f32 = 0.95;
        let mut sums = [Sums::default(), Sums::default()];
        for _ in 0..count {
            let (from, span, share) =
                if sampler.random() < WITHIN { (0.0, SPAN, WITHIN) } else { (SPAN, 2.0 - SPAN, 1.0 - WITHIN) };
            let d = direction_about(axis, from + span * sampler.random(), sampler.random());
            let (light, weight) = self.met(d, Vec2::new(sampler.random(), sampler.random()));
            let light = light * (self.phase(d) * 2.0 * PI * span / share);
            sums[0].add(light);
            sums[1].add(light * (1.0 - weight));
        }
        sums
    }

    /// Light sampled with the numbers `u` where `d` leads to, and its MIS weight.
    fn met(&self, d: Vec3, u: Vec2) -> (f32, f32) {
        let Self { to, rough, enclosure, x, .. } = self;
        let (t, hit) = enclosure.cast(*x, d, f32::INFINITY, None).expect("closed");
        let exit = to.scene.interaction(&enclosure.surface_hit(&hit), d, Side::Inside);
        let bsdf = rough.surface.bsdf_beside(exit.local(exit.wo), Side::Inside, rough.beside);
        let lights = to.scene.lights_for(0);
        let choice = rough.guide.choice(rough.guide.exit_choice(0, enclosure.point(&hit), exit.ng));
        let samples = lights.choice_probability(0, exit.p, exit.horizon(), choice);
        let Some(sample) = lights.sample_light(0, exit.p, exit.horizon(), u) else { return (0.0, 1.0) };
        let counted = LightSample { pdf: sample.pdf * samples, ..sample };
        let Some(arriving) = arriving(to.scene, &exit, &bsdf, None, to.around, &counted) else { return (0.0, 1.0) };
        let from = CameFrom { rough, enclosure, instance: 0, entry: to.entry, x: *x, d, t };
        let light = samples * mean(rough.medium.transmittance(t) * arriving.light);
        (light, from.weight(to.scene, &sample, u))
    }
}

/// Looks bring what MIS leaves to them: so they have the density that both sides say they have.
#[test]
fn looks_have_their_density() {
    const COUNT: usize = 1_000_000;
    let sun = || at(LightShape::Distant { angle: 3.0 }, [0.0; 3]);
    let ball = || at(LightShape::Sphere { radius: 0.2 }, [1.0, 1.5, 3.0]);
    let rect = || at(LightShape::Rect { width: 0.4, height: 0.3, texture: String::new() }, [0.5, 0.0, 4.0]);
    let cases: [(&str, f32, f32, f32, f32, flat::Light, Vec3); 5] = [
        ("sun", 0.0, 0.4, 1.5, 0.0, sun(), Vec3::new(0.2, 0.1, 1.2)),
        ("sun, waves", 0.1, 0.5, 1.3, 0.5, sun(), Vec3::new(0.1, -0.2, 0.9)),
        ("ball", 0.0, 0.5, 1.4, -0.3, ball(), Vec3::new(0.3, 0.3, 1.0)),
        ("rect, air in water", 0.1, 0.6, 0.75, 0.0, rect(), Vec3::new(-0.2, 0.1, 1.3)),
        ("rect, deep", 0.0, 0.6, 1.5, 0.0, rect(), Vec3::new(0.1, 0.2, -0.5)),
    ];
    for (name, waves, roughness, ior, g, light, x) in cases {
        let medium = PreviewSurface {
            ior,
            roughness,
            subsurface_radius: [1.0, 0.8, 0.7],
            subsurface_anisotropy: g,
            ..PreviewSurface::default()
        };
        let scene = ball_of(waves, medium, vec![light]);
        let (moment, settings) = (scene.at(0.0), RenderSettings::default());
        let guide = Guide::new(&scene, &settings);
        let coating = &scene.surfaces[0];
        let interior = coating.interior.expect("a medium");
        let rough = Rough::new(&guide, &coating.surface, interior.medium, 1.0, 0.0).expect("rough");
        let enclosure = InstanceEnclosure::new(moment, 0);
        let to = CollisionLight::alone(moment);
        let bench = Bench { to, rough, enclosure, x, g: interior.medium.g };
        let mut sampler = Sampler::new(11, 0, 0);
        let looks = bench.looks(COUNT, &mut sampler).mean();
        // As if the boundary were flat.
        let to_light = rough.sample(moment.lights_for(0), 0, x, Vec2::splat(0.5)).expect("looked for").wi;
        let axis = -refract(to_light, Vec3::Z, rough.facets.eta).expect("from above");
        let [all, left] = bench.chance(axis, COUNT, &mut sampler).map(|sums| sums.mean());
        let (error, share) = ((looks.1 + left.1).sqrt(), left.0 / all.0);
        let z = (looks.0 - left.0) / error;
        eprintln!(
            "{name}: looks {:.5}, left to them {:.5}, of all {share:.2}, z {z:.2}, error {:.2} %",
            looks.0,
            left.0,
            100.0 * error / left.0
        );
        assert!(share > 0.2, "{name}: looks have nothing to say");
        assert!(z.abs() < 4.0, "{name}: {} of looks, {} left to them, z {z}", looks.0, left.0);
        assert!(error < 0.02 * left.0, "{name}: too noisy to tell");
    }
}
