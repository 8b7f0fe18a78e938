//! Connections against directions drawn without them.

use super::*;
use crate::bsdf::Side;
use crate::film::Sample;
use crate::flat::{Light, LightShape, PreviewSurface};
use crate::integrator::manifold::tests::ball_of;
use crate::math::PI;
use crate::sampling::direction_about;
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::Role;

/// Mean and its variance.
fn mean_of(count: usize, mut draw: impl FnMut() -> f32) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..count {
        let x = f64::from(draw());
        (sum, squares) = (sum + x, squares + x * x);
    }
    let (mean, n) = (sum / count as f64, count as f64);
    (mean, (squares / n - mean * mean) / n)
}

/// Connections bring what MIS leaves to them of what directions around the straight way meet: so they have the density that both
/// sides say they have.
#[test]
fn connections_have_their_density() {
    const COUNT: usize = 1_000_000;
    for (name, waves, ior, angle, x) in [
        ("plain", 0.0, 1.4, 3.0, Vec3::new(0.2, 0.1, 1.5)),
        ("glass", 0.0, 1.8, 6.0, Vec3::new(-0.3, 0.2, 1.3)),
        ("waves", 0.1, 1.3, 5.0, Vec3::new(0.1, -0.2, 1.6)),
        ("air in water", 0.0, 0.75, 4.0, Vec3::new(0.1, 0.2, 1.4)),
    ] {
        let sun = Light { shape: LightShape::Distant { angle }, ..Light::default() };
        let glass =
            PreviewSurface { ior, roughness: 0.0, subsurface_radius: [1.0, 0.8, 0.7], ..PreviewSurface::default() };
        let scene = ball_of(waves, glass, vec![sun]);
        let (moment, medium) = (scene.at(0.0), scene.surfaces[0].interior.expect("a medium").medium);
        let enclosure = InstanceEnclosure::new(moment, 0);
        let window = Window::new(moment, 0, 0, enclosure.position_error()).expect("smooth");
        let suns = Suns::new(moment, 0, window, medium);
        let to = CollisionLight::alone(moment);
        let (mut sampler, phase) = (Sampler::new(12, 0, 0), 0.25 / PI);
        let scatter = |_: Vec3| (phase, f32::NAN);
        let collision = Collision { p: x, weight: Rgb::ONE, walked: None, role: Role::Own, scatter: &scatter };
        let connected = mean_of(COUNT, || {
            let mut sample = Sample::BLACK;
            let mut into = Into::new(&mut sample, &mut [], &mut []);
            if let Some(search) = suns.search(&enclosure, x, &mut sampler) {
                suns.connect(&to, &search, &collision, &mut into);
            }
            mean(sample.subsurface)
        });
        // Where the light comes from, twice as wide as the sun, which is along +z.
        let span = 4.0 * (0.5 * angle.to_radians()).sin().powi(2);
        let axis = window.solve(x, window.start(x, Vec3::Z).expect("closed")).expect("it refracts").d;
        let left = mean_of(COUNT, || {
            let d = direction_about(axis, span * sampler.random(), sampler.random());
            let (t, hit) = enclosure.cast(x, d, f32::INFINITY, None).expect("closed");
            let exit = moment.interaction(&enclosure.surface_hit(&hit), d, Side::Inside);
            let Some((v, transmitted)) = window.refracted(&exit) else { return 0.0 };
            let Some(pdf) = suns.pdf(0, v) else { return 0.0 };
            let met = moment.lights().escaped(0, v) * medium.transmittance(t) * window.radiance_of(transmitted);
            let way = FirstWay { x, p: enclosure.point(&hit) };
            mean(met) * phase * 2.0 * PI * span * (1.0 - suns.weight(&enclosure, &way, 0, v, pdf))
        });
        let error = (connected.1 + left.1).sqrt();
        let z = (connected.0 - left.0) / error;
        eprintln!(
            "{name}: connections {:.5}, left to them {:.5}, z {z:.2}, error {:.2} %",
            connected.0,
            left.0,
            100.0 * error / left.0
        );
        assert!(z.abs() < 4.0, "{name}: {} of connections, {} left to them, z {z}", connected.0, left.0);
        assert!(left.0 > 0.0 && error < 0.01 * left.0, "{name}: too noisy to tell");
    }
}
