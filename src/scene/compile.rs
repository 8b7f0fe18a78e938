//! From the flattened scene to the compiled one, in order. Geometry, images and surfaces are kept from commit to commit; the
//! rest is cheap.

use super::accel::{Aabb, Tlas, give_back};
use super::alike::alike;
use super::coats::SurfaceCache;
use super::company::companies;
use super::displace::Displacement;
use super::image::{ImageCache, build_images};
use super::instances::{Placer, note_missing_primvars, render_bounds};
use super::mesh_lights::{compile_lights, emitting_meshes, link};
use super::tracks::Tracks;
use super::{Geometry, Instance, Scene, nesting};
use crate::camera::Camera;
use crate::error::{Error, Result, Warning};
use crate::flat::{self, FlatScene};
use crate::subdivision::level_of;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Compiled geometry by mesh path; an edit removes the entries that it makes stale.
pub type GeometryCache = BTreeMap<String, Arc<Geometry>>;

/// What is kept between the compilations of a scene.
#[derive(Default)]
pub struct Kept {
    pub geometry: GeometryCache,
    pub images: ImageCache,
    surfaces: SurfaceCache,
}

impl Kept {
    /// The prim at `path` is another one, or gone.
    pub fn forget(&mut self, path: &str) {
        self.geometry.remove(path);
        self.images.remove(path);
        self.surfaces.forget(path);
    }
}

/// What a commit had to build.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct CompileStats {
    pub blas_built: usize,
    pub instances: usize,
    pub lights: usize,
    pub surfaces: usize,
    pub geometry_bytes: usize,
    pub seconds: f64,
}

/// The camera that the settings name.
///
/// # Errors
/// There is no such camera: the only fault that a validated scene can have.
pub fn eye_of(flat: &FlatScene) -> Result<&flat::Camera> {
    flat.cameras.get(&flat.settings.camera).ok_or_else(|| Error::Prim {
        prim: flat.settings.camera.clone(),
        message: format!("no such camera; the scene has: {}", names(flat.cameras.keys())),
    })
}

/// Compiles a validated scene; `kept` spares the next call what has not changed.
pub fn compile(flat: &FlatScene, kept: &mut Kept, warnings: &mut Vec<Warning>) -> Result<(Scene, CompileStats)> {
    let start = std::time::Instant::now();
    let eye = eye_of(flat)?;
    let camera = Camera::compile(eye, &flat.settings);
    let Kept { geometry: cache, images, surfaces } = kept;
    build_images(&flat.images, images);
    let missing = missing(flat, images, cache);
    let blas_built = build_geometry(missing, images, cache);

    let mut placer = Placer::new(flat, camera.origin, warnings);
    placer.place(cache, images, surfaces);
    let Placer { mut needs, mut instances, surfaces, sets, .. } = placer;
    let mut lights = compile_lights(flat, camera.origin, &mut instances, warnings);
    let members = link(flat, &mut instances, &mut lights, warnings);
    let has_ruled_meshes = lights.ruled().any(|light| lights.is_mesh(light));
    needs.count(flat, images, &camera, &instances, &surfaces, &lights);
    note_missing_primvars(flat, &instances, warnings);

    let boxes = render_bounds(&instances);
    let shapes: Vec<(u32, Aabb)> = lights.shapes().map(|(light, (min, max))| (light, Aabb { min, max })).collect();
    let moves = instances.iter().any(Instance::is_moving);
    let anything_moves = moves || camera.is_moving() || lights.is_moving();
    let companies = companies(&instances, &boxes, &surfaces, &lights, &sets);
    let mut scene = Scene {
        moves,
        frozen: (!anything_moves).then(|| camera.time_of_frame()),
        alike: alike(&instances, &surfaces, &lights, &companies),
        tracks: Tracks::of(flat, eye, &instances, cache, images),
        companies,
        camera_within: Vec::new(),
        tlas: Tlas::build(&boxes),
        light_tlas: Tlas::build(&shapes.iter().map(|s| s.1).collect::<Vec<_>>()),
        light_shapes: shapes.iter().map(|s| s.0).collect(),
        camera,
        instances,
        surfaces,
        has_ruled_meshes,
        lights,
        members,
        needs,
    };
    nesting::look_around(&mut scene, flat, warnings);
    if blas_built > 0 {
        give_back();
    }
    let stats = CompileStats {
        blas_built,
        instances: scene.instances.len(),
        lights: scene.lights.len(),
        surfaces: scene.surfaces.len(),
        geometry_bytes: cache.values().map(|g| g.memory()).sum(),
        seconds: start.elapsed().as_secs_f64(),
    };
    Ok((scene, stats))
}

