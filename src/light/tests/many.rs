//! Many lights: the tree against the lights asked one by one.

use super::*;
use crate::flat::Shaping;
use crate::sampling::uniform_sphere;

/// A rotation and a size, at `t`.
fn turned(random: &mut Random, size: f32, t: Vec3) -> Matrix4d {
    let frame = crate::math::Frame::from_normal(uniform_sphere(random.next_2d()));
    let axis = |v: Vec3| (v * size).as_dvec3().to_array();
    matrix(axis(frame.t), axis(frame.b), axis(frame.n), t.as_dvec3().to_array())
}

/// Lights of every shape in a box, with the given sizes (powers of ten); a third are spots.
pub fn crowd(count: usize, sizes: [f32; 2], seed: u32) -> Vec<flat::Light> {
    let mut random = Random::new(seed);
    let one = |i: usize| {
        let size = 10.0_f32.powf(sizes[0] + (sizes[1] - sizes[0]) * random.next());
        let t = Vec3::new(random.next(), random.next(), random.next()) * 10.0 - 5.0;
        let cone_angle = 5.0 + 115.0 * random.next();
        let focus = if i.is_multiple_of(2) { 3.0 } else { 0.0 };
        let shaping = Shaping { cone_angle, cone_softness: random.next(), focus, ..Default::default() };
        flat::Light {
            shaping: i.is_multiple_of(3).then_some(shaping),
            intensity: 1e-2 + random.next() / (size * size),
            ..light(area_shapes()[i % 4].clone(), turned(&mut random, size, t))
        }
    };
    (0..count).map(one).collect()
}

/// Rigs that are hard on a tree, by name.
fn rigs() -> Vec<(&'static str, Vec<flat::Light>)> {
    let mut with_sky = crowd(60, [-1.0, 0.0], 1);
    with_sky.push(flat::Light { intensity: 0.3, ..distant(10.0) });
    with_sky.push(flat::Light { intensity: 0.1, ..distant(0.0) });
    let dome = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    with_sky.push(flat::Light { intensity: 0.2, ..light(dome, IDENTITY) });
    // Walls of rectangles that face each other.
    let walls = (0..200).map(|i| {
        let (x, y) = (f64::from(i % 10) - 4.5, f64::from(i / 20) - 4.5);
        let side = if i / 10 % 2 == 0 { 1.0 } else { -1.0 };
        let transform = matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, side], [x, y, 5.0 * side]);
        light(area_shapes()[usize::from(i % 7 == 0)].clone(), transform)
    });
    // All in one place, and on one line.
    let pile = (0..40).map(|i| {
        let shape = LightShape::Sphere { radius: 0.01 * (i + 1) as f32 };
        light(shape, placements([1.0, 2.0, 0.0])[0].1)
    });
    let line = (0..100).map(|i| light(area_shapes()[i % 4].clone(), placements([0.2 * i as f64 - 9.0, 0.0, 2.0])[0].1));
    vec![
        ("all kinds", with_sky),
        ("sizes 1e-3 to 1e3", crowd(150, [-3.0, 3.0], 2)),
        ("small", crowd(300, [-2.0, -1.0], 3)),
        ("walls", walls.collect()),
        ("pile", pile.collect()),
        ("line", line.collect()),
    ]
}

fn receiver(random: &mut Random) -> (Vec3, Vec3) {
    let p = Vec3::new(random.next(), random.next(), random.next()) * 12.0 - 6.0;
    (p, uniform_sphere(random.next_2d()))
}

/// Visible shares as if learned.
fn shares(lights: &Lights, random: &mut Random) -> Vec<f32> {
    (0..lights.parts().len()).map(|_| 0.1 + 0.9 * random.next()).collect()
}

