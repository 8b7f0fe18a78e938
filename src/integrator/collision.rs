//! Light at collisions: next-event estimation from within a medium, straight through matched boundaries and bent by
//! smooth dielectric ones.

use super::lobes::By;
use super::manifold::{Crossing, Window};
use super::nest::Nest;
use super::shadow::{visibility, visibility_beyond};
use super::{Bucket, add_to};
use crate::bsdf::Response;
use crate::film::Sample;
use crate::light::{Choice, Emitter};
use crate::math::{Rgb, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment, SurfaceHit};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::Collision;
use glam::{Vec2, Vec3};

/// Where a path's light goes.
pub(super) struct Into<'a> {
    pub sample: &'a mut Sample,
    /// Sums of AOVs of lights.
    pub groups: &'a mut [Rgb],
    /// By [`crate::flat::LOBE_AOVS`].
    pub lobes: &'a mut [Rgb],
}

/// Light sampled at the collisions of a walk.
#[derive(Clone, Copy)]
pub(super) struct CollisionLight<'a> {
    pub scene: Moment<'a>,
    /// The body that the collisions are in.
    pub instance: u32,
    /// Of objects around the path: those around the collision where the boundary is matched, around the object where it
    /// is not.
    pub around: &'a Nest,
    /// Path throughput per unit of the walk's weight.
    pub scale: f32,
    pub bucket: Bucket,
    pub by: By,
    /// The boundary that bends the light; `None`: matched.
    pub bent: Option<Bent<'a>>,
}

impl CollisionLight<'_> {
    /// Adds what a collision sees of a light. Returns the shadow rays that took.
    pub fn add(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        match &self.bent {
            None => self.add_straight(collision, enclosure, sampler, into),
            Some(bent) => self.add_bent(bent, collision, enclosure, sampler, into),
        }
    }

    /// Weighted against the walk's own directions.
    fn add_straight(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        let u = Vec2::new(sampler.random(), sampler.random());
        let p = enclosure.to_render(collision.p);
        let light = self.scene.lights_for(self.instance).sample(p, None, Choice::ONE, sampler.random(), u);
        let Some(light) = light.filter(|light| light.radiance != Rgb::ZERO) else { return 0 };
        let (phase, pdf) = (collision.scatter)(light.wi);
        if phase <= 0.0 {
            return 0;
        }
        let hit = enclosure.cast(collision.p, light.wi, light.reach(), None);
        let hit = hit.map(|(t, hit)| SurfaceHit { t, ..enclosure.surface_hit(&hit) });
        let visible = visibility_beyond(self.scene, light.light, p, hit, light.wi, light.reach(), self.around);
        // Walks meet no light shapes before the next surface: those within the medium are ours alone.
        let within = hit.is_none() && light.distance.is_finite() && !self.scene.lights.is_mesh(light.light);
        // Nor do they look for lights with shadow rules.
        let ours = light.delta || within || self.scene.lights.shadow(light.light).is_some();
        let weight = if ours { 1.0 } else { power_heuristic(light.pdf, pdf) };
        self.give(into, light.light, collision.weight * visible * light.radiance * (phase * weight / light.pdf));
        1
    }

    /// Weighted against paths that scatter and refract the same way by chance.
    fn add_bent(
        &self,
        bent: &Bent,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        if sampler.random() >= TRIED {
            return 0;
        }
        let u = Vec2::new(sampler.random(), sampler.random());
        let lights = self.scene.lights_for(self.instance);
        let emitter = lights.sample_emitter(enclosure.to_render(collision.p), sampler.random(), u);
        let Some(emitter) = emitter.filter(Bent::is_small) else { return 0 };
        let ways = bent.connect(collision.p, &emitter, |survival| sampler.random() < survival);
        let mut shadow_rays = 0;
        for (at, density) in ways.into_iter().flatten() {
            let value = collision.weight * bent.unshadowed(self.scene, collision, &emitter, &at, density);
            if value.is_finite() && value != Rgb::ZERO {
                shadow_rays += 1;
                let o = bent.window.interaction(&at).origin(at.v);
                let origin = Some((self.instance, at.hit.triangle));
                let visible = visibility(self.scene, emitter.light, o, at.v, at.reach(), origin, self.around);
                self.give(into, emitter.light, value * visible);
            }
        }
        shadow_rays
    }

    fn give(&self, into: &mut Into, source: u32, light: Rgb) {
        let mut light = self.scale * light;
        if self.by.told {
            let by = Some(Response::Scattered);
            light = self.by.sorted(&self.scene, self.bucket, by, source, light, into.lobes);
        }
        add_to(into.sample, self.bucket, light);
        if !into.groups.is_empty() {
            self.scene.lights.sort(into.groups, source, light);
        }
    }
}

