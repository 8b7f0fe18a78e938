//! The ways of things over the shutter where the picture is sharp all the same: motion vectors ask for them, and nothing
//! else does. The scene itself is that of the frame.

use super::compile::GeometryCache;
use super::displace::Displacement;
use super::image::ImageCache;
use super::motion::{combined, multiply};
use super::{Deformation, Geometry, Instance, Moves};
use crate::camera::Camera;
use crate::film::OnSurface;
use crate::flat::{self, FlatScene};
use crate::math::Affine;
use glam::Vec2;
use std::collections::BTreeMap;

pub struct Tracks {
    camera: Camera,
    /// By instance, of those that move.
    places: BTreeMap<u32, Moves>,
    /// By mesh, of those that deform.
    shapes: BTreeMap<i32, Deformation>,
}

impl Tracks {
    /// `None` where nobody asks for them.
    pub fn of(
        flat: &FlatScene,
        camera: &flat::Camera,
        instances: &[Instance],
        cache: &GeometryCache,
        images: &ImageCache,
    ) -> Option<Box<Self>> {
        if !flat.has_tracks() {
            return None;
        }
        let settings = flat::RenderSettings { disable_motion_blur: false, ..flat.settings.clone() };
        let camera = Camera::compile(camera, &settings);
        let (mut places, mut shapes) = (BTreeMap::new(), BTreeMap::new());
        let meshes: Vec<(&String, &flat::Mesh)> = flat.meshes.iter().collect();
        let mut first = 0;
        for of_mesh in instances.chunk_by(|a, b| a.prim_id == b.prim_id) {
            let (prim_id, geometry) = (of_mesh[0].prim_id, &of_mesh[0].geometry);
            let (path, mesh) = meshes[prim_id as usize];
            let ways = placements(flat, mesh).filter_map(|keys| {
                let place = |m: &flat::Matrix4d| Affine::from_usd(m, geometry.centre, camera.origin);
                place(&keys.frame).map(|_| keys.moves.and_then(|moves| Moves::new_by(moves, place)))
            });
            let moving = (first..).zip(ways).filter_map(|(i, way)| Some((i, way?)));
            places.extend(moving);
            first += of_mesh.len() as u32;
            if cache.contains_key(path) && mesh.point_keys.is_some() {
                let displacement = Displacement::of(mesh, &flat.materials, images);
                let moving = Geometry::compile(mesh.clone(), geometry.asked_level(), true, displacement, images);
                shapes.extend(moving.deformation.map(|deformation| (prim_id, *deformation)));
            }
        }
        Some(Box::new(Self { camera, places, shapes }))
    }

    /// Where a point of a surface is on the image at a time; `None` behind the eye.
    pub fn raster(&self, instance: &Instance, of: &OnSurface, time: f32) -> Option<Vec2> {
        let indices = instance.geometry.triangles[of.triangle as usize];
        let [a, b, c] = match self.shapes.get(&instance.prim_id) {
            Some(shape) => shape.corners(indices, time),
            None => instance.geometry.corners(of.triangle, time),
        };
        let (u, v) = (of.barycentric.x, of.barycentric.y);
        let p = a * (1.0 - u - v) + b * u + c * v;
        let place = self.places.get(&of.instance).map_or(instance.to_render, |moves| moves.at(time));
        self.camera.raster(place.point(p), time)
    }
}

/// One placement of a mesh: its matrix at the frame, and by time if it moves.
struct Way {
    frame: flat::Matrix4d,
    moves: Option<Vec<(f32, flat::Matrix4d)>>,
}

/// In the order of the instances.
fn placements<'a>(flat: &'a FlatScene, mesh: &'a flat::Mesh) -> Box<dyn Iterator<Item = Way> + 'a> {
    let own = (&mesh.transform, mesh.transform_keys.as_ref());
    if mesh.instancer.is_empty() {
        let moves = combined(own, (&flat::IDENTITY, None, 0));
        return Box::new(std::iter::once(Way { frame: mesh.transform, moves }));
    }
    let instancer = flat.instancers.get(&mesh.instancer).into_iter();
    Box::new(instancer.flat_map(move |instancer| {
        let keys = instancer.transform_keys.as_ref();
        instancer
            .transforms
            .iter()
            .enumerate()
            .map(move |(i, m)| Way { frame: multiply(&mesh.transform, m), moves: combined(own, (m, keys, i)) })
    }))
}