#[test]
fn a_light_that_arrives_may_always_be_chosen() {
    let mut arrivals = 0;
    for (name, rig) in rigs() {
        let lights = compile(&rig);
        let mut random = Random::new(11);
        for _ in 0..200 {
            let (p, n) = receiver(&mut random);
            for light in 0..lights.len() as u32 {
                let u = random.next_2d();
                let Some(s) = lights.at(0.0).sample_light(light, p, Some(n), u).filter(|s| s.radiance != Vec3::ZERO)
                else {
                    continue;
                };
                assert!(lights.at(0.0).reaches(light, p, None), "{name}: light {light} at {p}");
                assert!(
                    lights.at(0.0).choice_probability(light, p, None, Choice::ONE) > 0.0,
                    "{name}: light {light} at {p}"
                );
                if n.dot(s.wi) > 0.0 {
                    arrivals += 1;
                    let probability = lights.at(0.0).choice_probability(light, p, Some(n), Choice::ONE);
                    assert!(probability > 0.0, "{name}: light {light} at {p} {n}");
                }
            }
        }
    }
    assert!(arrivals > 10_000, "{arrivals}");
}

#[test]
fn what_is_chosen_is_chosen_as_often_as_said() {
    for (name, rig) in rigs() {
        let lights = compile(&rig);
        assert!(lights.tree.is_some());
        let mut random = Random::new(12);
        let mut least = 1.0_f64;
        for _ in 0..6 {
            let (p, n) = receiver(&mut random);
            for (n, learned) in [(None, false), (Some(n), false), (Some(n), true)] {
                let shares = if learned { &*shares(&lights, &mut random) } else { &[] };
                let choice = Choice::Drawn { count: 1, shares };
                let probability = |i| f64::from(lights.at(0.0).choice_probability(i, p, n, choice));
                let probabilities: Vec<f64> = (0..lights.len() as u32).map(probability).collect();
                const N: u32 = 40_000;
                let mut counts = vec![0.0; lights.len()];
                let mut none = 0.0;
                for _ in 0..N {
                    match lights.at(0.0).draws(p, n, choice).choose(random.next()) {
                        Some((light, p)) => {
                            counts[light as usize] += 1.0;
                            assert!((f64::from(p) / probabilities[light as usize] - 1.0).abs() < 1e-4, "{name}");
                        }
                        None => none += 1.0,
                    }
                }
                // Descents that end at clusters none of whose lights reach p are what is missing from 1.
                let sum: f64 = probabilities.iter().sum();
                assert!(sum < 1.0 + 1e-5, "{name}: {sum}");
                if sum > 0.0 {
                    least = least.min(sum);
                }
                let all =
                    counts.iter().zip(&probabilities).map(|(&c, &p)| (c, p)).chain([(none, (1.0 - sum).max(0.0))]);
                assert_frequencies(all, f64::from(N), name);
            }
        }
        println!("{name}: at least {least:.2} of the descents find a light");
        assert!(least > 0.2, "{name}: {least}");
    }
}

/// What descents remember changes nothing, in whatever order they come.
#[test]
fn draws_for_one_receiver_are_those_of_many() {
    for (name, rig) in rigs() {
        let lights = compile(&rig);
        let mut random = Random::new(17);
        for _ in 0..20 {
            let (p, n) = receiver(&mut random);
            let shares = shares(&lights, &mut random);
            let choice = Choice::Drawn { count: 4, shares: &shares };
            let mut draws = lights.at(0.0).draws(p, Some(n), choice);
            for _ in 0..20 {
                let u = random.next();
                assert_eq!(draws.choose(u), lights.at(0.0).draws(p, Some(n), choice).choose(u), "{name}");
            }
        }
    }
}