/// Light that a boundary bends on its way to collisions in `medium`.
#[derive(Clone, Copy)]
pub(super) struct Bent<'a> {
    window: Window<'a>,
    medium: Medium,
}

/// Least density per solid angle of light that is connected to. What fills more of the sky is met by chance.
const SMALL: f32 = 0.5;

/// Share of the collisions that are tried at all: a connection costs as much as ten steps of the walk. A flat optimum, as
/// the next (docs/performance.md, "Smooth dielectrics").
const TRIED: f32 = 0.25;

/// Of those tried, the share that goes on to search: this times what the medium passes on the straight way.
const SEARCHED: f32 = 0.4;

/// Searches for one target, from as many starts, where it is drawn with a density of at least [`TINY`].
const SEARCHES: usize = 4;

/// Density per solid angle from which on what a single search misses makes most of the noise.
const TINY: f32 = 20.0;

/// Ways to one target, each with the solid-angle pdf of connecting along it.
type Ways = [Option<(Crossing, f32)>; SEARCHES];

impl<'a> Bent<'a> {
    /// `None` unless `surface` makes a smooth dielectric boundary of `instance`.
    pub fn new(scene: Moment<'a>, instance: u32, surface: u32) -> Option<Self> {
        let error = InstanceEnclosure::new(scene, instance).position_error();
        let window = Window::new(scene, instance, surface, error)?;
        Some(Self { window, medium: scene.surfaces[surface as usize].interior?.medium })
    }

    fn is_small(emitter: &Emitter) -> bool {
        emitter.straight >= SMALL
    }

    /// The different ways on which light from `emitter` is found to refract to `x` (walk space). `survives` plays roulette
    /// with the probability that it is given.
    fn connect(&self, x: Vec3, emitter: &Emitter, mut survives: impl FnMut(f32) -> bool) -> Ways {
        let target = self.window.target(emitter);
        let mut ways: Ways = [None; SEARCHES];
        let Some(straight) = self.window.start(x, &target) else { return ways };
        let searched = (SEARCHED * mean(self.medium.transmittance(straight.t))).min(1.0);
        if !survives(searched) {
            return ways;
        }
        let searches = if emitter.straight < TINY { 1 } else { SEARCHES };
        for i in 0..searches {
            let start = if i == 0 { Some(straight) } else { self.window.start_beside(x, &target, &straight, i - 1) };
            let Some(at) = start.and_then(|start| self.window.solve(x, &target, start)) else { continue };
            let known = ways[..i].iter().flatten().any(|(other, _)| self.window.is_at(other, at.p));
            let density = TRIED * searched * self.window.pdf(&at, emitter);
            if !known && density > 0.0 && density.is_finite() {
                ways[i] = Some((at, density));
            }
        }
        ways
    }

    /// What a collision scatters of the light on one of the ways, over its density, MIS weight included.
    fn unshadowed(&self, scene: Moment, collision: &Collision, emitter: &Emitter, at: &Crossing, density: f32) -> Rgb {
        let (phase, pdf) = (collision.scatter)(at.d);
        let weight = if emitter.delta { 1.0 } else { power_heuristic(density, pdf * self.escape(at)) };
        let passed = self.medium.transmittance(at.t) * self.window.radiance(at);
        passed * scene.lights().radiance_of(emitter, at.v) * (phase * weight / density)
    }

    /// Probability that a walk which goes towards `at` gets out there.
    fn escape(&self, at: &Crossing) -> f32 {
        mean(self.medium.transmittance(at.t)) * self.window.transmitted(at)
    }
}

/// The last collision before a path refracted out into the segment under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refracted {
    pub instance: u32,
    pub surface: u32,
    /// The collision, and where the path came out; walk space.
    pub x: Vec3,
    pub p: Vec3,
    /// Of the direction between them, per solid angle.
    pub pdf: f32,
}

