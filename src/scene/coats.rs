//! What meshes wear: surfaces, and the media behind them. Constant ones are compiled once for all meshes and commits that
//! are alike, and what is missing side by side: their tables take milliseconds each.

use super::image::ImageCache;
use super::{Attribute, Coating, Driven, Geometry, Interior};
use crate::bsdf::{self, Boundary, InteriorAlbedo, OfMesh, Surface};
use crate::error::Warning;
use crate::flat::{FlatScene, Material, Mesh};
use crate::math::Rgb;
use crate::medium::Medium;
use crate::subsurface::inversion::{Illumination, single_scattering_albedo};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Compiled constant surfaces by all that they come from; an edit of a material removes its own.
#[derive(Default)]
pub(super) struct SurfaceCache(BTreeMap<Key, Made>);

/// A material's path and what is not the material's: displayColor and displayOpacity, bits, and the boundary that the
/// settings force.
type Key = (String, Option<[u32; 3]>, u32, String);

impl SurfaceCache {
    /// The material at `path` is another one, or gone.
    pub fn forget(&mut self, path: &str) {
        self.0.retain(|key, _| key.0 != path);
    }
}

/// A constant surface, and what there is to say of its material to everyone who wears it.
struct Made {
    surface: Surface,
    faults: Vec<String>,
}

/// The coatings of a mesh, by material slot.
pub(super) struct Worn {
    pub coatings: Vec<Coating>,
    pub warnings: Vec<Warning>,
}

/// A mesh that wears something.
#[derive(Clone, Copy)]
pub(super) struct Wearer<'a> {
    pub path: &'a str,
    pub mesh: &'a Mesh,
    pub geometry: &'a Geometry,
}

/// One of its material slots.
struct Slot<'a> {
    wearer: Wearer<'a>,
    /// Path; empty: none.
    material: &'a str,
    display_opacity: f32,
    /// A material that is for curves, on a mesh of none.
    misplaced: Option<&'a str>,
}

/// Compiles coatings.
pub(super) struct Coats<'a> {
    flat: &'a FlatScene,
    images: &'a ImageCache,
    /// Of what has none.
    standard: Material,
}

impl<'a> Coats<'a> {
    pub fn new(flat: &'a FlatScene, images: &'a ImageCache) -> Self {
        Self { flat, images, standard: Material::default() }
    }

