//! Small scenes built in code, and statistics over images, for the integration tests.
#![allow(dead_code)] // each test binary uses its own part

pub mod chi_square;
pub mod difference;
pub mod in_f64;
pub mod slab;
pub mod ways;

use dermis::delegate::{DirtyBits, RenderDelegate};
use dermis::flat::{Array, Camera, Light, LightShape, Material, Mesh, Prim, RenderSettings};
use glam::{DVec3, Vec3};

/// A closed sphere of flat triangles, outward winding; `n` rings, 2 n segments.
pub fn sphere(n: usize, radius: f32) -> Mesh {
    let point = |ring: usize, segment: usize| {
        let theta = std::f32::consts::PI * ring as f32 / n as f32;
        let phi = std::f32::consts::PI * segment as f32 / n as f32;
        [radius * theta.sin() * phi.cos(), radius * theta.cos(), -radius * theta.sin() * phi.sin()]
    };
    let (south, segments) = ((n - 1) * 2 * n + 1, 2 * n);
    let mut points = vec![[0.0, radius, 0.0]];
    points.extend((1..n).flat_map(|ring| (0..segments).map(move |segment| (ring, segment))).map(|(r, s)| point(r, s)));
    points.push([0.0, -radius, 0.0]);
    let at = |ring: usize, segment: usize| match ring {
        0 => 0,
        _ if ring == n => south as i32,
        _ => (1 + (ring - 1) * segments + segment % segments) as i32,
    };
    let mut indices = Vec::new();
    for ring in 0..n {
        for segment in 0..segments {
            let quad = [at(ring, segment), at(ring + 1, segment), at(ring + 1, segment + 1), at(ring, segment + 1)];
            if ring + 1 < n {
                indices.extend([quad[0], quad[1], quad[2]]);
            }
            if ring > 0 {
                indices.extend(if ring + 1 < n { [quad[0], quad[2], quad[3]] } else { [quad[0], quad[1], quad[3]] });
            }
        }
    }
    mesh(points, vec![3; indices.len() / 3], indices)
}

/// An axis-aligned box, outward quads.
pub fn cuboid(half: Vec3) -> Mesh {
    let points = (0..8)
        .map(|i| [[-1.0, 1.0][i & 1] * half.x, [-1.0, 1.0][i >> 1 & 1] * half.y, [-1.0, 1.0][i >> 2] * half.z])
        .collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    mesh(points, vec![4; 6], quads.concat())
}

pub fn mesh(points: Vec<[f32; 3]>, counts: Vec<i32>, indices: Vec<i32>) -> Mesh {
    Mesh {
        points: points.into(),
        face_vertex_counts: counts.into(),
        face_vertex_indices: indices.into(),
        material: "/M".into(),
        ..Mesh::default()
    }
}

/// A camera at `eye` looking at the origin, square, field of view in degrees.
pub fn camera(eye: DVec3, fov: f32) -> Camera {
    let back = eye.normalize();
    let right = DVec3::Y.cross(back).try_normalize().unwrap_or(DVec3::X);
    let up = back.cross(right);
    let row = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
    Camera {
        transform: [row(right, 0.0), row(up, 0.0), row(back, 0.0), row(eye, 1.0)],
        horizontal_aperture: 20.0,
        vertical_aperture: 20.0,
        focal_length: 10.0 / (fov.to_radians() * 0.5).tan(),
        clipping_range: [1e-6, 1e9],
        ..Camera::default()
    }
}

/// A dome of radiance 1 that the camera sees too (through matched boundaries it looks straight at it).
pub fn furnace() -> Light {
    let shape = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    Light { shape, camera_visible: true, ..Light::default() }
}

pub fn settings(size: u32, samples: u32) -> RenderSettings {
    RenderSettings { camera: "/C".into(), resolution: [size, size], samples, ..RenderSettings::default() }
}

/// A scene of one mesh `/O` with material `/M`, seen by `/C`.
pub fn scene(mesh: Mesh, material: Material, lights: Vec<Light>, camera: Camera) -> RenderDelegate {
    let mut delegate = RenderDelegate::new();
    delegate.sync("/O", Prim::Mesh(mesh), DirtyBits::ALL);
    delegate.sync("/M", Prim::Material(material), DirtyBits::ALL);
    delegate.sync("/C", Prim::Camera(camera), DirtyBits::ALL);
    for (i, light) in lights.into_iter().enumerate() {
        delegate.sync(&format!("/L{i}"), Prim::Light(light), DirtyBits::ALL);
    }
    delegate
}

/// Renders to the end; planes by name.
pub fn render(delegate: &mut RenderDelegate, settings: RenderSettings) -> Vec<dermis::film::Plane> {
    delegate.set_settings(settings).expect("settings");
    delegate.commit().expect("commit");
    delegate.start().expect("start");
    while !delegate.poll().expect("poll").1 {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    delegate.snapshot().2
}

pub fn plane<'a>(planes: &'a [dermis::film::Plane], name: &str) -> &'a [f32] {
    &planes.iter().find(|p| p.name == name).unwrap_or_else(|| panic!("no AOV {name}")).values
}

/// Mean over the pixels, and its standard error from the spread of pixels (which are independent).
pub fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// One channel of RGBA pixels.
pub fn channel(color: &[f32], c: usize) -> Vec<f64> {
    color.iter().skip(c).step_by(4).map(|&x| f64::from(x)).collect()
}

pub fn array<T>(values: Vec<T>) -> Array<T> {
    values.into()
}