impl Refracted {
    /// MIS weight of having met a light by chance, given as what it is to a receiver at a point of render space.
    pub fn weight(&self, scene: Moment, emitter: impl Fn(Vec3) -> Option<Emitter>) -> f32 {
        let x = self.x + scene.placed(self.instance).translation;
        let Some(emitter) = emitter(x).filter(Bent::is_small) else { return 1.0 };
        let Some(bent) = Bent::new(scene, self.instance, self.surface) else { return 1.0 };
        let ways = bent.connect(self.x, &emitter, |_| true);
        match ways.into_iter().flatten().find(|(at, _)| bent.window.is_at(at, self.p)) {
            Some((at, density)) => power_heuristic(self.pdf * bent.escape(&at), density),
            // Found by chance alone.
            None => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::manifold::tests::ball;
    use super::*;
    use crate::bsdf::{Side, fresnel::refract};
    use crate::flat::{Light, LightShape};
    use crate::math::{Frame, TAU};
    use glam::DVec3;

    /// A light of `shape` at `at` whose -Z looks at the origin.
    fn light(shape: LightShape, at: DVec3) -> Light {
        let mut light = Light { shape, ..Light::default() };
        let z = at.normalize();
        let x = DVec3::Y.cross(z).normalize();
        for (row, axis) in light.transform.iter_mut().zip([x, z.cross(x), z, at]) {
            row[..3].copy_from_slice(&axis.to_array());
        }
        light
    }

    /// Half angle of the directions that are counted: wider than any of the lights is seen.
    const CONE: f32 = 0.6;

    /// Mean and standard error.
    fn statistics(sum: f64, squares: f64, n: f64) -> (f64, f64) {
        let mean = sum / n;
        (mean, ((squares / n - mean * mean) / n).sqrt())
    }

    /// Solid angle under which a collision sees the light on ways that the search finds: by connecting, 1 / density on
    /// average; by chance, the share of directions that refract into the light and find themselves. A density that is
    /// 2 % off anywhere on its way from the light to the collision is seen.
    #[test]
    fn connections_and_chance_agree_about_solid_angles() {
        let at = DVec3::new(0.7, 0.5, 3.4);
        let shapes = [
            (LightShape::Rect { width: 1.0, height: 0.7, texture: String::new() }, 1.4),
            (LightShape::Sphere { radius: 0.5 }, 1.2),
            (LightShape::Disk { radius: 0.4 }, 1.6),
            (LightShape::Cylinder { length: 1.0, radius: 0.25 }, 1.33),
            (LightShape::Distant { angle: 20.0 }, 1.5),
        ];
        for (i, (shape, ior)) in shapes.into_iter().enumerate() {
            let scene = ball(0.06, ior, vec![light(shape.clone(), at)]);
            let scene = scene.at(0.0);
            let bent = Bent::new(scene, 0, 0).expect("a smooth dielectric");
            let x = Vec3::new(0.1, -0.2, 0.9);
            let to_render = scene.instances[0].to_render.translation;
            let frame = Frame::from_normal((at.as_vec3() - x).normalize());
            let seen = |d: Vec3| d.dot(frame.n) > CONE.cos();
            let mut sampler = Sampler::new(11, i as u32, 0);

            let (n, mut sum, mut squares) = (60_000, 0.0, 0.0);
            for _ in 0..n {
                let u = Vec2::new(sampler.random(), sampler.random());
                let Some(emitter) = scene.lights().sample_emitter(x + to_render, sampler.random(), u) else { continue };
                // The medium passes everything: roulette is that of the constants alone.
                let found = bent.connect(x, &emitter, |_| true).into_iter().flatten().filter(|(at, _)| seen(at.d));
                let angle: f64 = found.map(|(_, density)| f64::from(TRIED * SEARCHED / density)).sum();
                (sum, squares) = (sum + angle, squares + angle * angle);
            }
            let (connected, error) = statistics(sum, squares, f64::from(n));

            let (n, mut hits) = (1_000_000, 0.0);
            for _ in 0..n {
                let (cos, phi) = (1.0 - sampler.random() * (1.0 - CONE.cos()), TAU * sampler.random());
                let sin = (1.0 - cos * cos).sqrt();
                let d = frame.to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos));
                let hit = scene.boundary_from_within(0, x, d, f32::INFINITY).expect("closed");
                let exit = scene.interaction(&hit, d, Side::Inside);
                let Some(v) = refract(-d, -exit.frame.n, 1.0 / ior) else { continue };
                let p = exit.p - to_render;
                let last = Refracted { instance: 0, surface: 0, x, p, pdf: 1.0 };
                let weight = if matches!(shape, LightShape::Distant { .. }) {
                    last.weight(scene, |x| scene.lights().emitter_towards(0, x, v))
                } else {
                    let Some(hit) = scene.lights().intersect(0, exit.p, v, f32::INFINITY) else { continue };
                    last.weight(scene, |x| scene.lights().emitter_at(0, x, exit.p + v * hit.t, &hit))
                };
                hits += f64::from(u8::from(weight < 1.0));
            }
            let cone = f64::from(TAU * (1.0 - CONE.cos()));
            let (share, of_chance) = statistics(hits, hits, f64::from(n));
            let (chance, of_chance) = (cone * share, cone * of_chance);
            let (ratio, error) = (connected / chance, error.hypot(of_chance) / chance);
            eprintln!("{shape:?}: {connected:.5} sr, {ratio:.4} +- {error:.4} of chance");
            assert!(error < 4.5e-3, "{shape:?}: +- {error} sees no 2 %");
            assert!((ratio - 1.0).abs() < 4.0 * error, "{shape:?}: {ratio} +- {error}");
        }
    }
}