    /// What each of `wearers` wears, in order. What the cache has no use for is dropped from it.
    pub fn of(&self, wearers: &[Wearer<'a>], cache: &mut SurfaceCache) -> Vec<Worn> {
        let slots: Vec<Vec<Slot>> = wearers.iter().map(|wearer| self.slots(*wearer)).collect();
        let constant = slots.iter().flatten().filter(|slot| !self.is_driven(slot));
        let wanted: BTreeMap<Key, &Slot> = constant.map(|slot| (self.key(slot), slot)).collect();
        cache.0.retain(|key, _| wanted.contains_key(key));
        let missing: Vec<(Key, &Slot)> = wanted.into_iter().filter(|(key, _)| !cache.0.contains_key(key)).collect();
        let made: Vec<(Key, Made)> = missing.into_par_iter().map(|(key, slot)| (key, self.make(slot))).collect();
        cache.0.extend(made);
        slots.par_iter().zip(wearers).map(|(slots, wearer)| self.worn(*wearer, slots, cache)).collect()
    }

    fn slots(&self, wearer: Wearer<'a>) -> Vec<Slot<'a>> {
        let Wearer { mesh, geometry, .. } = wearer;
        let subsets =
            mesh.geom_subsets.iter().map(|s| if s.material.is_empty() { &mesh.material } else { &s.material });
        let used = geometry.slots_in_use(1 + mesh.geom_subsets.len());
        let materials = std::iter::once(&mesh.material).chain(subsets).zip(used);
        let slot = |(material, used): (&'a String, bool)| {
            // What no face wears is none of the scene's: its slot is there, with a surface that needs nothing.
            let (material, display_opacity) = if used { (&**material, geometry.display_opacity) } else { ("", 1.0) };
            let is_hair = matches!(self.flat.materials.get(material), Some(Material::Hair(_)));
            let misplaced = (is_hair && geometry.strands.is_none()).then_some(material);
            let material = if misplaced.is_some() { "" } else { material };
            Slot { wearer, material, display_opacity, misplaced }
        };
        materials.map(slot).collect()
    }

    fn worn(&self, wearer: Wearer, slots: &[Slot], cache: &SurfaceCache) -> Worn {
        let mut warnings = Vec::new();
        if wearer.mesh.display_opacity.as_ref().is_some_and(|o| o.values.iter().any(|&v| v != o.values[0])) {
            let message = "primvars:displayOpacity varies over the mesh: its first value is used everywhere";
            warnings.push(Warning::new(wearer.path, message));
        }
        let coatings = slots.iter().map(|slot| self.coating(slot, cache, &mut warnings)).collect();
        Worn { coatings, warnings }
    }

    fn coating(&self, slot: &Slot, cache: &SurfaceCache, warnings: &mut Vec<Warning>) -> Coating {
        let Wearer { path, geometry, .. } = slot.wearer;
        if let Some(material) = slot.misplaced {
            let message = format!("material:binding: {material} is for curves; displayColor is used");
            warnings.push(Warning::new(path, message));
        }
        let prim = if slot.material.is_empty() { path } else { slot.material };
        let (driven, surface) = if self.is_driven(slot) {
            let of_mesh = self.of_mesh(slot);
            let (driven, typical) =
                Driven::compile(self.material(slot), geometry, of_mesh, self.images, prim, warnings);
            (Some(Box::new(driven)), typical)
        } else {
            let made = &cache.0[&self.key(slot)];
            warnings.extend(made.faults.iter().map(|fault| Warning::new(prim, fault.as_str())));
            (None, made.surface)
        };
        let interior = surface.interior().map(|interior| compile_interior(&interior));
        if let Some(interior) = &interior {
            warnings.extend(open_boundary(path, geometry, interior.medium.scatters()));
        }
        Coating { surface, interior, driven }
    }

    fn make(&self, slot: &Slot) -> Made {
        let OfMesh { display_color, display_opacity, boundary_override } = self.of_mesh(slot);
        let mut warnings = Vec::new();
        let material = self.material(slot);
        let surface = Surface::compile(material, display_color, display_opacity, boundary_override, "", &mut warnings);
        Made { surface, faults: warnings.into_iter().map(|warning| warning.message).collect() }
    }

    fn is_driven(&self, slot: &Slot) -> bool {
        !self.material(slot).network().is_empty()
    }

    fn material(&self, slot: &Slot) -> &Material {
        self.flat.materials.get(slot.material).unwrap_or(&self.standard)
    }

    fn of_mesh(&self, slot: &Slot) -> OfMesh {
        let display_color = match &slot.wearer.geometry.display_color {
            Some(Attribute::Constant(color)) => Some(*color),
            _ => None,
        };
        let boundary_override = Boundary::from_token(&self.flat.settings.subsurface_boundary);
        OfMesh { display_color, display_opacity: slot.display_opacity, boundary_override }
    }

    fn key(&self, slot: &Slot) -> Key {
        let OfMesh { display_color, display_opacity, .. } = self.of_mesh(slot);
        let color = display_color.map(|c| c.to_array().map(f32::to_bits));
        (slot.material.to_owned(), color, display_opacity.to_bits(), self.flat.settings.subsurface_boundary.clone())
    }
}

/// What there is to say of a mesh that does not enclose its medium.
fn open_boundary(path: &str, geometry: &Geometry, scatters: bool) -> Option<Warning> {
    let open_edges = geometry.open_edges();
    let lost = if scatters {
        "walks that leak through the gaps end black (walks_leaked in the statistics)"
    } else {
        "what refracts in and does not refract out again keeps 1 / ior^2 of its radiance"
    };
    let message = format!(
        "faceVertexIndices: {open_edges} edges belong to a single face, so the mesh does not enclose its medium; {lost}: \
         close the mesh"
    );
    (open_edges > 0).then(|| Warning::new(path, message))
}

/// The shortest mean free path, stage units: 1 / sigma_t and sigma_t * t stay finite in f32.
const MIN_MEAN_FREE_PATH: f32 = 1e-30;

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
