//! Domes and distant lights.

use super::{directions::check_directions, *};
use crate::light::Choice;
use crate::math::PI;
use std::f64::consts::PI as PI64;

const TEXTURE: &str = "/map";

fn dome(pole_axis: &str, transform: Matrix4d) -> flat::Light {
    light(LightShape::Dome { texture: TEXTURE.into(), pole_axis: pole_axis.into() }, transform)
}

fn map(width: u32, height: u32, pixel: impl Fn(u32, u32) -> f32) -> Prims<flat::Texture> {
    let pixels: Vec<[f32; 3]> = (0..width * height).map(|i| [pixel(i % width, i / width); 3]).collect();
    [(TEXTURE.into(), flat::Texture { width, height, pixels: pixels.into(), ..Default::default() })].into()
}

/// A dome of 64 x 32 pixels with one bright one.
fn spot(pole_axis: &str, transform: Matrix4d, column: u32, row: u32) -> Lights {
    let textures = map(64, 32, |x, y| if (x, y) == (column, row) { 1.0 } else { 0.0 });
    compile_with(&[dome(pole_axis, transform)], &textures)
}

/// The bright pixel shines from `direction`, and samples go there.
fn assert_spot(lights: &Lights, direction: [f32; 3], what: &str) {
    let direction = Vec3::from(direction).normalize();
    let mut random = Random::new(1);
    let mut mean = Vec3::ZERO;
    for _ in 0..400 {
        let s = random.sample(lights, Vec3::ZERO, None).unwrap();
        assert_eq!(s.distance, f32::INFINITY);
        mean += s.wi * s.radiance.x / s.pdf;
    }
    assert!(mean.normalize().dot(direction) > 0.995, "{what}: {}", mean.normalize());
    assert!(lights.at(0.0).escaped(0, mean.normalize()).x > 0.4, "{what}");
    assert_eq!(lights.at(0.0).escaped(0, -direction).x, 0.0, "{what}");
}

#[test]
fn the_map_is_oriented_as_openexr_says() {
    // 64 columns from longitude pi to -pi, 32 rows from latitude pi/2: (0, 0) in the middle of the image.
    assert_spot(&spot("Y", IDENTITY, 32, 16), [0.0, 0.0, 1.0], "latitude 0, longitude 0");
    assert_spot(&spot("Y", IDENTITY, 16, 16), [1.0, 0.0, 0.0], "latitude 0, longitude pi/2");
    assert_spot(&spot("Y", IDENTITY, 48, 16), [-1.0, 0.0, 0.0], "latitude 0, longitude -pi/2");
    assert_spot(&spot("Y", IDENTITY, 0, 16), [0.0, 0.0, -1.0], "longitude pi");
    assert_spot(&spot("Y", IDENTITY, 63, 16), [0.0, 0.0, -1.0], "longitude -pi");
    assert_spot(&spot("Y", IDENTITY, 5, 0), [0.0, 1.0, 0.0], "latitude pi/2");
    assert_spot(&spot("Y", IDENTITY, 5, 31), [0.0, -1.0, 0.0], "latitude -pi/2");
    let diagonal = [(PI / 4.0).sin(), 1.0, (PI / 4.0).cos()];
    assert_spot(&spot("Y", IDENTITY, 24, 8), diagonal, "latitude pi/4, longitude pi/4");
}

#[test]
fn pole_axis_z_turns_the_map() {
    assert_spot(&spot("Z", IDENTITY, 32, 16), [0.0, -1.0, 0.0], "latitude 0, longitude 0");
    assert_spot(&spot("Z", IDENTITY, 16, 16), [1.0, 0.0, 0.0], "latitude 0, longitude pi/2");
    assert_spot(&spot("Z", IDENTITY, 5, 0), [0.0, 0.0, 1.0], "latitude pi/2");
    assert_spot(&spot("Z", IDENTITY, 5, 31), [0.0, 0.0, -1.0], "latitude -pi/2");
}

