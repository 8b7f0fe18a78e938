//! Meshes that are lights, and what lights are linked to.

use super::Instance;
use crate::error::Warning;
use crate::flat::{self, FlatScene, LightShape};
use crate::light::{Categories, Lights, Members};
use glam::{DVec3, Vec3};
use std::collections::{BTreeMap, BTreeSet};

/// Meshes that are lights, too: they keep their shape, which the lights know at the frame alone.
pub(super) fn emitting_meshes(flat: &FlatScene) -> BTreeSet<&str> {
    let shapes = flat.lights.values().map(|light| &light.shape);
    shapes.filter_map(|shape| if let LightShape::Mesh { mesh } = shape { Some(mesh.as_str()) } else { None }).collect()
}

/// Compiles the lights and tells instances of mesh lights which triangles are theirs.
pub(super) fn compile_lights(
    flat: &FlatScene,
    origin: DVec3,
    instances: &mut [Instance],
    warnings: &mut Vec<Warning>,
) -> Lights {
    let paths: Vec<&String> = flat.meshes.keys().collect();
    let emitters = emitters(flat, &paths, instances);
    let triangles = |mesh: &str| emitters.get(mesh).cloned();
    let lights = Lights::compile(&flat.lights, &flat.textures, &triangles, origin, flat.moves(), warnings);
    let mut next: BTreeMap<i32, u32> = BTreeMap::new();
    for instance in instances {
        let Some(light) = lights.mesh_light(paths[instance.prim_id as usize]) else { continue };
        let first = next.entry(instance.prim_id).or_default();
        instance.light = Some((light, *first));
        if instance.moves.is_some() && !lights.moves(light) {
            let message =
                "its transform changes while the shutter is open, that of its light does not: it stays where it is";
            warnings.push(Warning::new(paths[instance.prim_id as usize], message));
            instance.moves = None;
        }
        if instance.moves.is_some()
            && let Some(kept) = lights.kept_size(light, &instance.to_render)
        {
            instance.moves = Some(Box::new(kept));
        }
        *first += instance.geometry.triangles.len() as u32;
    }
    lights
}

/// Instances whose light is asked about for what belongs to no light.
const PLACES: usize = 64;

/// Tells instances which sets of categories are theirs, and lights which ones they are for.
pub(super) fn link(
    flat: &FlatScene,
    instances: &mut [Instance],
    lights: &mut Lights,
    warnings: &mut Vec<Warning>,
) -> Members {
    let mut categories = Categories::of(&flat.lights);
    if !categories.is_empty() {
        let meshes: Vec<&flat::Mesh> = flat.meshes.values().collect();
        for of_mesh in instances.chunk_by_mut(|a, b| a.prim_id == b.prim_id) {
            let set = categories.set(&meshes[of_mesh[0].prim_id as usize].categories);
            of_mesh.iter_mut().for_each(|instance| instance.categories = set);
        }
    }
    lights.link(&flat.lights, &categories);
    let some = instances.iter().step_by(instances.len().div_ceil(PLACES).max(1));
    let places: Vec<Vec3> = some.map(|instance| instance.to_render.translation).collect();
    lights.group(&flat.settings.aovs, &flat.lights, &places, warnings);
    categories.members()
}

/// Triangles of mesh lights in render space, by mesh path.
fn emitters<'a>(
    flat: &'a FlatScene,
    paths: &[&'a String],
    instances: &[Instance],
) -> BTreeMap<&'a str, Vec<[Vec3; 3]>> {
    let emitting = emitting_meshes(flat);
    let mut emitters: BTreeMap<&str, Vec<[Vec3; 3]>> = BTreeMap::new();
    if emitting.is_empty() {
        return emitters;
    }
    for instance in instances {
        let path = paths[instance.prim_id as usize].as_str();
        if emitting.contains(path) {
            emitters.entry(path).or_default().extend(render_triangles(instance));
        }
    }
    emitters
}

/// Triangles of an instance in render space, wound so that their front is the mesh's front.
fn render_triangles(instance: &Instance) -> impl Iterator<Item = [Vec3; 3]> + '_ {
    let mirrored = instance.to_render.linear.determinant() < 0.0;
    (0..instance.geometry.triangles.len() as u32).map(move |i| {
        let [a, b, c] = instance.geometry.corners(i, 0.0).map(|p| instance.to_render.point(p));
        if mirrored { [a, c, b] } else { [a, b, c] }
    })
}