/// Pearson's statistic against its 4 sigma quantile (Wilson and Hilferty 1931); what is expected below 10 times is pooled.
fn assert_frequencies(all: impl Iterator<Item = (f64, f64)>, n: f64, what: &str) {
    let (mut statistic, mut dof, mut pool) = (0.0, -1.0, (0.0, 0.0));
    for (count, probability) in all {
        let expected = probability * n;
        if expected >= 10.0 {
            statistic += (count - expected).powi(2) / expected;
            dof += 1.0;
        } else {
            pool = (pool.0 + count, pool.1 + expected);
        }
    }
    assert!((pool.0 - pool.1).abs() <= 5.0 * f64::sqrt(pool.1) + 3.0, "{what}: rare lights {pool:?}");
    let c = 2.0 / (9.0 * f64::max(dof, 1.0));
    let limit = f64::max(dof, 1.0) * (1.0 - c + 4.0 * c.sqrt()).powi(3);
    assert!(statistic < limit, "{what}: chi square {statistic} of {dof} degrees, limit {limit}");
}

#[test]
fn where_every_light_arrives_the_probabilities_sum_to_one() {
    let sphere = |i: u32| {
        let t = [f64::from(i % 9), f64::from(i % 7), f64::from(i % 11)];
        light(LightShape::Sphere { radius: 0.1 + 0.001 * i as f32 }, placements(t)[0].1)
    };
    let lights = compile(&(0..400).map(sphere).collect::<Vec<_>>());
    let p = Vec3::new(-3.0, 2.0, 5.0);
    let sum: f64 = (0..400).map(|i| f64::from(lights.at(0.0).choice_probability(i, p, None, Choice::ONE))).sum();
    assert!((sum - 1.0).abs() < 1e-5, "{sum}");
}

/// Irradiance of each light by itself, summed: the choice has no part in it.
fn one_by_one(lights: &Lights, p: Vec3, n: Vec3, samples: u32, seed: u32) -> Estimate {
    let mut random = Random::new(seed);
    estimate(samples, || {
        let given = |light| {
            let s = lights.at(0.0).sample_light(light, p, Some(n), random.next_2d())?;
            let usable = s.pdf > 0.0 && s.pdf.is_finite();
            usable.then(|| f64::from(s.radiance.x * n.dot(s.wi).max(0.0) / s.pdf))
        };
        (0..lights.len() as u32).filter_map(given).sum()
    })
}

#[test]
fn means_are_those_of_the_lights_one_by_one() {
    let mut worst: (f64, &str) = (0.0, "");
    for (name, rig) in rigs() {
        let lights = compile(&rig);
        let mut random = Random::new(13);
        for at in 0..6 {
            let (mut p, n) = receiver(&mut random);
            if at == 0 {
                // A receiver that a light touches.
                let [x, y, z, _] = rig[1].transform[3];
                p = Vec3::new(x as f32, y as f32, z as f32) + 1e-4 * n;
            }
            let truth = one_by_one(&lights, p, n, 1500, 5);
            let chosen = irradiance(&lights, p, n, 60_000, 6);
            let z = (chosen.mean - truth.mean).abs() / chosen.error.hypot(truth.error).max(1e-12 + 1e-6 * truth.mean);
            if z > worst.0 {
                worst = (z, name);
            }
        }
    }
    // The largest of 36.
    assert!(worst.0 < 4.0, "{worst:?}");
}

/// Second moment of a choice over its squared mean, contributions being what each light's own estimate says: 1 is perfect.
fn moment(lights: &Lights, p: Vec3, n: Vec3) -> f64 {
    let (mut sum, mut squares) = (0.0, 0.0);
    for light in 0..lights.len() as u32 {
        let given = f64::from(lights.lights[light as usize].importance(p, Some(n)));
        let probability = f64::from(lights.at(0.0).choice_probability(light, p, Some(n), Choice::ONE));
        sum += given;
        if given > 0.0 {
            squares += given * given / probability;
        }
    }
    squares / (sum * sum)
}

