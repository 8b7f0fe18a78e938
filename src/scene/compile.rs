//! From the flattened scene to the compiled one: geometry is kept from commit to commit, the rest is cheap.

use super::accel::{Aabb, Tlas, give_back};
use super::alike::alike;
use super::company::companies;
use super::displace::Displacement;
use super::image::{ImageCache, build_images};
use super::motion::combined;
use super::{Coating, Driven, Geometry, Instance, InstancePrimvars, Interior, Moves, Needs, Scene, nesting};
use crate::bsdf::{self, Boundary, InteriorAlbedo, OfMesh, Surface};
use crate::camera::Camera;
use crate::error::{Error, Result, Warning};
use crate::flat::{self, AnyPrimvar, FlatScene, LightShape, PRIMVAR_AOV};
use crate::light::{Categories, Lights, Members};
use crate::math::{Affine, Rgb};
use crate::medium::Medium;
use crate::subdivision::level_of;
use crate::subsurface::inversion::{Illumination, single_scattering_albedo};
use glam::{DVec3, Mat3, Vec3, Vec4};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Compiled geometry by mesh path; an edit removes the entries that it makes stale.
pub type GeometryCache = BTreeMap<String, Arc<Geometry>>;

/// Compiled constant surfaces by all that they come from; an edit of a material removes its own.
type SurfaceCache = BTreeMap<SurfaceKey, Surface>;

/// A material's path and what is not the material's: displayColor and displayOpacity, bits, and the boundary that the
/// settings force.
type SurfaceKey = (String, Option<[u32; 3]>, u32, String);

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
        self.surfaces.retain(|key, _| key.0 != path);
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

/// The shortest mean free path, stage units: 1 / sigma_t and sigma_t * t stay finite in f32.
const MIN_MEAN_FREE_PATH: f32 = 1e-30;

