//! Placements: every visible mesh, and every instance of an instancer, stands somewhere in render space.

use super::accel::Aabb;
use super::coats::{Coats, SurfaceCache, Wearer, Worn};
use super::compile::GeometryCache;
use super::image::ImageCache;
use super::mesh_lights::emitting_meshes;
use super::motion::{combined, multiply};
use super::{Coating, Geometry, Instance, InstancePrimvars, Moves, Needs};
use crate::bsdf::Boundary;
use crate::error::Warning;
use crate::flat::{self, AnyPrimvar, FlatScene, PRIMVAR_AOV};
use crate::math::Affine;
use glam::{DVec3, Mat3, Vec3, Vec4};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// As which instance a mesh stands where at the frame and by time of the shutter, and the colour that an instancer gives
/// it there.
type Placement = (usize, Affine, Option<Moves>, Option<Vec3>);

/// What an instancer does with one of its instances.
type Within<'a> = (&'a flat::Matrix4d, Option<&'a flat::TransformKeys>, usize);

/// A mesh that is placed.
struct Placed<'a> {
    prim_id: i32,
    path: &'a str,
    mesh: &'a flat::Mesh,
    geometry: &'a Arc<Geometry>,
}

pub(super) struct Placer<'a> {
    flat: &'a FlatScene,
    origin: DVec3,
    warnings: &'a mut Vec<Warning>,
    pub needs: Needs,
    /// In path order.
    pub instances: Vec<Instance>,
    pub surfaces: Vec<Coating>,
    /// Instances by the set that their mesh is declared to be in.
    pub sets: BTreeMap<String, Vec<u32>>,
}

impl<'a> Placer<'a> {
    pub fn new(flat: &'a FlatScene, origin: DVec3, warnings: &'a mut Vec<Warning>) -> Self {
        let (needs, instances, surfaces, sets) = (Needs::default(), Vec::new(), Vec::new(), BTreeMap::new());
        Self { flat, origin, warnings, needs, instances, surfaces, sets }
    }

    /// Every visible placement of every mesh.
    pub fn place(&mut self, cache: &GeometryCache, images: &ImageCache, surfaces: &mut SurfaceCache) {
        let placed = self.placed(cache);
        let wearers: Vec<Wearer> =
            placed.iter().map(|of| Wearer { path: of.path, mesh: of.mesh, geometry: of.geometry }).collect();
        let worn = Coats::new(self.flat, images).of(&wearers, surfaces);
        for (of, worn) in placed.iter().zip(worn) {
            self.place_mesh(of, worn);
        }
    }

    /// Meshes that stand somewhere, unless their transforms are singular.
    fn placed<'b>(&self, cache: &'b GeometryCache) -> Vec<Placed<'b>>
    where
        'a: 'b,
    {
        let flat = self.flat;
        let stands = |mesh: &flat::Mesh| {
            let instancer = flat.instancers.get(&mesh.instancer);
            mesh.instancer.is_empty() || instancer.is_some_and(|i| i.visible && !i.transforms.is_empty())
        };
        let placed = flat.meshes.iter().zip(0..).filter_map(|((path, mesh), prim_id)| {
            let geometry = cache.get(path).filter(|g| mesh.visible && !g.triangles.is_empty())?;
            stands(mesh).then_some(Placed { prim_id, path, mesh, geometry })
        });
        placed.collect()
    }

    fn place_mesh(&mut self, of: &Placed, worn: Worn) {
        let Placed { prim_id, path, mesh, geometry } = *of;
        let placements = self.placements(path, mesh, geometry.centre);
        if placements.is_empty() {
            return;
        }
        self.note_refinement(path, geometry);
        self.note_displacement(path, geometry);
        self.note_kept_shape(path, mesh);
        self.warnings.extend(worn.warnings);
        let surfaces = self.surfaces.len() as u32;
        self.surfaces.extend(worn.coatings);
        let priority = self.priority(mesh);
        let first = self.instances.len();
        self.note_set(path, mesh, surfaces, first..first + placements.len());
        self.needs.meshes += 1;
        self.needs.triangles += geometry.triangles.len() as u64;
        self.needs.instanced += placements.len() as u32 - 1;
        let primvars = self.instance_primvars(mesh);
        let instances = placements.into_iter().map(|(i, to_render, moves, display_color)| Instance {
            geometry: geometry.clone(),
            translated: is_translated(&to_render, moves.as_ref()),
            to_render,
            moves: moves.map(Box::new),
            surfaces,
            priority,
            prim_id,
            light: None,
            display_color,
            primvars: primvars.clone().map(|primvars| (primvars, i as u32)),
            categories: 0,
        });
        self.instances.extend(instances);
    }

    fn note_kept_shape(&mut self, path: &str, mesh: &flat::Mesh) {
        if mesh.point_keys.is_some() && self.flat.moves() && emitting_meshes(self.flat).contains(path) {
            let message = "points: they move while the shutter is open, but a mesh that is a light keeps its shape";
            self.warnings.push(Warning::new(path, message));
        }
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
}

/// Whether it is never turned or scaled.
fn is_translated(to_render: &Affine, moves: Option<&Moves>) -> bool {
    let is_identity = |place: &Affine| place.linear == Mat3::IDENTITY;
    is_identity(to_render) && moves.is_none_or(|moves| moves.values().iter().all(is_identity))
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

/// AOVs of primvars that nothing has are black.
pub(super) fn note_missing_primvars(flat: &FlatScene, instances: &[Instance], warnings: &mut Vec<Warning>) {
    let has = |name: &str| {
        let of_instance = |i: &Instance| i.primvars.as_ref().is_some_and(|(primvars, _)| primvars.contains_key(name));
        instances.iter().any(|i| i.geometry.primvars.contains_key(name) || of_instance(i))
    };
    let asked = flat.settings.aovs.iter().filter(|aov| aov.strip_prefix(PRIMVAR_AOV).is_some_and(|name| !has(name)));
    warnings
        .extend(asked.map(|aov| Warning::new("render settings", format!("aovs: {aov}: no mesh has it; it is black"))));
}

/// Instances of which 64 boxes each are turned in place of 8: a tenth of a second of one thread, at most.
const FEW: usize = 1 << 16;

/// Bounds of instances in render space, all the time: between keys points go straight.
pub(super) fn render_bounds(instances: &[Instance]) -> Vec<Aabb> {
    let levels = if instances.len() <= FEW { 2 } else { 1 };
    let bounds = |instance: &Instance| {
        let at = |placed| instance.geometry.bounds_under(placed, levels);
        match &instance.moves {
            None => at(&instance.to_render),
            Some(moves) => moves.values().iter().fold(Aabb::EMPTY, |all, placed| all.union(&at(placed))),
        }
    };
    instances.par_iter().with_min_len(1 << 8).map(bounds).collect()
}