#[test]
fn the_tree_comes_near_the_exact_choice() {
    for (name, rig) in rigs() {
        let lights = compile(&rig);
        let mut random = Random::new(14);
        let mut moments: Vec<f64> = (0..200)
            .map(|_| receiver(&mut random))
            .map(|(p, n)| moment(&lights, p, n))
            .filter(|moment| moment.is_finite())
            .collect();
        moments.sort_by(f64::total_cmp);
        let (median, high) = (moments[moments.len() / 2], moments[moments.len() * 9 / 10]);
        println!("{name}: median {median:.2}, nine of ten below {high:.2}");
        // What fills a room at all sizes has no clusters.
        let limits = if name.starts_with("sizes") { [8.0, 25.0] } else { [4.0, 10.0] };
        assert!(median < limits[0] && high < limits[1], "{name}: median {median}, nine of ten below {high}");
    }
}

/// Prints a table: nanoseconds to choose a light and to ask for a probability, by all lights and by the tree, whose second moment
/// stands beside. `cargo test --release --lib light::tests::many::cost -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn cost_against_the_number_of_lights() {
    println!("lights   all: choose  pdf   tree: choose  pdf   moment");
    for count in [4, 8, 12, 16, 24, 32, 64, 128, 512, 2000, 10_000] {
        let rig = crowd(count, [-1.5, -0.5], 3);
        let mut lights = compile(&rig);
        let bounds = lights.lights.iter().enumerate().filter_map(|(i, light)| match light {
            super::super::Light::Area(area) => Some((i as u32, area.bound())),
            _ => None,
        });
        let bounds: Vec<_> = bounds.collect();
        let begun = std::time::Instant::now();
        let tree = super::super::tree::Tree::over(&bounds, count);
        let build = begun.elapsed().as_secs_f64() * 1e3;
        let mut random = Random::new(14);
        let receivers: Vec<_> = (0..200).map(|_| receiver(&mut random)).collect();
        let mut time = |lights: &Lights| {
            let (mut choose, mut pdf, mut picked) = (Vec::new(), Vec::new(), 0.0);
            for (p, n) in &receivers {
                let us: Vec<f32> = (0..20).map(|_| random.next()).collect();
                let begun = std::time::Instant::now();
                let chosen =
                    us.iter().filter_map(|u| lights.at(0.0).draws(*p, Some(*n), Choice::ONE).choose(*u)).map(|c| c.0);
                let chosen: Vec<u32> = chosen.collect();
                choose.push(begun.elapsed().as_nanos() / 20);
                let begun = std::time::Instant::now();
                picked += chosen
                    .iter()
                    .map(|l| lights.at(0.0).choice_probability(*l, *p, Some(*n), Choice::ONE))
                    .sum::<f32>();
                pdf.push(begun.elapsed().as_nanos() / chosen.len().max(1) as u128);
            }
            assert!(picked > 0.0);
            // Medians: others may be at work on this machine.
            [choose, pdf].map(|mut times| *times.select_nth_unstable(100).1)
        };
        lights.beside = (0..count as u32).collect();
        lights.tree = None;
        let [all_choose, all_pdf] = time(&lights);
        (lights.beside, lights.tree) = (Vec::new(), Some(tree));
        let [choose, pdf] = time(&lights);
        let mut moments: Vec<f64> =
            receivers.iter().map(|(p, n)| moment(&lights, *p, *n)).filter(|m| m.is_finite()).collect();
        moments.sort_by(f64::total_cmp);
        let median = moments[moments.len() / 2];
        println!("{count:6} {all_choose:13} {all_pdf:6} {choose:14} {pdf:6} {median:8.2}   built in {build:.2} ms");
    }
}

#[test]
fn parts_hold_every_light_within_the_root() {
    let (_, rig) = rigs().swap_remove(0);
    let lights = compile(&rig);
    let parts = lights.parts();
    let beside = lights.beside.len();
    assert_eq!(beside, 3);
    for light in 0..lights.len() as u32 {
        let holding: Vec<usize> = parts.holding(light).collect();
        if lights.beside.contains(&light) {
            assert_eq!(holding.len(), 1);
        } else {
            assert_eq!(*holding.last().unwrap(), beside);
            assert!(holding.windows(2).all(|pair| pair[0] > pair[1]));
        }
    }
}