/// Compiles a validated scene; `kept` spares the next call what has not changed.
pub fn compile(flat: &FlatScene, kept: &mut Kept, warnings: &mut Vec<Warning>) -> Result<(Scene, CompileStats)> {
    let start = std::time::Instant::now();
    let camera = flat.cameras.get(&flat.settings.camera).ok_or_else(|| Error::Prim {
        prim: flat.settings.camera.clone(),
        message: format!("no such camera; the scene has: {}", names(flat.cameras.keys())),
    })?;
    let camera = Camera::compile(camera, &flat.settings);
    let Kept { geometry: cache, images, surfaces: former } = kept;
    build_images(&flat.images, images);
    let blas_built = build_geometry(flat, images, cache);

    let (needs, surfaces, known, sets) = (Needs::default(), Vec::new(), SurfaceCache::new(), BTreeMap::new());
    let mut builder = Builder { flat, origin: camera.origin, images, warnings, needs, surfaces, known, former, sets };
    let (mut instances, emitters) = builder.place(cache);
    let mut lights = builder.lights(&mut instances, emitters);
    let members = builder.link(&mut instances, &mut lights);
    let has_ruled_meshes = lights.ruled().any(|light| lights.is_mesh(light));
    builder.count(&camera, &instances, &lights);
    builder.note_missing_primvars(&instances);
    let (surfaces, needs, sets) = (builder.surfaces, builder.needs, builder.sets);
    kept.surfaces = builder.known;

    let boxes: Vec<Aabb> = instances.iter().map(render_bounds).collect();
    let shapes: Vec<(u32, Aabb)> = lights.shapes().map(|(light, (min, max))| (light, Aabb { min, max })).collect();
    let moves = instances.iter().any(Instance::is_moving);
    let anything_moves = moves || camera.is_moving() || lights.is_moving();
    let companies = companies(&instances, &boxes, &surfaces, &lights, &sets);
    let mut scene = Scene {
        moves,
        frozen: (!anything_moves || flat.settings.disable_motion_blur).then(|| camera.time_of_frame()),
        alike: alike(&instances, &surfaces, &lights, &companies),
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

/// Builds what is visible and not in the cache, and forgets what is gone; the number built.
fn build_geometry(flat: &FlatScene, images: &ImageCache, cache: &mut GeometryCache) -> usize {
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
    let missing: Vec<(&String, &flat::Mesh)> =
        flat.meshes.iter().filter(|(path, mesh)| mesh.visible && !cache.contains_key(*path)).collect();
    let built: Vec<(String, Arc<Geometry>)> = missing
        .par_iter()
        .map(|(path, mesh)| {
            let geometry = Geometry::compile(mesh, level(mesh), deforms(path, mesh), displacement(mesh), images);
            ((*path).clone(), Arc::new(geometry))
        })
        .collect();
    let count = built.len();
    cache.extend(built);
    count
}

/// Meshes that are lights, too: they keep their shape, which the lights know at the frame alone.
fn emitting_meshes(flat: &FlatScene) -> BTreeSet<&str> {
    let shapes = flat.lights.values().map(|light| &light.shape);
    shapes.filter_map(|shape| if let LightShape::Mesh { mesh } = shape { Some(mesh.as_str()) } else { None }).collect()
}

/// Bounds of an instance in render space, all the time: between keys its points go straight.
fn render_bounds(instance: &Instance) -> Aabb {
    match &instance.moves {
        None => bounds_at(instance, &instance.to_render),
        Some(moves) => moves.values().iter().fold(Aabb::EMPTY, |all, at| all.union(&bounds_at(instance, at))),
    }
}

fn bounds_at(instance: &Instance, placed: &Affine) -> Aabb {
    let bounds = instance.geometry.bounds();
    let centre = placed.point((bounds.min + bounds.max) * 0.5);
    let half = placed.linear.abs() * ((bounds.max - bounds.min) * 0.5);
    // The map of the box rounds: a few ulps of its corners keep the instance inside.
    let slack = 8.0 * f32::EPSILON * (centre.abs() + half);
    Aabb { min: centre - half - slack, max: centre + half + slack }
}

/// Triangles of mesh lights in render space, by mesh path.
type Emitters = BTreeMap<String, Vec<[Vec3; 3]>>;

/// As which instance a mesh stands where at the frame and by time of the shutter, and the colour that an instancer gives
/// it there.
type Placement = (usize, Affine, Option<Moves>, Option<Vec3>);

/// What an instancer does with one of its instances.
type Within<'a> = (&'a flat::Matrix4d, Option<&'a flat::TransformKeys>, usize);

struct Builder<'a> {
    flat: &'a FlatScene,
    origin: DVec3,
    images: &'a ImageCache,
    warnings: &'a mut Vec<Warning>,
    needs: Needs,
    surfaces: Vec<Coating>,
    known: SurfaceCache,
    /// Of the compilation before; what this one has no use for is dropped with it.
    former: &'a mut SurfaceCache,
    /// Instances by the set that their mesh is declared to be in.
    sets: BTreeMap<String, Vec<u32>>,
}

impl Builder<'_> {
    /// Every visible placement of every mesh, in path order.
    fn place(&mut self, cache: &GeometryCache) -> (Vec<Instance>, Emitters) {
        let emitting = |shape: &LightShape| match shape {
            LightShape::Mesh { mesh } => Some(mesh.clone()),
            _ => None,
        };
        let mut emitters: Emitters =
            self.flat.lights.values().filter_map(|l| emitting(&l.shape)).map(|mesh| (mesh, Vec::new())).collect();
        let mut instances = Vec::new();
        for (prim_id, (path, mesh)) in self.flat.meshes.iter().enumerate() {
            let Some(geometry) = cache.get(path).filter(|g| mesh.visible && !g.triangles.is_empty()) else { continue };
            let placements = self.placements(path, mesh, geometry.centre);
            if placements.is_empty() {
                continue;
            }
            self.note_refinement(path, geometry);
            self.note_displacement(path, geometry);
            if mesh.point_keys.is_some() && self.flat.moves() && emitters.contains_key(path) {
                let message = "points: they move while the shutter is open, but a mesh that is a light keeps its shape";
                self.warnings.push(Warning::new(path, message));
            }
            let surfaces = self.coat(path, mesh, geometry);
            let priority = self.priority(mesh);
            self.note_set(path, mesh, surfaces, instances.len()..instances.len() + placements.len());
            self.needs.meshes += 1;
            self.needs.triangles += geometry.triangles.len() as u64;
            self.needs.instanced += placements.len() as u32 - 1;
            let primvars = self.instance_primvars(mesh);
            for (i, to_render, moves, display_color) in placements {
                let is_identity = |place: &Affine| place.linear == Mat3::IDENTITY;
                let keys = moves.as_ref().map_or(&[][..], |moves| moves.values());
                let translated = is_identity(&to_render) && keys.iter().all(is_identity);
                let instance = Instance {
                    geometry: geometry.clone(),
                    to_render,
                    moves: moves.map(Box::new),
                    surfaces,
                    priority,
                    prim_id: prim_id as i32,
                    light: None,
                    display_color,
                    primvars: primvars.clone().map(|primvars| (primvars, i as u32)),
                    categories: 0,
                    translated,
                };
                if let Some(triangles) = emitters.get_mut(path) {
                    triangles.extend(render_triangles(&instance));
                }
                instances.push(instance);
            }
        }
        (instances, emitters)
    }

    /// The mesh's own, else the highest of its materials.
    fn priority(&self, mesh: &flat::Mesh) -> i32 {
        let subsets = mesh.geom_subsets.iter().map(|subset| &subset.material);
        let materials = std::iter::once(&mesh.material).chain(subsets);
        let authored = materials.filter_map(|material| self.flat.materials.get(material)).map(flat::Material::priority);
        mesh.medium_priority.unwrap_or_else(|| authored.max().unwrap_or(0))
    }

    /// Notes the set that `placements` of a mesh are in; its surfaces are the last that were compiled.
    fn note_set(&mut self, path: &str, mesh: &flat::Mesh, surfaces: u32, placements: std::ops::Range<usize>) {
        if mesh.subsurface_set.is_empty() {
            return;
        }
        let interiors = self.surfaces[surfaces as usize..].iter().filter_map(|coating| coating.interior);
        if !interiors.into_iter().any(|interior| interior.boundary == Boundary::Diffuse) {
            let message = "primvars:dermis:subsurfaceSet: it has no medium behind a diffuse boundary, so there is no \
                           interior to share; it is ignored";
            self.warnings.push(Warning::new(path, message));
            return;
        }
        self.sets.entry(mesh.subsurface_set.clone()).or_default().extend(placements.map(|i| i as u32));
    }

    fn note_refinement(&mut self, path: &str, geometry: &Geometry) {
        let Some(refinement) = &geometry.refinement else { return };
        self.warnings.extend(refinement.faults.iter().map(|fault| Warning::new(path, fault.as_str())));
        if refinement.level > 0 {
            self.needs.refined_meshes += 1;
            self.needs.refined_triangles += geometry.triangles.len() as u64;
        } else {
            self.needs.cages += 1;
        }
    }

    fn note_displacement(&mut self, path: &str, geometry: &Geometry) {
        if geometry.displacement.is_none() {
            return;
        }
        self.needs.displaced_meshes += 1;
        if geometry.not_displaced > 0 {
            let message = format!("displacement: at {} corners it is no number; they stay", geometry.not_displaced);
            self.warnings.push(Warning::new(path, message));
        }
        if geometry.refinement.as_ref().is_none_or(|refinement| refinement.level == 0) {
            let points = geometry.points.len();
            let how = match geometry.refinement {
                Some(_) => "--complexity or primvars:dermis:refineLevel refine it",
                None => "only subdivision surfaces are refined",
            };
            let message =
                format!("displacement moves the {points} points of the mesh, not what is between them; {how}");
            self.warnings.push(Warning::new(path, message));
        }
    }

    /// Those of its instancer; `None` where neither a material of the mesh nor an AOV reads one.
    fn instance_primvars(&self, mesh: &flat::Mesh) -> Option<Arc<InstancePrimvars>> {
        let instancer = self.flat.instancers.get(&mesh.instancer).filter(|i| !i.primvars.is_empty())?;
        let worn = std::iter::once(&mesh.material).chain(mesh.geom_subsets.iter().map(|subset| &subset.material));
        let networks = worn.filter_map(|name| Some(self.flat.materials.get(name)?.network()));
        let mut read: BTreeSet<&str> = networks.flat_map(|network| network.primvars()).map(String::as_str).collect();
        read.extend(self.flat.settings.aovs.iter().filter_map(|aov| aov.strip_prefix(PRIMVAR_AOV)));
        let chosen = instancer.primvars.iter().filter(|(name, _)| read.contains(name.as_str()));
        let primvars: InstancePrimvars = chosen.map(|(name, primvar)| (name.clone(), lanes(primvar))).collect();
        (!primvars.is_empty()).then(|| Arc::new(primvars))
    }

    /// AOVs of primvars that nothing has are black.
    fn note_missing_primvars(&mut self, instances: &[Instance]) {
        let has = |name: &str| {
            let of_instance =
                |i: &Instance| i.primvars.as_ref().is_some_and(|(primvars, _)| primvars.contains_key(name));
            instances.iter().any(|i| i.geometry.primvars.contains_key(name) || of_instance(i))
        };
        let asked =
            self.flat.settings.aovs.iter().filter(|aov| aov.strip_prefix(PRIMVAR_AOV).is_some_and(|name| !has(name)));
        let said =
            asked.map(|aov| Warning::new("render settings", format!("aovs: {aov}: no mesh has it; it is black")));
        self.warnings.extend(said);
    }

    /// Where a mesh stands, as which instance, and the colour that an instancer gives it there.
    fn placements(&mut self, path: &str, mesh: &flat::Mesh, centre: DVec3) -> Vec<Placement> {
        let moves = self.flat.moves();
        let mut place = |m: &flat::Matrix4d, within: Within, color: Option<&[f32; 3]>| {
            let placed = Affine::from_usd(m, centre, self.origin);
            if placed.is_none() {
                self.warnings
                    .push(Warning::new(path, "xformOp: the transform has no inverse in f32; placement left out"));
            }
            let own = (&mesh.transform, mesh.transform_keys.as_ref());
            let keys = moves.then(|| combined(own, within)).flatten();
            let moves = keys.and_then(|keys| Moves::new_by(keys, |m| Affine::from_usd(m, centre, self.origin)));
            // NaN: the instance has none.
            let color = color.map(|c| Vec3::from(*c)).filter(|c| c.is_finite());
            placed.map(|placed| (within.2, placed, moves, color.map(|c| c.clamp(Vec3::ZERO, Vec3::ONE))))
        };
        if mesh.instancer.is_empty() {
            return place(&mesh.transform, (&flat::IDENTITY, None, 0), None).into_iter().collect();
        }
        let Some(instancer) = self.flat.instancers.get(&mesh.instancer).filter(|i| i.visible) else {
            return Vec::new();
        };
        let keys = instancer.transform_keys.as_ref();
        let placed = |(i, m)| place(&multiply(&mesh.transform, m), (m, keys, i), instancer.display_color.get(i));
        instancer.transforms.iter().enumerate().filter_map(placed).collect()
    }

    /// Surfaces for the slots of a mesh; the index of the first.
    fn coat(&mut self, path: &str, mesh: &flat::Mesh, geometry: &Geometry) -> u32 {
        let first = self.surfaces.len() as u32;
        let display_color = match &geometry.display_color {
            Some(super::Attribute::Constant(color)) => Some(*color),
            _ => None,
        };
        if mesh.display_opacity.as_ref().is_some_and(|o| o.values.iter().any(|&v| v != o.values[0])) {
            let message = "primvars:displayOpacity varies over the mesh: its first value is used everywhere";
            self.warnings.push(Warning::new(path, message));
        }
        let subsets =
            mesh.geom_subsets.iter().map(|s| if s.material.is_empty() { &mesh.material } else { &s.material });
        let used = geometry.slots_in_use(1 + mesh.geom_subsets.len());
        for (material, used) in std::iter::once(&mesh.material).chain(subsets).zip(used) {
            // What no face wears is none of the scene's: its slot is there, with a surface that needs nothing.
            let (material, opacity) = if used { (material.as_str(), geometry.display_opacity) } else { ("", 1.0) };
            let coating = self.coating(path, geometry, material, display_color, opacity);
            if let Some(interior) = &coating.interior {
                self.warn_if_open(path, geometry, interior.medium.scatters());
            }
            self.surfaces.push(coating);
        }
        first
    }

    /// The surface of a material (empty: none) on the mesh at `path`.
    fn coating(
        &mut self,
        path: &str,
        geometry: &Geometry,
        material: &str,
        display_color: Option<Rgb>,
        display_opacity: f32,
    ) -> Coating {
        let prim = if material.is_empty() { path } else { material };
        let standard = flat::Material::default();
        let described = self.flat.materials.get(material).unwrap_or(&standard);
        if matches!(described, flat::Material::Hair(_)) && geometry.strands.is_none() {
            let message = format!("material:binding: {material} is for curves; displayColor is used");
            self.warnings.push(Warning::new(path, message));
            return self.coating(path, geometry, "", display_color, display_opacity);
        }
        let boundary_override = boundary_named(&self.flat.settings.subsurface_boundary);
        let of_mesh = OfMesh { display_color, display_opacity, boundary_override };
        let driven = Driven::compile(described, geometry, of_mesh, self.images, prim, self.warnings);
        let (driven, surface) = match driven {
            Some((driven, typical)) => (Some(Box::new(driven)), typical),
            None => (None, self.constant_surface(prim, material, display_color, display_opacity)),
        };
        let interior = surface.interior().map(|i| compile_interior(&i));
        Coating { surface, interior, driven }
    }

    /// Compiled once for all meshes and commits that are alike: its tables take milliseconds.
    fn constant_surface(&mut self, prim: &str, material: &str, display_color: Option<Rgb>, opacity: f32) -> Surface {
        let color_bits = display_color.map(|c| c.to_array().map(f32::to_bits));
        let key = (material.to_owned(), color_bits, opacity.to_bits(), self.flat.settings.subsurface_boundary.clone());
        if let Some(known) = self.known.get(&key) {
            return *known;
        }
        if let Some(former) = self.former.remove(&key) {
            return *self.known.entry(key).or_insert(former);
        }
        let warned = self.warnings.len();
        let boundary_override = boundary_named(&self.flat.settings.subsurface_boundary);
        let standard = flat::Material::default();
        let material = self.flat.materials.get(material).unwrap_or(&standard);
        let surface = Surface::compile(material, display_color, opacity, boundary_override, prim, self.warnings);
        if self.warnings.len() == warned {
            // Else the next mesh of the kind is to be named, too.
            self.known.insert(key, surface);
        }
        surface
    }

    fn warn_if_open(&mut self, path: &str, geometry: &Geometry, scatters: bool) {
        let open_edges = geometry.open_edges();
        if open_edges > 0 {
            let lost = if scatters {
                "walks that leak through the gaps end black (walks_leaked in the statistics)"
            } else {
                "what refracts in and does not refract out again keeps 1 / ior^2 of its radiance"
            };
            let message = format!(
                "faceVertexIndices: {open_edges} edges belong to a single face, so the mesh does not enclose its medium; {lost}: \
                 close the mesh"
            );
            self.warnings.push(Warning::new(path, message));
        }
    }

    /// Compiles the lights and tells instances of mesh lights which triangles are theirs.
    fn lights(&mut self, instances: &mut [Instance], emitters: Emitters) -> Lights {
        let triangles = |mesh: &str| emitters.get(mesh).filter(|t| !t.is_empty()).cloned();
        let lights = Lights::compile(
            &self.flat.lights,
            &self.flat.textures,
            &triangles,
            self.origin,
            self.flat.moves(),
            self.warnings,
        );
        let paths: Vec<&String> = self.flat.meshes.keys().collect();
        let mut next: BTreeMap<i32, u32> = BTreeMap::new();
        for instance in instances {
            let Some(light) = lights.mesh_light(paths[instance.prim_id as usize]) else { continue };
            let first = next.entry(instance.prim_id).or_default();
            instance.light = Some((light, *first));
            if instance.moves.is_some() && !lights.moves(light) {
                let message =
                    "its transform changes while the shutter is open, that of its light does not: it stays where it is";
                self.warnings.push(Warning::new(paths[instance.prim_id as usize], message));
                instance.moves = None;
            }
            *first += instance.geometry.triangles.len() as u32;
        }
        lights
    }

    /// Tells instances which sets of categories are theirs, and lights which ones they are for.
    fn link(&mut self, instances: &mut [Instance], lights: &mut Lights) -> Members {
        let mut categories = Categories::of(&self.flat.lights);
        if !categories.is_empty() {
            let meshes: Vec<&flat::Mesh> = self.flat.meshes.values().collect();
            for of_mesh in instances.chunk_by_mut(|a, b| a.prim_id == b.prim_id) {
                let set = categories.set(&meshes[of_mesh[0].prim_id as usize].categories);
                of_mesh.iter_mut().for_each(|instance| instance.categories = set);
            }
        }
        lights.link(&self.flat.lights, &categories);
        lights.group(&self.flat.settings.aovs, &self.flat.lights, self.warnings);
        self.needs.linked_lights = lights.linked() as u32;
        self.needs.guided_domes = lights.with_portals() as u32;
        self.needs.shadow_rules = lights.ruled().count() as u32;
        categories.members()
    }

    /// Fills the Needs record from what was compiled.
    fn count(&mut self, camera: &Camera, instances: &[Instance], lights: &Lights) {
        let needs = &mut self.needs;
        needs.lights = lights.len() as u32;
        needs.infinite_lights = lights.infinite().len() as u32;
        needs.mesh_lights = instances.iter().filter(|i| i.light.is_some()).count() as u32;
        needs.textures = (self.flat.textures.len() + self.images.len()) as u32;
        needs.texture_bytes = self.images.values().map(|image| image.memory() as u64).sum();
        needs.paged_images = self.images.values().filter(|image| image.is_paged()).count() as u32;
        needs.texture_memory = self.flat.settings.texture_memory;
        needs.moving_instances = instances.iter().filter(|i| i.moves.is_some()).count() as u32;
        needs.deforming_meshes = instances.iter().filter(|i| i.geometry.deformation.is_some()).count() as u32;
        needs.moving_lights = lights.moving() as u32;
        needs.moving_camera = camera.is_moving();
        needs.depth_of_field = camera.has_depth_of_field();
        needs.aovs = self.flat.settings.aovs.clone();
        for coating in &self.surfaces {
            let driven = coating.driven.as_deref();
            needs.hair_surfaces += u32::from(coating.surface.is_hair());
            needs.driven_surfaces += u32::from(driven.is_some());
            needs.transparency |= !coating.surface.is_opaque() || driven.is_some_and(Driven::opacity);
            let Some(interior) = coating.interior else { continue };
            let medium = interior.medium;
            if !medium.scatters() {
                needs.clear_media += 1;
            } else {
                match interior.boundary {
                    Boundary::Diffuse => needs.diffuse_media += 1,
                    Boundary::Dielectric => needs.dielectric_media += 1,
                    Boundary::IndexMatched => needs.index_matched_media += 1,
                }
            }
            needs.transparency |= interior.boundary == Boundary::IndexMatched;
            let differs = |c: Rgb| c.max_element() != c.min_element();
            needs.rgb_media |= differs(medium.sigma_t) || differs(medium.albedo);
            needs.anisotropic_media |= medium.g != 0.0;
        }
    }
}

