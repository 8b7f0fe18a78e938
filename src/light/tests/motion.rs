//! Lights that move, against lights that stand where they are at that time.

use super::*;
use crate::flat::TransformKeys;
use glam::DMat4;

/// Turned by `degrees` about an axis of its own, scaled unevenly, then shifted along x.
fn placed(degrees: f64, x: f64) -> Matrix4d {
    let turn = DMat4::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), degrees.to_radians());
    let scale = DMat4::from_scale(DVec3::new(1.2, 0.8, 1.0));
    (DMat4::from_translation(DVec3::new(x, 0.3, 2.0)) * turn * scale).to_cols_array_2d()
}

/// From 10 degrees and x = -1 to 70 and 2; at the frame somewhere else on the way.
fn moving(shape: LightShape) -> flat::Light {
    let keys = TransformKeys {
        times: vec![0.0, 1.0],
        transforms: vec![vec![placed(10.0, -1.0)].into(), vec![placed(70.0, 2.0)].into()],
    };
    flat::Light { transform_keys: Some(keys), ..light(shape, placed(25.0, 0.0)) }
}

#[test]
fn a_moving_light_is_the_light_that_stands_there() {
    let p = Vec3::new(0.4, -0.2, 0.1);
    for shape in area_shapes() {
        let lights = compile(&[moving(shape.clone())]);
        assert_eq!((lights.moving(), lights.is_moving()), (1, true));
        for time in [0.0, 0.3, 0.5, 1.0] {
            let still =
                compile(&[light(shape.clone(), placed(10.0 + 60.0 * f64::from(time), f64::from(3.0 * time - 1.0)))]);
            let (now, then) = (lights.at(time), still.at(0.0));
            let mut found = 0;
            for i in 0..200 {
                let u = Vec2::new((i as f32 + 0.5) / 200.0, (i as f32 * 0.618).fract());
                let Some(expected) = then.sample_light(0, p, None, u) else { continue };
                let sample = now.sample_light(0, p, None, u).expect("the same light");
                assert!((sample.wi - expected.wi).length() < 2e-5, "{shape:?} at {time}: {sample:?} {expected:?}");
                assert!((sample.pdf / expected.pdf - 1.0).abs() < 2e-3, "{shape:?} at {time}: {sample:?} {expected:?}");
                assert!((sample.radiance - expected.radiance).length() < 1e-5);
                found += 1;
                if let (Some(a), Some(b)) =
                    (now.intersect(0, p, sample.wi, 99.0), then.intersect(0, p, sample.wi, 99.0))
                {
                    let pdf = |lights: &LightsAt, hit| lights.pdf_hit(0, p, None, Choice::ONE, sample.wi, hit);
                    assert!((a.t - b.t).abs() < 1e-4 && (pdf(&now, &a) / pdf(&then, &b) - 1.0).abs() < 5e-3);
                }
            }
            assert!(found > 50, "{shape:?} at {time}: {found}");
        }
    }
}

/// Its directions are the same, and what they bring; which of them a number gives may turn with the light.
#[test]
fn a_sun_that_turns_is_the_sun_that_stands_there() {
    let lights = compile(&[moving(LightShape::Distant { angle: 20.0 })]);
    for time in [0.0, 0.3, 1.0] {
        let still = compile(&[light(LightShape::Distant { angle: 20.0 }, placed(10.0 + 60.0 * f64::from(time), 0.0))]);
        let (now, then) = (lights.at(time), still.at(0.0));
        for (i, lights) in [now, then].into_iter().cycle().take(400).enumerate() {
            // Not at the rim, where rounding decides.
            let u = Vec2::new(0.99 * (i as f32 + 0.5) / 400.0, (i as f32 * 0.618).fract());
            let sample = lights.sample_light(0, Vec3::ZERO, None, u).expect("a direction");
            for lights in [now, then] {
                let pdf = lights.pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, sample.wi);
                assert!((pdf / sample.pdf - 1.0).abs() < 1e-5 && lights.escaped(0, sample.wi) == sample.radiance);
            }
        }
    }
}

/// A tree of moving lights leaves none out that gives something, and gives none too often.
#[test]
fn a_tree_holds_lights_wherever_they_are() {
    let mut random = Random::new(3);
    let mut number = || f64::from(random.next() * 4.0 - 2.0);
    let place = |degrees: f64, [x, y, z]: [f64; 3]| {
        let mut matrix = placed(degrees, x);
        matrix[3][1..3].copy_from_slice(&[y, z]);
        matrix
    };
    let all: Vec<flat::Light> = (0..60)
        .map(|i| {
            // Every other one does not turn.
            let turned = 90.0 * number();
            let mut at = || {
                let more = if i % 2 == 0 { 45.0 * number() } else { 0.0 };
                place(turned + more, [number(), number(), number()])
            };
            let transforms = vec![vec![at()].into(), vec![at()].into(), vec![at()].into()];
            let keys = TransformKeys { times: vec![0.0, 0.4, 1.0], transforms };
            let shape = area_shapes()[i / 2 % 4].clone();
            flat::Light { transform_keys: Some(keys), ..light(shape, at()) }
        })
        .collect();
    let lights = compile(&all);
    assert_eq!(lights.moving(), 60);
    for i in 0..300 {
        let p = Vec3::new(number() as f32, number() as f32, number() as f32);
        let n = (i % 2 == 0).then(|| Vec3::new(number() as f32, number() as f32, 1.0).normalize());
        let now = lights.at(i as f32 / 300.0);
        let mut sum = 0.0;
        for light in 0..60 {
            let probability = now.choice_probability(light, p, n, Choice::ONE);
            let gives = (0..16).any(|k| {
                let u = Vec2::new((k as f32 + 0.5) / 16.0, (k as f32 * 0.618).fract());
                let sample = now.sample_light(light, p, n, u);
                sample.is_some_and(|s| s.radiance != Vec3::ZERO && n.is_none_or(|n| s.wi.dot(n) > 1e-3))
            });
            assert!(probability > 0.0 || !gives, "light {light} at {p} is never drawn");
            sum += probability;
        }
        assert!(sum < 1.0 + 1e-4, "{sum}");
    }
}
