//! Many lights at once.

use super::*;
use crate::flat::Shaping;
use crate::light::Choice;

/// A light of every kind, some out of reach of some points.
fn crowd() -> Vec<flat::Light> {
    let mut lights: Vec<flat::Light> = Vec::new();
    for (i, t) in [[0.0, 0.0, 3.0], [4.0, 0.0, 1.0], [-2.0, 5.0, 2.0]].into_iter().enumerate() {
        for (_, transform) in placements(t).into_iter().step_by(2) {
            let cone = Shaping { cone_angle: 30.0, cone_softness: 0.2, ..Default::default() };
            let shaping = (i == 1).then_some(cone);
            let crowd = area_shapes().map(|s| flat::Light { shaping: shaping.clone(), ..light(s, transform) });
            lights.extend(crowd);
        }
    }
    lights.push(flat::Light { intensity: 0.3, ..distant(10.0) });
    lights.push(flat::Light { intensity: 0.1, ..distant(0.0) });
    let dome = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    lights.push(flat::Light { intensity: 0.02, ..light(dome, IDENTITY) });
    lights
}

const RECEIVERS: [(Vec3, Vec3); 4] = [
    (Vec3::new(0.0, 0.0, 0.0), Vec3::Z),
    (Vec3::new(1.0, 2.0, 1.5), Vec3::new(0.6, -0.8, 0.0)),
    (Vec3::new(-2.0, 5.0, 2.6), Vec3::NEG_Z),
    (Vec3::new(3.0, -0.5, -2.0), Vec3::new(0.0, 0.6, 0.8)),
];

#[test]
fn probabilities_sum_to_one_and_are_the_frequencies() {
    let mut lights = compile(&crowd());
    // One by one: the tree has tests of its own.
    lights.tree = None;
    lights.beside = (0..lights.len() as u32).collect();
    for (p, n) in RECEIVERS {
        for n in [None, Some(n)] {
            let probabilities: Vec<f32> =
                (0..lights.len() as u32).map(|i| lights.at(0.0).choice_probability(i, p, n, Choice::ONE)).collect();
            assert!((probabilities.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            let mut counts = vec![0.0; lights.len()];
            const N: u32 = 20_000;
            for i in 0..N {
                let (light, probability) =
                    lights.at(0.0).draws(p, n, Choice::ONE).choose((i as f32 + 0.5) / N as f32).unwrap();
                assert_eq!(probability, probabilities[light as usize]);
                counts[light as usize] += 1.0 / N as f32;
            }
            // Equidistant numbers: each count is right to one.
            let near = |(c, p): (&f32, &f32)| (c - p).abs() < 1e-4;
            assert!(counts.iter().zip(&probabilities).all(near), "{counts:?} {probabilities:?}");
        }
    }
}

#[test]
fn all_lights_together_give_the_sum() {
    let crowd = crowd();
    let lights = compile(&crowd);
    for (p, n) in RECEIVERS {
        let single = |l: &flat::Light| irradiance(&compile(std::slice::from_ref(l)), p, n, 10_000, 3).mean;
        let truth = crowd.iter().map(single).sum();
        assert_agrees(irradiance(&lights, p, n, 100_000, 4), truth, 2e-3, &format!("at {p}"));
    }
}

#[test]
fn no_light_that_arrives_is_never_chosen() {
    let mut random = Random::new(6);
    for l in crowd() {
        let lights = compile(&[l]);
        for _ in 0..2000 {
            let p = Vec3::new(random.next(), random.next(), random.next()) * 12.0 - 6.0;
            let n = crate::sampling::uniform_sphere(random.next_2d());
            let lit = random.sample(&lights, p, None).is_some_and(|s| s.radiance.x > 0.0 && n.dot(s.wi) > 0.0);
            assert!(!lit || lights.at(0.0).choice_probability(0, p, Some(n), Choice::ONE) == 1.0, "{p} {n} {lights:?}");
        }
    }
}

#[test]
fn lights_behind_the_receiver_or_turned_away_are_not_chosen() {
    let shapes = area_shapes().map(|s| light(s, placements([0.0, 0.0, 3.0])[0].1));
    let lights = compile(&shapes);
    assert!((0..4).all(|i| lights.at(0.0).choice_probability(i, Vec3::ZERO, Some(Vec3::NEG_Z), Choice::ONE) == 0.0));
    assert!(lights.at(0.0).sample(Vec3::ZERO, Some(Vec3::NEG_Z), Choice::ONE, 0.5, Vec2::splat(0.5)).is_none());
    let from_above = Vec3::new(0.0, 0.0, 6.0);
    assert_eq!(lights.at(0.0).choice_probability(0, from_above, None, Choice::ONE), 0.0);
    assert!(lights.at(0.0).choice_probability(2, from_above, None, Choice::ONE) > 0.0);
}

#[test]
fn near_lights_are_preferred() {
    let sphere = |x: f64| light(LightShape::Sphere { radius: 0.1 }, placements([x, 0.0, 0.0])[0].1);
    let lights = compile(&[sphere(1.0), sphere(10.0)]);
    let probability = lights.at(0.0).choice_probability(0, Vec3::ZERO, None, Choice::ONE);
    assert!((probability - 100.0 / 101.0).abs() < 1e-3, "{probability}");
}

#[test]
fn no_lights() {
    let lights = compile(&[]);
    assert!(lights.is_empty() && lights.at(0.0).sample(Vec3::ZERO, None, Choice::ONE, 0.5, Vec2::ZERO).is_none());
}