#[test]
fn domes_turn_with_their_transform() {
    // rotateY 90 takes +Z to +X.
    let turned = matrix([0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [7.0, 8.0, 9.0]);
    assert_spot(&spot("Y", turned, 32, 16), [1.0, 0.0, 0.0], "rotateY 90");
    // rotateX 90 takes -Y to -Z.
    let turned = matrix([3.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, -3.0, 0.0], [0.0; 3]);
    assert_spot(&spot("Z", turned, 32, 16), [0.0, 0.0, -1.0], "rotateX 90, scaled by 3");
    let mirrored = matrix([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
    assert_spot(&spot("Y", mirrored, 16, 16), [-1.0, 0.0, 0.0], "mirrored");
}

#[test]
fn furnace() {
    let n = Vec3::new(0.48, 0.6, 0.64);
    let plain = light(LightShape::Dome { texture: String::new(), pole_axis: "Y".into() }, IDENTITY);
    let e = irradiance(&compile(std::slice::from_ref(&plain)), Vec3::ZERO, n, 1000, 1);
    // The receiver's cosine is the pdf: no noise at all.
    assert!((e.mean - PI64).abs() < 1e-5 && e.error < 1e-6, "{e:?}");
    let textured = compile_with(&[dome("Z", IDENTITY)], &map(7, 3, |_, _| 1.0));
    assert_agrees(irradiance(&textured, Vec3::ZERO, n, 100_000, 1), PI64, 1e-6, "white map");
    // normalize does not apply to domes.
    let normalized = compile(&[flat::Light { normalize: true, ..plain }]);
    assert_eq!(normalized.at(0.0).escaped(0, n), Vec3::ONE);
}

/// A smooth but lopsided map with a small sun.
fn sky() -> Prims<flat::Texture> {
    map(32, 16, |x, y| if (x, y) == (9, 3) { 300.0 } else { (x as f32 * 0.3).sin() + 1.0 + 0.1 * y as f32 })
}

/// Irradiance by a midpoint sum over directions.
fn direction_sum(lights: &Lights, light: u32, n: Vec3) -> f64 {
    let (rows, columns) = (400, 800);
    let mut sum = 0.0;
    for i in 0..rows * columns {
        let y = ((i % rows) as f64 + 0.5) / rows as f64 * 2.0 - 1.0;
        let (sin, cos) = (2.0 * PI64 * ((i / rows) as f64 + 0.5) / columns as f64).sin_cos();
        let r = (1.0 - y * y).sqrt();
        let wi = glam::DVec3::new(r * cos, y, r * sin).as_vec3();
        sum += f64::from(lights.at(0.0).escaped(light, wi).x * n.dot(wi).max(0.0));
    }
    sum * 4.0 * PI64 / (rows * columns) as f64
}

#[test]
fn irradiance_of_a_sky() {
    for (name, transform) in placements([5.0, 0.0, 0.0]) {
        for pole in ["Y", "Z"] {
            let lights = compile_with(&[dome(pole, transform)], &sky());
            let n = Vec3::new(0.48, 0.6, -0.64);
            let truth = direction_sum(&lights, 0, n);
            let e = irradiance(&lights, Vec3::ZERO, n, 240_000, 2);
            assert_agrees(e, truth, 1e-3, &format!("{name} {pole}"));
        }
    }
}

#[test]
fn sky_directions_are_distributed_as_the_pdf_says() {
    for (name, transform) in placements([5.0, 0.0, 0.0]) {
        let lights = compile_with(&[dome("Z", transform)], &sky());
        let pdf = |wi: Vec3| lights.at(0.0).pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, wi);
        check_directions(&lights, Vec3::ZERO, None, (Vec3::Y, -1.0), pdf, name);
    }
    for n in [None, Some(Vec3::new(0.0, 0.6, 0.8))] {
        let lights = compile(&[light(LightShape::Dome { texture: String::new(), pole_axis: "Y".into() }, IDENTITY)]);
        let pdf = |wi: Vec3| lights.at(0.0).pdf_escaped(0, Vec3::ZERO, n, Choice::ONE, wi);
        check_directions(&lights, Vec3::ZERO, n, (Vec3::new(0.0, 0.6, 0.8), -1.0), pdf, "plain dome");
    }
}

#[test]
fn sampled_pdfs_are_the_evaluated_ones_and_no_light_is_missed() {
    let lights = compile_with(&[dome("Y", placements([0.0; 3])[1].1)], &sky());
    let mut random = Random::new(4);
    let mut differing = 0;
    for _ in 0..2000 {
        let s = random.sample(&lights, Vec3::ZERO, None).unwrap();
        let pdf = lights.at(0.0).pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, s.wi);
        // Rounding may put a direction at a pixel's edge into its neighbour.
        differing += u32::from((pdf / s.pdf - 1.0).abs() > 1e-3);
    }
    assert!(differing < 5, "{differing}");
    let one = spot("Y", IDENTITY, 3, 0);
    for _ in 0..20_000 {
        let wi = crate::sampling::uniform_sphere(random.next_2d());
        let dark = one.at(0.0).escaped(0, wi).x == 0.0;
        assert!(dark || one.at(0.0).pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, wi) > 0.0);
    }
}