fn names<'a>(keys: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<&str> = keys.map(String::as_str).collect();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// The same where no edit follows: what meshes are compiled from is let go before trees are built, which need the room.
pub fn compile_last(
    mut flat: FlatScene,
    kept: &mut Kept,
    warnings: &mut Vec<Warning>,
) -> Result<(Scene, CompileStats)> {
    let start = std::time::Instant::now();
    build_images(&flat.images, &mut kept.images);
    let missing = missing(&flat, &kept.images, &mut kept.geometry);
    flat.meshes.values_mut().for_each(flat::Mesh::let_go);
    let blas_built = build_geometry(missing, &kept.images, &mut kept.geometry);
    let (scene, stats) = compile(&flat, kept, warnings)?;
    give_back();
    Ok((scene, CompileStats { blas_built, seconds: start.elapsed().as_secs_f64(), ..stats }))
}

/// A mesh to be compiled.
struct Missing {
    path: String,
    mesh: flat::Mesh,
    level: u32,
    deforms: bool,
    displacement: Option<Displacement>,
}

/// What is visible and not in the cache, which forgets what is gone.
fn missing(flat: &FlatScene, images: &ImageCache, cache: &mut GeometryCache) -> Vec<Missing> {
    let level = |mesh: &flat::Mesh| level_of(mesh, &flat.settings);
    let displacement = |mesh: &flat::Mesh| Displacement::of(mesh, &flat.materials, images);
    let emits = emitting_meshes(flat);
    let deforms =
        |path: &String, mesh: &flat::Mesh| mesh.point_keys.is_some() && flat.moves() && !emits.contains(path.as_str());
    let holds = |path: &String, geometry: &Geometry, mesh: &flat::Mesh| {
        let same = match (&geometry.displacement, &displacement(mesh)) {
            (Some(was), Some(is)) => was.same(is),
            (was, is) => was.is_none() && is.is_none(),
        };
        same && geometry.asked_level() == level(mesh) && geometry.deformation.is_some() == deforms(path, mesh)
    };
    cache.retain(|path, geometry| flat.meshes.get(path).is_some_and(|mesh| holds(path, geometry, mesh)));
    let missing = flat.meshes.iter().filter(|(path, mesh)| mesh.visible && !cache.contains_key(*path));
    let missing = missing.map(|(path, mesh)| Missing {
        path: path.clone(),
        mesh: mesh.clone(),
        level: level(mesh),
        deforms: deforms(path, mesh),
        displacement: displacement(mesh),
    });
    missing.collect()
}

