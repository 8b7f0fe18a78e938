//! Looking at the guide: what AOVs, statistics and `dermis explain` show of it.

use super::plan::{Looks, Plan, Walk, plans};
use super::{ExitLights, Guide};
use crate::flat::{Prims, RenderSettings};
use crate::math::Rgb;
use crate::scene::{Explanation, Scene};
use crate::subsurface::technique::Techniques;
use glam::Vec3;
use serde::Serialize;

/// Shares of `techniques`: classical, the point of entry (lane 0, if it is `entry`'s), other normals.
pub fn shares_by_kind(techniques: &Techniques, entry: bool) -> [f32; 3] {
    let shares = &techniques.shares;
    let own = if entry { (0..3).map(|c| shares.guided[c][0]).sum() } else { 0.0 };
    let classical: f32 = shares.classical.iter().sum();
    let guided: f32 = shares.guided.as_flattened().iter().sum();
    [classical, own, guided - own]
}

impl Walk {
    /// Whether lane 0 of its techniques is the normal of the point of entry; `found`: a region knows them.
    pub fn has_entry(self, found: bool) -> bool {
        match self {
            Walk::Cp => false,
            Walk::Bono | Walk::Bill => !found,
            _ => true,
        }
    }
}

impl Guide {
    /// Gives the regions numbers that are unique over instances, for AOVs; once the fields are filled.
    pub fn number_regions(&mut self) {
        let counts = self.fields.iter().map(|field| field.as_ref().map_or(0, |field| field.counts()[0] as u32));
        let first = counts.scan(0, |next, count| {
            *next += count;
            Some(*next - count)
        });
        self.numbers = first.collect();
    }

    /// Whether AOVs show walks: regions have numbers.
    pub fn watched(&self) -> bool {
        !self.numbers.is_empty()
    }

    /// Number of the region of a walk that enters `instance` at `p` (walk space), outward normal `n`, and the
    /// irradiance there.
    pub fn numbered(&self, instance: u32, p: Vec3, n: Vec3) -> Option<(u32, Rgb)> {
        let at = self.region(instance, p, n)?;
        let cell = &self.fields[at.instance as usize].as_ref()?.cache.means[at.region as usize];
        Some((self.numbers[at.instance as usize] + at.region, cell.irradiance))
    }

    /// Mean shares over the regions where walks of the exact mixture started, and how many of those have control
    /// variates.
    pub fn learned(&self) -> Learned {
        let fields = self.fields.iter().flatten().filter(|field| field.learns());
        let mut learned = Learned::default();
        let mut sums = [0.0; 3];
        for (field, region) in fields.flat_map(|field| field.started().map(move |region| (field, region))) {
            learned.regions += 1;
            learned.controlled += usize::from(region.controls.is_some());
            let shares = shares_by_kind(&region.techniques, field.walk().has_entry(true));
            (0..3).for_each(|kind| sums[kind] += f64::from(shares[kind]));
        }
        let [classical, entry, clusters] = sums.map(|sum| sum / learned.regions.max(1) as f64);
        learned.shares = TechniqueShares { classical, entry, clusters };
        learned
    }
}

/// What passes have taught, over regions where walks started.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Learned {
    pub regions: usize,
    /// Of them, those with control variates.
    pub controlled: usize,
    pub shares: TechniqueShares,
}

/// Sums to 1 where there are regions with walks, else zero.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TechniqueShares {
    pub classical: f64,
    pub entry: f64,
    pub clusters: f64,
}

/// The plan of one medium, for people.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MediumPlan {
    /// Of the mesh, or of the GeomSubset that wears the material.
    pub prim: String,
    #[serde(flatten)]
    pub plan: Plan,
}

/// The plans of all media of a scene that was compiled from `meshes`.
pub fn media(scene: &Scene, settings: &RenderSettings, meshes: &Prims<crate::flat::Mesh>) -> Vec<MediumPlan> {
    let plans = plans(scene, settings);
    let paths: Vec<(&String, &crate::flat::Mesh)> = meshes.iter().collect();
    let planned = plans.into_iter().enumerate().filter_map(|(surface, plan)| Some((surface, plan?)));
    planned
        .filter_map(|(surface, plan)| {
            let owner = scene.owner(surface)?;
            let (path, mesh) = paths[owner.prim_id as usize];
            // Slot 0 is the mesh's own, then come its subsets.
            let subset = (surface - owner.surfaces as usize).checked_sub(1).and_then(|i| mesh.geom_subsets.get(i));
            Some(MediumPlan { prim: subset.map_or(path, |subset| &subset.path).clone(), plan })
        })
        .collect()
}

/// Lines of `dermis explain` for the guide.
pub fn explain(scene: &Scene, settings: &RenderSettings) -> Vec<Explanation> {
    let plans: Vec<Plan> = plans(scene, settings).into_iter().flatten().collect();
    let count = |wanted: &dyn Fn(&&Plan) -> bool| plans.iter().filter(wanted).count();
    let cached = count(&|plan| plan.needs_cache());
    let exact = count(&|plan| plan.needs_cache() && plan.exact);
    let mixtures = count(&|plan| plan.walk == Walk::Mixture && plan.exact);
    let bent = count(&|plan| plan.looks != Looks::Not);
    let lights = ExitLights::of(scene, settings);
    let line = Explanation::new;
    let guided = count(&|plan| plan.walk != Walk::Classical);
    let by_lights = lights == ExitLights::Learned && !plans.is_empty();
    let media = |n: usize| if n == 1 { "1 medium".to_owned() } else { format!("{n} media") };
    let cache = format!(
        "filled from the {}: {}",
        settings.cache_fill,
        match (cached, by_lights) {
            (0, _) => "exits choose their light by what is visible there".into(),
            (n, _) => format!("walks in {} choose their slab normals by the light there", media(n)),
        }
    );
    let bent_why = match settings.refracted_light.as_str() {
        "auto" => format!("collisions in {} look for small lights through its boundary", media(bent)),
        asked => format!(
            "collisions look for lights through the boundaries of {}; refractedLight={asked} asked for",
            media(bent)
        ),
    };
    vec![
        line("guided walks", guided > 0, format!("in {}", media(guided)), "no walk follows a slab normal"),
        line("boundary cache", cached > 0 || by_lights, cache, "no walk and no exit asks it"),
        line(
            "learned shares",
            settings.learn_shares && mixtures > 0,
            format!("walks in {} move the shares of their techniques between passes", media(mixtures)),
            "no walks of the mixture with exact weights, or learnShares=false",
        ),
        line(
            "control variates",
            settings.control_variates && exact > 0,
            format!("densities of the techniques in {}, fitted between passes", media(exact)),
            "no walks with exact weights from a boundary cache, or controlVariates=false",
        ),
        line(
            "refracted light",
            bent > 0,
            bent_why,
            "no dielectric boundary with small lights around it (meshes do not count) and nothing within, or a smooth \
             one, exact weights and no suns",
        ),
        line(
            "exit lights",
            !plans.is_empty(),
            lights.explain(scene.lights.len(), &settings.exit_lights),
            "nothing comes out of a medium",
        ),
    ]
}

impl ExitLights {
    fn explain(self, lights: usize, asked: &str) -> String {
        let how = match self {
            Self::One => "one",
            Self::All => "all",
            Self::Learned => "learned: four, by the share of each light, or cluster of lights, that its region saw",
        };
        match asked {
            "auto" => format!("{how}; {lights} lights, and up to {} are all sampled", super::FEW_LIGHTS),
            _ => format!("{how}; exitLights={asked} asked for"),
        }
    }
}
