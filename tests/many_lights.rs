//! A picture lit by a few rectangles, and by the hundreds of tiles that they are cut into: the same, however lights are drawn.

mod support;

use dermis::flat::{Light, LightShape, Material, PreviewSurface, RenderSettings, Shaping};
use glam::{DMat3, DVec3};
use support::{camera, plane, render, scene, settings, sphere};

const SIZE: u32 = 20;
const SAMPLES: u32 = 192;

/// A rectangle at `eye` that shines towards the origin, cut into `tiles`^2.
fn rect(eye: DVec3, size: f64, color: [f32; 3], shaping: Option<Shaping>, tiles: u32) -> Vec<Light> {
    let z = eye.normalize();
    let x = DVec3::new(0.3, 1.0, 0.2).cross(z).normalize();
    let axes = DMat3::from_cols(x, z.cross(x), z);
    let edge = size / f64::from(tiles);
    let tile = |i: u32| {
        let at = |k: u32| (f64::from(k) + 0.5) * edge - 0.5 * size;
        let centre = eye + axes * DVec3::new(at(i % tiles), at(i / tiles), 0.0);
        let row = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
        Light {
            shape: LightShape::Rect { width: edge as f32, height: edge as f32, texture: String::new() },
            transform: [row(axes.x_axis, 0.0), row(axes.y_axis, 0.0), row(axes.z_axis, 0.0), row(centre, 1.0)],
            color,
            shaping: shaping.clone(),
            ..Light::default()
        }
    };
    (0..tiles * tiles).map(tile).collect()
}

/// From near, from behind and below, a spot, and a dim sky.
fn lights(tiles: u32) -> Vec<Light> {
    let sky = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    let cone = Shaping { cone_angle: 25.0, cone_softness: 0.5, focus: 2.0, ..Default::default() };
    [
        rect(DVec3::new(1.2, 1.0, 0.9), 0.8, [3.0, 2.0, 1.0], None, tiles),
        rect(DVec3::new(-1.5, -2.0, -2.0), 2.0, [2.0, 3.0, 6.0], None, tiles),
        rect(DVec3::new(-2.0, 3.0, 2.5), 0.6, [30.0, 30.0, 30.0], Some(cone), tiles),
        vec![Light { shape: sky, intensity: 0.1, ..Light::default() }],
    ]
    .concat()
}

fn picture(medium: &PreviewSurface, tiles: u32, settings: RenderSettings) -> Vec<f32> {
    let eye = camera(DVec3::new(0.5, 0.8, 4.0), 40.0);
    let mut delegate = scene(sphere(16, 1.0), Material::UsdPreviewSurface(medium.clone()), lights(tiles), eye);
    plane(&render(&mut delegate, settings), "color").to_vec()
}

/// Largest |z| of the differences' sums, over quarters and channels: pixels are independent, each expected to be zero.
fn largest_z(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [[(0.0, 0.0_f64); 3]; 4];
    for (i, (a, b)) in a.chunks(4).zip(b.chunks(4)).enumerate() {
        let (x, y) = (i % SIZE as usize, i / SIZE as usize);
        let quarter = &mut sums[2 * x / SIZE as usize + 2 * (2 * y / SIZE as usize)];
        for c in 0..3 {
            let difference = f64::from(a[c]) - f64::from(b[c]);
            quarter[c].0 += difference;
            quarter[c].1 += difference * difference;
        }
    }
    sums.as_flattened().iter().map(|(sum, squares)| sum.abs() / squares.sqrt().max(1e-9)).fold(0.0, f64::max)
}

#[test]
fn many_lights_give_the_picture_of_few() {
    let medium = |boundary: &'static str| PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some([0.95, 0.9, 0.8]),
        subsurface_radius: [0.2, 0.15, 0.1],
        subsurface_boundary: boundary.into(),
        ior: if boundary == "indexMatched" { 1.0 } else { 1.4 },
        roughness: 0.5,
        ..PreviewSurface::default()
    };
    let plain = PreviewSurface { subsurface: 0.0, roughness: 0.4, ..PreviewSurface::default() };
    let materials = [("plain", plain), ("diffuse", medium("diffuse")), ("matched", medium("indexMatched"))];
    for (name, material) in materials {
        let few = picture(&material, 1, RenderSettings { seed: 77, ..settings(SIZE, 2 * SAMPLES) });
        for (tiles, exit_lights) in [(12, "auto"), (12, "one"), (4, "all")] {
            let asked = RenderSettings { exit_lights: exit_lights.into(), seed: tiles, ..settings(SIZE, SAMPLES) };
            let many = picture(&material, tiles, asked);
            let z = largest_z(&few, &many);
            println!("{name}, {} lights, {exit_lights}: z {z:.2}", 3 * tiles * tiles + 1);
            // The largest of 108.
            assert!(z < 4.2, "{name}, exitLights {exit_lights}: {z}");
        }
    }
}