/// As `Values::at` has them: one number fills all lanes, a shorter vector has zeros behind it.
fn lanes(primvar: &AnyPrimvar) -> Vec<Vec4> {
    match primvar {
        AnyPrimvar::Float(primvar) => primvar.values.iter().map(|v| Vec4::splat(*v)).collect(),
        AnyPrimvar::Float2(primvar) => primvar.values.iter().map(|v| Vec4::new(v[0], v[1], 0.0, 0.0)).collect(),
        AnyPrimvar::Float3(primvar) => primvar.values.iter().map(|v| Vec3::from(*v).extend(0.0)).collect(),
        AnyPrimvar::Float4(primvar) => primvar.values.iter().map(|v| Vec4::from(*v)).collect(),
    }
}

/// Row-vector product: first `a`, then `b`.
pub(super) fn multiply(a: &flat::Matrix4d, b: &flat::Matrix4d) -> flat::Matrix4d {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Triangles of an instance in render space, wound so that their front is the mesh's front.
fn render_triangles(instance: &Instance) -> impl Iterator<Item = [Vec3; 3]> + '_ {
    let mirrored = instance.to_render.linear.determinant() < 0.0;
    (0..instance.geometry.triangles.len() as u32).map(move |i| {
        let [a, b, c] = instance.geometry.corners(i, 0.0).map(|p| instance.to_render.point(p));
        if mirrored { [a, c, b] } else { [a, b, c] }
    })
}