/// The number built.
fn build_geometry(missing: Vec<Missing>, images: &ImageCache, cache: &mut GeometryCache) -> usize {
    let build = |Missing { path, mesh, level, deforms, displacement }| {
        (path, Arc::new(Geometry::compile(mesh, level, deforms, displacement, images)))
    };
    let built: Vec<(String, Arc<Geometry>)> = missing.into_par_iter().map(build).collect();
    let count = built.len();
    cache.extend(built);
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::{GeomSubset, Interpolation, Material, Mesh, PreviewSurface, Primvar};

    /// Two triangles in `material`, of a constant displayColor.
    fn card(material: &str, color: f32) -> Mesh {
        let display_color =
            Primvar { interpolation: Interpolation::Constant, values: vec![[color; 3]].into(), indices: None };
        Mesh {
            points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].into(),
            face_vertex_counts: vec![3, 3].into(),
            face_vertex_indices: vec![0, 1, 2, 0, 2, 3].into(),
            display_color: Some(display_color),
            material: material.into(),
            ..Mesh::default()
        }
    }

    fn compiled(meshes: impl IntoIterator<Item = (&'static str, Mesh)>) -> Scene {
        let mut flat = FlatScene::default();
        flat.settings.camera = "/C".into();
        flat.cameras.insert("/C".into(), flat::Camera::default());
        let preview = |surface| Material::UsdPreviewSurface(surface);
        flat.materials.insert("/Plain".into(), preview(PreviewSurface::default()));
        flat.materials.insert("/Wax".into(), preview(PreviewSurface { subsurface: 1.0, ..PreviewSurface::default() }));
        flat.meshes.extend(meshes.into_iter().map(|(path, mesh)| (path.to_owned(), mesh)));
        compile(&flat, &mut Kept::default(), &mut Vec::new()).expect("a scene").0
    }

    /// Surfaces that meshes have in common are compiled once, and each mesh still shows its own colour.
    #[test]
    fn alike_is_by_material_and_what_is_taken_from_the_mesh() {
        let cards = [("/A", "/Plain", 0.2), ("/B", "/Plain", 0.7), ("/D", "", 0.2), ("/E", "/Plain", 0.2)];
        let scene = compiled(cards.map(|(path, material, color)| (path, card(material, color))));
        let colors: Vec<f32> = scene.surfaces.iter().map(|coating| coating.surface.albedo().x).collect();
        assert_eq!(colors, [0.2, 0.7, 0.2, 0.2]);
        let scene = compiled([("/A", card("/Plain", 0.2)), ("/B", card("/Wax", 0.2))]);
        assert_eq!(scene.surfaces.iter().map(|c| c.interior.is_some()).collect::<Vec<_>>(), [false, true]);
    }

    /// A material that subsets leave no face to is not needed, whatever it is.
    #[test]
    fn what_no_face_wears_is_not_needed() {
        let covered = |indices: Vec<i32>| {
            let subset = GeomSubset { path: "/A/S".into(), indices: indices.into(), material: "/Plain".into() };
            compiled([("/A", Mesh { geom_subsets: vec![subset], ..card("/Wax", 0.5) })])
        };
        assert!(covered(vec![1]).needs.walks());
        let scene = covered(vec![0, 1]);
        assert!(!scene.needs.walks() && !scene.needs.transparency);
        assert_eq!(scene.surfaces.len(), 2);
    }

    /// Surfaces are compiled side by side: what comes of it, and what is said, is in the order of the meshes.
    #[test]
    fn any_number_of_threads_gives_the_same() {
        let mut flat = FlatScene::default();
        flat.settings.camera = "/C".into();
        flat.cameras.insert("/C".into(), flat::Camera::default());
        for i in 0..24_u16 {
            // Every third is out of range, which is said; every second is worn twice.
            let roughness = 0.03 * f32::from(i) + if i % 3 == 0 { 2.0 } else { 0.1 };
            let surface = PreviewSurface { roughness, subsurface: f32::from(i % 5 / 4), ..PreviewSurface::default() };
            flat.materials.insert(format!("/M{i:02}"), Material::UsdPreviewSurface(surface));
            for copy in 0..1 + i % 2 {
                flat.meshes.insert(format!("/{copy}/Card{i:02}"), card(&format!("/M{i:02}"), 0.5));
            }
        }
        let compiled = |threads: usize, kept: &mut Kept| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mut warnings = Vec::new();
            let (scene, _) = pool.install(|| compile(&flat, kept, &mut warnings)).expect("a scene");
            (scene.surfaces.into_iter().map(|coating| coating.surface).collect::<Vec<_>>(), warnings)
        };
        let mut kept = Kept::default();
        let one = compiled(1, &mut kept);
        assert!(one.1.len() > 8 && one.1.iter().any(|warning| warning.message.contains("roughness")), "{:?}", one.1);
        assert!(one == compiled(4, &mut Kept::default()));
        // What was kept says it again.
        assert!(one == compiled(4, &mut kept));
    }
}
