//! Lights that are for some things only are not drawn for others.

use super::many::crowd;
use super::*;
use crate::light::Categories;

/// Of `lights`, by index: for the first set of categories, for the second, for both.
fn linked(lights: Vec<flat::Light>) -> Lights {
    let name = |i: usize| ["a", "b", ""][i % 3].to_owned();
    let link = |(i, light): (usize, flat::Light)| (format!("/{i:04}"), flat::Light { light_link: name(i), ..light });
    let prims: Prims<flat::Light> = lights.into_iter().enumerate().map(link).collect();
    let mut compiled = Lights::compile(&prims, &Prims::new(), &|_| None, DVec3::ZERO, true, &mut Vec::new());
    let mut categories = Categories::of(&prims);
    assert_eq!([0, 1].map(|set| categories.set(&[name(set)])), [0, 1]);
    compiled.link(&prims, &categories);
    compiled
}

/// Few lights, many in a tree, and many with a sky beside it.
fn rigs() -> [Vec<flat::Light>; 3] {
    let sky = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    let mut with_sky = crowd(120, [-1.0, 0.0], 4);
    with_sky.insert(60, flat::Light { intensity: 0.2, ..light(sky.clone(), IDENTITY) });
    with_sky.insert(61, flat::Light { intensity: 0.2, ..light(sky, IDENTITY) });
    [crowd(9, [-1.0, 0.0], 2), crowd(200, [-2.0, 0.5], 3), with_sky]
}

#[test]
fn what_is_not_for_a_receiver_is_never_drawn() {
    const DRAWS: u32 = 3000;
    let mut random = Random::new(8);
    for (rig, lights) in rigs().into_iter().map(linked).enumerate() {
        for (set, other) in [(0, 1), (1, 0)] {
            let (p, n) = (Vec3::new(0.3, -1.0, 0.7), Vec3::new(0.0, 0.6, 0.8));
            let audience = lights.at(0.0).linked_to(set);
            let probability = |light| f64::from(audience.choice_probability(light, p, Some(n), Choice::ONE));
            let all: Vec<f64> = (0..lights.len() as u32).map(probability).collect();
            assert!(all.iter().enumerate().all(|(light, p)| light % 3 != other || *p == 0.0), "rig {rig}, set {set}");
            let mut counts = vec![0.0; lights.len()];
            for _ in 0..DRAWS {
                let Some((light, chosen)) = audience.draws(p, Some(n), Choice::ONE).choose(random.next()) else {
                    continue;
                };
                assert!(light as usize % 3 != other, "rig {rig}, set {set}: light {light}");
                assert!((f64::from(chosen) / all[light as usize] - 1.0).abs() < 1e-5);
                counts[light as usize] += 1.0;
            }
            // A descent may end among lights that do not reach the receiver; what is left is drawn as is said.
            for (count, p) in counts.iter().zip(&all) {
                let (mean, deviation) = (p * f64::from(DRAWS), (p * f64::from(DRAWS)).sqrt().max(1.0));
                assert!((count - mean).abs() < 6.0 * deviation, "rig {rig}, set {set}: {count} of {mean}");
            }
        }
    }
}

/// One light of many is for the receiver: it is drawn each time, where it was one draw of many.
#[test]
fn a_single_light_for_a_receiver_has_all_its_draws() {
    let mut lights = crowd(60, [-1.0, 0.0], 5);
    lights.iter_mut().for_each(|light| light.shaping = None);
    let name = |i: usize| if i == 18 { "" } else { "others" };
    let link =
        |(i, light): (usize, flat::Light)| (format!("/{i:04}"), flat::Light { light_link: name(i).into(), ..light });
    let prims: Prims<flat::Light> = lights.into_iter().enumerate().map(link).collect();
    let mut compiled = Lights::compile(&prims, &Prims::new(), &|_| None, DVec3::ZERO, true, &mut Vec::new());
    let mut categories = Categories::of(&prims);
    assert_eq!([&["others".to_owned()][..], &[]].map(|names| categories.set(names)), [0, 1]);
    compiled.link(&prims, &categories);
    let p = Vec3::new(0.3, -1.0, 0.7);
    // A ball: it shines everywhere.
    let shared = compiled.at(0.0).linked_to(0).choice_probability(18, p, None, Choice::ONE);
    let alone = compiled.at(0.0).linked_to(1).choice_probability(18, p, None, Choice::ONE);
    assert!(shared < 0.5 && (alone - 1.0).abs() < 1e-6, "{shared} {alone}");
}

#[test]
fn without_links_nothing_is_kept() {
    let lights = compile(&crowd(40, [-1.0, 0.0], 6));
    assert!(!lights.has_links() && lights.linked_to.is_empty());
    assert!(lights.at(0.0).linked_to(0).allowed().is_none());
}