#[test]
fn one_pixel_of_a_large_dome_holds_all_the_light() {
    let textures = map(4096, 2048, |x, y| if (x, y) == (3000, 500) { 1e9 } else { 1e-3 });
    let lights = compile_with(&[dome("Y", IDENTITY)], &textures);
    let theta = PI64 * 500.5 / 2048.0;
    let (sun, cell) = (theta.cos(), 2.0 * PI64 / 4096.0 * PI64 / 2048.0 * theta.sin());
    let e = irradiance(&lights, Vec3::ZERO, Vec3::Y, 60_000, 5);
    assert_agrees(e, 1e9 * cell * sun + 1e-3 * PI64, 1e-3, "sun");
}

#[test]
fn a_normalized_distant_light_gives_its_intensity_in_lux() {
    for angle in [0.0, 0.001, 0.53, 20.0, 90.0, 180.0] {
        let lights = compile(&[flat::Light { normalize: true, intensity: 7.0, ..distant(angle) }]);
        let e = irradiance(&lights, Vec3::ZERO, Vec3::Z, 60_000, 6);
        assert_agrees(e, 7.0, 1e-5, &format!("{angle} degrees"));
        assert_eq!(lights.infinite().len(), usize::from(angle > 0.1));
    }
}

#[test]
fn beyond_half_a_turn_the_distant_formula_counts_both_sides() {
    // Front and back of a plate together receive pi L (2 - sin^2).
    let lights = compile(&[flat::Light { normalize: true, intensity: 7.0, ..distant(250.0) }]);
    let both = irradiance(&lights, Vec3::ZERO, Vec3::Z, 60_000, 6).mean
        + irradiance(&lights, Vec3::ZERO, Vec3::NEG_Z, 60_000, 7).mean;
    assert!((both / 7.0 - 1.0).abs() < 0.01, "{both}");
}

#[test]
fn distant_radiance_is_that_of_the_cone() {
    let lights = compile(&[flat::Light { intensity: 2.0, ..distant(40.0) }]);
    let n = Vec3::new(0.6, 0.0, 0.8);
    assert_agrees(irradiance(&lights, Vec3::ZERO, n, 60_000, 6), direction_sum(&lights, 0, n), 2e-3, "40 degrees");
    let pdf = |wi: Vec3| lights.at(0.0).pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, wi);
    check_directions(&lights, Vec3::ZERO, None, (Vec3::Z, 0.9), pdf, "40 degrees");
    let s = lights.at(0.0).sample(Vec3::ZERO, None, Choice::ONE, 0.5, Vec2::splat(0.2)).unwrap();
    assert!((pdf(s.wi) / s.pdf - 1.0).abs() < 1e-6 && lights.at(0.0).escaped(0, s.wi) == s.radiance);
}

