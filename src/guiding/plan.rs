//! Which walk each medium takes, and why.

use crate::bsdf::Boundary;
use crate::flat::RenderSettings;
use crate::medium::Medium;
use crate::scene::{Coating, Driven, Instance, Interior, Scene};
use crate::subsurface::technique::GuidedMedium;
use serde::Serialize;

/// A walk by what its slab normals come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Walk {
    Classical,
    /// Normal of the point of entry.
    Poe,
    /// Closest boundary point to the first collision (Meng et al. 2016).
    Cp,
    /// A point of a light as seen from the first collision (Meng et al. 2016).
    Ii,
    /// Normals of lit boundary regions (Gouder et al. 2025).
    Bono,
    /// Directions of incident light at lit boundary regions (Gouder et al. 2025).
    Bill,
    /// All of clustered boundary normals, point of entry and classical, with learned shares.
    Mixture,
}

/// How collisions look for light through a boundary that bends it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Looks {
    Not,
    /// Into single directions: where beams of light come from, or by searching.
    Smooth,
    /// The latter alone, for suns.
    Suns,
    /// By its facets.
    Rough,
}

/// What is done for one medium.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    pub walk: Walk,
    /// Weighted by the marginal over all techniques; else by the one that was drawn.
    pub exact: bool,
    /// How collisions look for light through a boundary that bends it.
    pub looks: Looks,
    /// Neighbouring pixels share the paths through it.
    pub shares: bool,
    pub why: String,
}

impl Plan {
    /// Whether regions of the boundary have to be known.
    pub fn needs_cache(&self) -> bool {
        matches!(self.walk, Walk::Bono | Walk::Bill | Walk::Mixture)
    }

    /// The medium of a walk where it is not that of the surface, with the kernels that the walk needs.
    pub fn medium_at(&self, medium: Medium) -> GuidedMedium {
        // Isotropic kernels take less than a microsecond; driven media of other phase functions are not guided.
        if self.walk == Walk::Classical { GuidedMedium::unguided(medium) } else { GuidedMedium::new(medium) }
    }
}

/// Mean free paths across the object below which most light crosses it with few collisions to guide (usd_scenes/bench_rigs.json:
/// `mixture` has 0.9 of the efficiency of classical walks on bunny_x3, 2 across, and 1.1 on bunny, 6 across).
const THIN: f32 = 4.0;

/// The same behind a dielectric, where what leaves is refracted past the lights and most of the noise is that: short walks
/// gain less than guiding costs (bunny_smooth in usd_scenes/bench_rigs.json: 6 across, 0.8 of the efficiency).
const THIN_DIELECTRIC: f32 = 20.0;

/// A plan for every surface whose medium is walked: one that scatters, or only absorbs behind a diffuse boundary.
pub fn plans(scene: &Scene, settings: &RenderSettings) -> Vec<Option<Plan>> {
    let mut plans: Vec<Option<Plan>> = vec![None; scene.surfaces.len()];
    for (index, coating) in scene.surfaces.iter().enumerate() {
        let walked = |interior: &Interior| interior.medium.scatters() || interior.boundary == Boundary::Diffuse;
        let Some(interior) = coating.interior.filter(walked) else { continue };
        let Some(owner) = scene.owner(index) else { continue };
        let driven = coating.driven.as_deref();
        let varies = driven.is_some_and(Driven::medium);
        let anisotropic = interior.medium.g != 0.0 || driven.is_some_and(Driven::anisotropy);
        let mut plan = if varies && anisotropic {
            let why = "its medium is driven and its phase function is not isotropic: kernels for each point would take \
                       longer than its walks";
            Plan { walk: Walk::Classical, exact: false, looks: Looks::Not, shares: false, why: why.into() }
        } else {
            plan(settings, &interior, owner.thickness(), scene.is_lit())
        };
        if varies && !anisotropic {
            plan.why += "; driven: each walk has the medium of its entry";
        }
        plan.looks = looks(scene, settings, coating, owner, &plan);
        plan.why += match plan.looks {
            Looks::Not => "",
            Looks::Smooth => "; collisions look for light through its smooth boundary",
            Looks::Suns => "; collisions look for suns through its smooth boundary",
            Looks::Rough => "; collisions look for light through its rough boundary",
        };
        plan.shares = shares(scene, settings, &interior, varies);
        if plan.shares {
            plan.why += "; neighbouring pixels share its paths";
        }
        plans[index] = Some(plan);
    }
    plans
}

