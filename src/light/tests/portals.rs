//! Portals: the mixture they make of a dome's sampling, and that they change nothing but the noise.

use super::{directions::check_directions, *};
use crate::flat::Portal;
use crate::light::Choice;

const TEXTURE: &str = "/sky";

/// Brighter towards +Y and in one stripe.
fn sky() -> Prims<flat::Texture> {
    let pixel = |x: usize, y: usize| if x == 20 { 6.0 } else { 2.0 - y as f32 / 8.0 };
    let pixels: Vec<[f32; 3]> = (0..32 * 16).map(|i| [pixel(i % 32, i / 32); 3]).collect();
    [(TEXTURE.into(), flat::Texture { width: 32, height: 16, pixels: pixels.into(), ..Default::default() })].into()
}

fn portal(transform: Matrix4d) -> Portal {
    Portal { path: "/portal".into(), transform, width: 1.5, height: 1.0 }
}

fn dome(texture: &str, portals: Vec<Portal>) -> Lights {
    let shape = LightShape::Dome { texture: texture.into(), pole_axis: "Y".into() };
    compile_with(&[flat::Light { portals, ..light(shape, IDENTITY) }], &sky())
}

/// Turned by half a turn about Y: -Z becomes +Z.
fn turned(t: [f64; 3]) -> Matrix4d {
    matrix([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], t)
}

fn pdf(lights: &Lights, p: Vec3, n: Option<Vec3>, wi: Vec3) -> f32 {
    lights.at(0.0).pdf_escaped(0, p, n, Choice::ONE, wi)
}

#[test]
fn directions_are_distributed_as_the_mixture_says() {
    for texture in ["", TEXTURE] {
        for (name, transform) in placements([0.2, -0.1, 1.0]) {
            // Two that overlap as seen from the origin, one aside, one turned away.
            let portals = [
                transform,
                placements([0.4, 0.0, 1.2])[0].1,
                placements([2.0, 0.5, 1.5])[0].1,
                turned([0.0, 0.0, 1.0]),
            ];
            let lights = dome(texture, portals.map(portal).to_vec());
            for n in [None, Some(Vec3::new(0.8, 0.0, 0.6))] {
                let pdf = |wi: Vec3| pdf(&lights, Vec3::ZERO, n, wi);
                check_directions(&lights, Vec3::ZERO, n, (Vec3::Z, -1.0), pdf, &format!("{name} {texture} {n:?}"));
            }
        }
    }
}

#[test]
fn half_of_the_samples_go_through_the_portal_that_is_seen() {
    let (guided, plain) = (dome("", vec![portal(turned([0.0, 0.0, -1.0]))]), dome("", vec![]));
    // Solid angle of a rectangle a x b at height 1 before its centre: 4 atan(a b / (4 sqrt(1 + (a^2 + b^2) / 4))).
    let solid_angle = 4.0 * (1.5_f32 / (4.0 * (1.0 + (1.5_f32.powi(2) + 1.0) / 4.0).sqrt())).atan();
    let (inside, outside) = (Vec3::new(0.7, -0.45, -1.0).normalize(), Vec3::new(0.8, 0.0, -1.0).normalize());
    let expected = |wi, through: f32| 0.5 * (pdf(&plain, Vec3::ZERO, None, wi) + through);
    for (wi, through) in [(inside, 1.0 / solid_angle), (outside, 0.0)] {
        let found = pdf(&guided, Vec3::ZERO, None, wi);
        assert!((found / expected(wi, through) - 1.0).abs() < 1e-5, "{wi}: {found}, {}", expected(wi, through));
    }
}

#[test]
fn sampled_pdfs_are_the_evaluated_ones_and_irradiance_stays() {
    let n = Vec3::new(0.36, 0.48, 0.8);
    for (name, transform) in placements([0.2, 0.4, 1.0]) {
        let (guided, plain) = (dome(TEXTURE, vec![portal(transform)]), dome(TEXTURE, vec![]));
        let mut random = Random::new(3);
        for _ in 0..2000 {
            let s = random.sample(&guided, Vec3::ZERO, Some(n)).unwrap();
            assert_eq!(s.pdf, pdf(&guided, Vec3::ZERO, Some(n), s.wi), "{name}");
        }
        let truth = irradiance(&plain, Vec3::ZERO, n, 400_000, 5);
        let guided = irradiance(&guided, Vec3::ZERO, n, 400_000, 6);
        let error = truth.error.hypot(guided.error);
        assert!(
            error < 5e-3 * truth.mean && (guided.mean - truth.mean).abs() < 4.0 * error,
            "{name}: {guided:?} {truth:?}"
        );
    }
}

/// A direction that is drawn through a portal counts as such, wherever rounding puts it: counted as the dome's alone it
/// would weigh thousands of times too much.
#[test]
fn rounding_beside_a_far_portal_makes_no_firefly() {
    let p = Vec3::new(300.1, 0.0, 0.0);
    // Half of 1.4 is no multiple of what positions about 300 are rounded to.
    let lights = dome("", vec![Portal { width: 1.4, ..portal(turned([300.1, 0.0, -30.0])) }]);
    let solid_angle = 1.4 / 900.0;
    let mut random = Random::new(9);
    for _ in 0..1_000_000 {
        let s = random.sample(&lights, p, None).unwrap();
        // Half of all are drawn uniformly; none of those is likely to be this close to the portal's edge.
        let at = s.wi.truncate() * (-30.0 / s.wi.z);
        let beside = s.wi.z < 0.0 && (at.x.abs() - 0.7).abs() < 1e-4 && at.y.abs() < 0.5;
        assert!(!beside || s.pdf > 0.4 / solid_angle, "{} {}", s.wi, s.pdf);
    }
}

#[test]
fn what_is_turned_away_or_below_the_horizon_guides_nothing() {
    let plain = dome(TEXTURE, vec![]);
    let guided = dome(TEXTURE, vec![portal(IDENTITY)]);
    let wi = Vec3::new(0.1, 0.1, 1.0).normalize();
    let same = |p, n| pdf(&guided, p, n, wi) == pdf(&plain, p, n, wi);
    assert!(!same(Vec3::NEG_Z, None) && !same(Vec3::NEG_Z, Some(Vec3::Z)));
    // Behind the portal; before it, looking away.
    assert!(same(Vec3::Z, None) && same(Vec3::NEG_Z, Some(Vec3::NEG_Z)));
    let sample = |lights: &Lights| Random::new(2).sample(lights, Vec3::Z, None);
    assert_eq!(sample(&guided), sample(&plain));
}

#[test]
fn damaged_portals_are_said_and_the_dome_stays() {
    let shape = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    let portals = vec![Portal { width: 0.0, ..portal(IDENTITY) }];
    let prims = [("/sky".to_owned(), flat::Light { portals, ..light(shape, IDENTITY) })].into();
    let mut warnings = Vec::new();
    let lights = Lights::compile(&prims, &Prims::new(), &|_| None, DVec3::ZERO, true, &mut warnings);
    assert!(lights.len() == 1 && lights.with_portals() == 0);
    assert!(warnings.len() == 1 && warnings[0].prim == "/portal" && warnings[0].message.contains("guides nothing"));
}