#[test]
fn angle_zero_is_a_single_direction() {
    let transform = matrix([0.0, 0.0, -4.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [7.0, 8.0, 9.0]);
    let lights = compile(&[flat::Light { transform, intensity: 3.0, ..distant(0.0) }]);
    let s = lights.at(0.0).sample(Vec3::ONE, Some(Vec3::X), Choice::ONE, 0.9, Vec2::splat(0.3)).unwrap();
    assert!(s.delta && s.pdf == 1.0 && s.wi.abs_diff_eq(Vec3::X, 1e-6) && s.radiance == Vec3::splat(3.0));
    assert!(lights.infinite().is_empty());
    assert_eq!(lights.at(0.0).escaped(0, s.wi), Vec3::ZERO);
    assert_eq!(lights.at(0.0).pdf_escaped(0, Vec3::ONE, None, Choice::ONE, s.wi), 0.0);
}

/// Integral of red radiance times max(0, cos) over the sphere, by its own lookup: midpoints within each pixel, in f64.
fn map_sum(pixels: &dyn Fn(u32, u32) -> f32, (w, h): (u32, u32), n: Vec3) -> f64 {
    let at = |x: i64, y: i64| f64::from(pixels(x.rem_euclid(w.into()) as u32, y.clamp(0, i64::from(h) - 1) as u32));
    let (columns, rows) = (w * 600_u32.div_ceil(w), h * 600_u32.div_ceil(h));
    let mut sum = 0.0;
    for i in 0..rows {
        let t = (f64::from(i) + 0.5) / f64::from(rows);
        let edge = |i: u32| (PI64 * f64::from(i) / f64::from(rows)).cos();
        let solid_angle = (edge(i) - edge(i + 1)) * 2.0 * PI64 / f64::from(columns);
        let (y, sin, cos) = (t * f64::from(h) - 0.5, (PI64 * t).sin(), (PI64 * t).cos());
        for j in 0..columns {
            let s = (f64::from(j) + 0.5) / f64::from(columns);
            let x = s * f64::from(w) - 0.5;
            let longitude = PI64 * (1.0 - 2.0 * s);
            let wi = DVec3::new(sin * longitude.sin(), cos, sin * longitude.cos());
            let cosine = n.as_dvec3().dot(wi).max(0.0);
            if cosine > 0.0 {
                let (x0, y0) = (x.floor(), y.floor());
                let line = |j: i64| at(x0 as i64, j) * (1.0 - x + x0) + at(x0 as i64 + 1, j) * (x - x0);
                let value = line(y0 as i64) * (1.0 - y + y0) + line(y0 as i64 + 1) * (y - y0);
                sum += value * cosine * solid_angle;
            }
        }
    }
    sum
}

/// A number in [0, 1) by pixel, skewed so that some are bright.
fn noise(x: u32, y: u32) -> f32 {
    let h = (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0xc2b2_ae35);
    0.01 + ((h >> 8) as f32 / 16_777_216.0).powi(6)
}

#[test]
fn maps_of_any_resolution_give_their_integral() {
    let n = Vec3::new(0.48, 0.6, -0.64);
    for (w, h) in [(1, 1), (2, 1), (1, 2), (2, 2), (3, 5), (7, 3), (127, 61), (1, 64), (64, 1)] {
        let hot = |x: u32, y: u32| if (x, y) == (w / 3, h / 2) { 1e4 } else { 0.0 };
        for name in ["noise", "hot"] {
            let pixel = |x: u32, y: u32| if name == "hot" { hot(x, y) } else { noise(x, y) };
            let lights = compile_with(&[dome("Y", IDENTITY)], &map(w, h, pixel));
            for n in [n, -n] {
                let truth = map_sum(&pixel, (w, h), n);
                let e = irradiance(&lights, Vec3::ZERO, n, 60_000, 2);
                let slack = 1e-3 * truth + 1e-9;
                let what = format!("{name} {w} x {h}: {e:?}, true {truth}");
                assert!((e.mean - truth).abs() <= 4.0 * e.error + slack, "{what}");
            }
            let pdf = |wi: Vec3| lights.at(0.0).pdf_escaped(0, Vec3::ZERO, None, Choice::ONE, wi);
            // What one pixel of many holds is too small for the bins.
            if name == "noise" {
                check_directions(&lights, Vec3::ZERO, None, (Vec3::Y, -1.0), pdf, &format!("{w} x {h}"));
            }
        }
    }
}

#[test]
fn a_sun_of_one_pixel_is_sampled_as_it_is_looked_up() {
    let textures = map(1024, 512, |x, y| if (x, y) == (700, 130) { 1e6 } else { 1e-3 });
    let lights = compile_with(&[dome("Y", IDENTITY)], &textures);
    let mut random = Random::new(3);
    let weights = estimate(20_000, || {
        let s = random.sample(&lights, Vec3::ZERO, None).unwrap();
        f64::from(s.radiance.x / s.pdf)
    });
    // Against the pixel's square the bilinear lookup would vary by as much as its mean.
    let deviation = weights.error * f64::from(20_000).sqrt();
    assert!(deviation < 0.02 * weights.mean, "{weights:?}");
}

/// Prints memory and time for a map of 8192 x 4096.
/// `cargo test --release --lib light::tests::infinite::an_8k -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn an_8k_map_takes_this_long() {
    let textures = map(8192, 4096, noise);
    let begun = std::time::Instant::now();
    let lights = compile_with(&[dome("Y", IDENTITY)], &textures);
    println!("compiled in {:.2} s", begun.elapsed().as_secs_f64());
    let mut random = Random::new(5);
    let mut sum = 0.0;
    let mut times: Vec<u128> = (0..2000)
        .map(|_| {
            let begun = std::time::Instant::now();
            sum += (0..100).map(|_| random.sample(&lights, Vec3::ZERO, None).map_or(0.0, |s| s.wi.x)).sum::<f32>();
            begun.elapsed().as_nanos() / 100
        })
        .collect();
    // The median: others may be at work on this machine.
    println!("{} ns per sample ({sum})", times.select_nth_unstable(1000).1);
}