/// The boundary that the setting `subsurfaceBoundary` forces on every medium; `None` for `auto`.
fn boundary_named(name: &str) -> Option<Boundary> {
    match name {
        "diffuse" => Some(Boundary::Diffuse),
        "dielectric" => Some(Boundary::Dielectric),
        "indexMatched" => Some(Boundary::IndexMatched),
        _ => None,
    }
}

/// Coefficients from what the artist gave: colours go through the inversion for their boundary. Diffuse and
/// index-matched boundaries reflect nothing back in (eta 1); OpenPBR defines the colour behind a dielectric
/// for light at normal incidence.
pub(super) fn compile_interior(interior: &bsdf::Interior) -> Interior {
    let albedo = match interior.albedo {
        InteriorAlbedo::Single(albedo) => albedo,
        InteriorAlbedo::Color(color) => {
            let (eta, illumination) = match interior.boundary {
                Boundary::Diffuse | Boundary::IndexMatched => (1.0, Illumination::Diffuse),
                Boundary::Dielectric => (interior.eta, Illumination::Normal),
            };
            single_scattering_albedo(color, interior.g, eta, illumination)
        }
    };
    let radius = interior.radius.max(Rgb::splat(MIN_MEAN_FREE_PATH));
    // An infinite mean free path is a vacuum: 1 / inf = 0.
    let medium = Medium { sigma_t: 1.0 / radius, albedo, g: interior.g };
    Interior { boundary: interior.boundary, index: interior.eta, medium }
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
}