/// Whether collisions look for light through the boundary of a medium that scatters. By itself only where lights are small, and
/// through a smooth boundary for nothing but suns in walks of the mixture: those are for bodies so thick that light seldom gets
/// to a collision straight, and each of theirs would cost a sum over techniques. `owner` wears the `coating`.
fn looks(scene: &Scene, settings: &RenderSettings, coating: &Coating, owner: &Instance, plan: &Plan) -> Looks {
    let bends = |interior: Interior| interior.medium.scatters() && interior.boundary == Boundary::Dielectric;
    let small = match settings.refracted_light.as_str() {
        "off" => false,
        "on" => scene.lights.has_sought(),
        _ => scene.lights.has_small(),
    };
    if !(small && coating.interior.is_some_and(bends) && is_alone_somewhere(scene, owner)) {
        return Looks::Not;
    }
    if coating.surface.rough_interface(1.0).is_some() {
        return Looks::Rough;
    }
    // These know one medium, one index and the mesh's own normals: where a network drives them, chance has the light.
    let constant = coating.driven.is_none();
    let smooth = constant && coating.surface.smooth_interface().is_some() && has_plain_normals(scene, owner);
    match settings.refracted_light == "on" || !plan.exact {
        _ if !smooth => Looks::Not,
        true => Looks::Smooth,
        false if scene.lights.has_suns() => Looks::Suns,
        false => Looks::Not,
    }
}

/// Whether neighbouring pixels may share paths: all that they need to know of each other's is the way from vertex to vertex, so that nothing
/// that is shared may depend on its direction, on the entry, or on the time. Walks that were asked for are those of the literature.
fn shares(scene: &Scene, settings: &RenderSettings, interior: &Interior, varies: bool) -> bool {
    let wanted = match settings.shared_paths.as_str() {
        "off" => false,
        "on" => true,
        _ => settings.walk == "auto",
    };
    let plain = interior.boundary != Boundary::IndexMatched && interior.medium.g == 0.0 && !varies;
    wanted && plain && interior.medium.scatters() && scene.frozen.is_some()
}

/// Whether no part of a mesh bends its normals: light that came in elsewhere may leave there.
fn has_plain_normals(scene: &Scene, of: &Instance) -> bool {
    of.coatings(&scene.surfaces).iter().all(|coating| !coating.driven.as_deref().is_some_and(Driven::bends))
}

/// Whether walks in an instance of the mesh of `of` go from boundary to boundary: others do not look.
fn is_alone_somewhere(scene: &Scene, of: &Instance) -> bool {
    (0..).zip(&scene.instances).any(|(index, other)| other.surfaces == of.surfaces && scene.is_alone(index))
}

fn plan(settings: &RenderSettings, interior: &Interior, thickness: f32, lit: bool) -> Plan {
    let asked = |walk, exact| Plan {
        walk,
        exact,
        looks: Looks::Not,
        shares: false,
        why: format!("walk={} asked for", settings.walk),
    };
    if !interior.medium.scatters() {
        return Plan {
            walk: Walk::Classical,
            exact: false,
            looks: Looks::Not,
            shares: false,
            why: "it only absorbs, so there is nothing to guide".into(),
        };
    }
    let exact = settings.walk_pdf != "conditional";
    match settings.walk.as_str() {
        "classical" => asked(Walk::Classical, false),
        "poe" => asked(Walk::Poe, exact),
        "cp" => asked(Walk::Cp, exact),
        "ii" => asked(Walk::Ii, false),
        "bono" => asked(Walk::Bono, exact),
        "bill" => asked(Walk::Bill, exact),
        "mixture" => asked(Walk::Mixture, exact),
        _ => automatic(interior, thickness, lit, exact),
    }
}

fn automatic(interior: &Interior, thickness: f32, lit: bool, exact: bool) -> Plan {
    let depth = interior.medium.sigma_t.max_element() * thickness;
    let classical = |why: String| Plan { walk: Walk::Classical, exact: false, looks: Looks::Not, shares: false, why };
    if !lit {
        return classical("nothing emits light, so there is no light to walk to".into());
    }
    if depth < THIN {
        return classical(format!("{depth:.2} mean free paths across: most light passes with few collisions"));
    }
    if interior.boundary == Boundary::Dielectric && depth < THIN_DIELECTRIC {
        return classical(format!(
            "{depth:.0} mean free paths across behind a dielectric: walks are too short for guiding to pay"
        ));
    }
    Plan {
        walk: Walk::Mixture,
        exact,
        looks: Looks::Not,
        shares: false,
        why: format!("{depth:.0} mean free paths across, lit"),
    }
}
