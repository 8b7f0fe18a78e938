//! What is inside what, and is said: the bodies that the camera is in, and lights that no light comes out of.

use super::Scene;
use super::company::{Around, Company};
use crate::bsdf::Boundary;
use crate::error::Warning;
use crate::flat::FlatScene;
use glam::{Vec2, Vec3};

/// Finds where the camera is, counts the company of media, and warns of what gives a black picture.
pub(super) fn look_around(scene: &mut Scene, flat: &FlatScene, warnings: &mut Vec<Warning>) {
    let paths: Vec<&String> = flat.meshes.keys().collect();
    for company in scene.companies.iter().flatten() {
        match company.as_ref() {
            Company::Guests { .. } => scene.needs.hosts += 1,
            Company::Set(_) => scene.needs.in_sets += 1,
        }
    }
    scene.needs.alike = scene.alike.iter().enumerate().filter(|(i, first)| *i != **first as usize).count() as u32;
    scene.camera_within = around_camera(scene, &paths, warnings);
    scene.needs.around_camera = scene.camera_within.len() as u32;
    warn_of_lights(scene, &paths, warnings);
}

/// Where the ray through the middle of the image begins.
fn around_camera(scene: &Scene, paths: &[&String], warnings: &mut Vec<Warning>) -> Vec<Around> {
    let needs = &scene.needs;
    if needs.clear_media + needs.diffuse_media + needs.dielectric_media + needs.index_matched_media == 0 {
        return Vec::new();
    }
    let [x, y] = scene.camera.size.map(|n| n as f32 * 0.5);
    let moment = scene.middle();
    let ray = scene.camera.ray(Vec2::new(x, y), Vec2::splat(0.5), moment.time);
    let (diffuse, open): (Vec<Around>, Vec<Around>) =
        moment.around(ray.o, u32::MAX).into_iter().partition(|body| scene.is_opaque(body));
    for body in diffuse {
        let message = "the camera is inside this body, whose boundary is diffuse: it is opaque from within, and black";
        warnings.push(Warning::new(path(scene, paths, &body), message));
    }
    open
}

/// Lights whose middle is behind a diffuse boundary.
fn warn_of_lights(scene: &Scene, paths: &[&String], warnings: &mut Vec<Warning>) {
    if scene.needs.diffuse_media == 0 {
        return;
    }
    let shapes = scene.lights.shapes().map(|(light, (min, max))| (light, (min + max) * 0.5, u32::MAX));
    let meshes = scene.instances.iter().enumerate().filter_map(|(i, instance)| {
        let time = scene.middle().time;
        let p = instance.placed(time).point(instance.geometry.corners(0, time)[0]);
        Some((instance.light?.0, p, i as u32))
    });
    let lights: Vec<(u32, Vec3, u32)> = shapes.chain(meshes).collect();
    for (light, p, own) in lights {
        if let Some(body) = scene.middle().around(p, own).iter().find(|body| scene.is_opaque(body)) {
            let body = path(scene, paths, body);
            let message = format!(
                "this light is inside {body}, whose boundary is diffuse: walks see no light within, so it gives none; \
                 inputs:subsurfaceBoundary dielectric or indexMatched lets it out"
            );
            warnings.push(Warning::new(scene.lights.path(light), message));
        }
    }
}

impl Scene {
    /// Whether no path gets into a body but to walk out of it.
    pub fn is_opaque(&self, body: &Around) -> bool {
        self.surfaces[body.surface as usize].interior.is_some_and(|interior| interior.boundary == Boundary::Diffuse)
    }
}

fn path<'a>(scene: &Scene, paths: &[&'a String], body: &Around) -> &'a str {
    paths[scene.instances[body.instance as usize].prim_id as usize]
}
