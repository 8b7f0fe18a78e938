//! A mesh instance as a boundary: the surface point closest to a point inside, in the space of the walk.

mod support;

use dermis::flat::{Material, Matrix4d, PreviewSurface};
use dermis::sampling::sampler::Sampler;
use dermis::scene::{InstanceEnclosure, Scene};
use glam::{DVec3, Vec3};
use std::sync::Arc;
use support::{camera, scene, settings, sphere};

/// A sphere of radius 1, 40 rings, placed by `transform`.
fn placed(transform: Matrix4d) -> Arc<Scene> {
    let mut mesh = sphere(40, 1.0);
    mesh.transform = transform;
    let material = Material::UsdPreviewSurface(PreviewSurface::default());
    let mut delegate = scene(mesh, material, vec![], camera(DVec3::new(0.0, 0.0, 9.0), 20.0));
    delegate.set_settings(settings(8, 1)).expect("settings");
    delegate.commit().expect("commit");
    delegate.scene().expect("scene").clone()
}

/// Least distance from `p` to any of many points of every triangle.
fn sampled_distance(scene: &Scene, p: Vec3) -> f32 {
    let instance = &scene.instances[0];
    let steps = (0..=6).flat_map(|i| (0..=6 - i).map(move |j| (i as f32 / 6.0, j as f32 / 6.0)));
    let steps: Vec<_> = steps.collect();
    (0..instance.geometry.triangles.len() as u32)
        .flat_map(|t| {
            let [a, b, c] = instance.geometry.corners(t, 0.0).map(|q| instance.to_render.linear * q);
            steps.iter().map(move |&(u, v)| (a + u * (b - a) + v * (c - a)).distance(p))
        })
        .fold(f32::INFINITY, f32::min)
}

#[test]
fn closest_point_is_closest_in_walk_space() {
    let translated = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [5.0, -3.0, 100.0, 1.0]];
    let sheared = [[2.0, 0.3, 0.0, 0.0], [-0.2, 0.5, 0.1, 0.0], [0.4, 0.0, -1.0, 0.0], [5.0, -3.0, 100.0, 1.0]];
    for (i, transform) in [translated, sheared].into_iter().enumerate() {
        let compiled = placed(transform);
        let enclosure = InstanceEnclosure::new(compiled.at(0.0), 0);
        let mut sampler = Sampler::new(i as u32, 4, 5);
        for _ in 0..100 {
            let local = Vec3::new(sampler.random(), sampler.random(), sampler.random()) * 2.0 - 1.0;
            let p = compiled.instances[0].to_render.linear * local;
            let found = enclosure.closest_point(p).expect("a surface");
            // Sample points lie at most their spacing (edge .08, sixths, stretched by 2) from the nearest one.
            let (distance, sampled) = (found.distance(p), sampled_distance(&compiled, p));
            assert!(distance <= sampled + 1e-5, "{distance} of {sampled} from {p}");
            assert!(sampled <= distance + 0.03, "{distance} of {sampled} from {p}");
            assert!(sampled_distance(&compiled, found) < 0.03, "{found} is not on the surface");
        }
    }
}
