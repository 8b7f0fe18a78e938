//! Guiding: what steers subsurface walks, learned at the boundary of each medium.
//!
//! `plan` decides per medium, `cache` holds what light reaches the boundary (`cells`, filled by the renderer), `weights` and `normals`
//! turn it into slab normals per region (`field`), or `receivers` into the paper's choice of one; `statistics` of the walks then
//! move the shares (`learn`) and fit control variates (`control`). A guide does not change while a pass renders. `beams` say
//! where light comes from within smooth dielectrics.

pub mod beams;
pub mod cache;
mod cells;
pub mod control;
pub mod directions;
pub mod exit;
pub mod field;
pub mod fit;
pub mod learn;
pub mod look;
mod normals;
pub mod onward;
pub mod plan;
mod receivers;
pub mod statistics;
pub mod vmf;
mod weights;

use crate::flat::RenderSettings;
use crate::light::Choice;
use crate::saved::{Loader, Saver};
use crate::scene::Scene;
use crate::subsurface::technique::{GuidedMedium, Techniques};
use beams::Beams;
use control::Controls;
use exit::Exit;
use field::Field;
use glam::{Vec2, Vec3};
use onward::Onward;
use plan::{Looks, Plan, Walk, plans};
use statistics::{RegionId, Statistics, Sums};
use std::collections::BTreeMap;
use std::io;

/// How the lights of a point where a walk comes out are sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExitLights {
    One,
    All,
    /// Some, by the visible shares that its region learned.
    Learned,
}

/// Most lights that are all sampled at an exit: each costs a shadow ray (mixture_3d.md section 5).
const FEW_LIGHTS: usize = 8;

/// Light samples at an exit, shared by the lights where all are sampled, drawn where they are learned: a shadow ray costs a tenth of the path that
/// led there.
const EXIT_SAMPLES: u32 = 4;

impl ExitLights {
    /// As asked for, or by how many lights there are.
    fn of(scene: &Scene, settings: &RenderSettings) -> Self {
        match settings.exit_lights.as_str() {
            "one" => Self::One,
            "all" => Self::All,
            "learned" => Self::Learned,
            _ if scene.lights.len() <= FEW_LIGHTS => Self::All,
            _ => Self::Learned,
        }
    }
}

/// What guides the walks of a scene.
pub struct Guide {
    /// By surface; `None`: no scattering medium.
    pub plans: Vec<Option<Plan>>,
    /// Whether collisions search for suns.
    pub suns: bool,
    /// By surface.
    media: Vec<Option<GuidedMedium>>,
    /// By instance; `None`: nothing to know about its boundary. Boxed: of a million instances few have one.
    pub fields: Vec<Option<Box<Field>>>,
    /// Of bodies, or of several that share it.
    beams: Vec<Beams>,
    /// By instance, index of its own in `beams`; `u32::MAX`, or empty: none.
    beams_of: Vec<u32>,
    /// By instance, the one whose field it shares; empty: each has its own.
    pub homes: Vec<u32>,
    pub exit_lights: ExitLights,
    /// Samples of each light where all are sampled at an exit.
    light_samples: u32,
    pub guided_first: bool,
    pub classical: f32,
    pub stratify: bool,
    learn_shares: bool,
    pub controls: bool,
    /// First number of each instance's regions; empty: no AOV asks for them.
    numbers: Vec<u32>,
}

/// What a walk of the exact mixture starts with.
pub struct Start<'a> {
    pub techniques: Techniques,
    pub region: Option<RegionId>,
    pub controls: Option<&'a Controls>,
    /// Where paths go on in several ways.
    pub onward: Option<Onward>,
}

impl Guide {
    /// Plans and kernels; fields are to be filled where a plan needs them.
    pub fn new(scene: &Scene, settings: &RenderSettings) -> Self {
        let plans = plans(scene, settings);
        // Of domes that looks at every pixel.
        let searches = |plan: &Plan| matches!(plan.looks, Looks::Smooth | Looks::Suns);
        let suns = plans.iter().flatten().any(searches) && scene.lights.has_suns();
        let media = plans
            .iter()
            .zip(&scene.surfaces)
            .map(|(plan, coating)| Some(plan.as_ref()?.medium_at(coating.interior?.medium)));
        Self {
            media: media.collect(),
            fields: scene.instances.iter().map(|_| None).collect(),
            beams: Vec::new(),
            beams_of: Vec::new(),
            homes: Vec::new(),
            plans,
            suns,
            light_samples: (EXIT_SAMPLES / scene.lights.len().max(1) as u32).max(1),
            exit_lights: ExitLights::of(scene, settings),
            guided_first: settings.first_distance != "classical",
            classical: settings.classical_fraction,
            stratify: settings.stratify_techniques,
            learn_shares: settings.learn_shares,
            controls: settings.control_variates,
            numbers: Vec::new(),
        }
    }

    pub fn plan(&self, surface: u32) -> Option<(&Plan, &GuidedMedium)> {
        Some((self.plans[surface as usize].as_ref()?, self.media[surface as usize].as_ref()?))
    }

    /// Whether what light reaches a boundary with this plan has to be known.
    pub fn must_know(&self, plan: &Plan) -> bool {
        plan.needs_cache() || self.exit_lights == ExitLights::Learned
    }

    /// Share of classical walks that a field starts with.
    pub fn start_fraction(&self, mixture: bool) -> f32 {
        if mixture { self.classical.max(normals::CLASSICAL_START) } else { self.classical }
    }

    /// The instance that has the field of `instance`. Walk spaces of those that share one are alike.
    fn home(&self, instance: u32) -> u32 {
        self.homes.get(instance as usize).copied().unwrap_or(instance)
    }

    /// The light within `instance` that nothing has scattered yet, if it is known.
    pub fn beams_in(&self, instance: u32) -> Option<&Beams> {
        self.beams.get(*self.beams_of.get(instance as usize)? as usize)
    }

    /// Gives `members`, of `instances`, their beams.
    pub fn set_beams(&mut self, instances: usize, members: &[u32], beams: Beams) {
        self.beams_of.resize(instances, u32::MAX);
        members.iter().for_each(|&member| self.beams_of[member as usize] = self.beams.len() as u32);
        self.beams.push(beams);
    }

    fn region(&self, instance: u32, p: Vec3, n: Vec3) -> Option<RegionId> {
        let instance = self.home(instance);
        let field = self.fields[instance as usize].as_ref()?;
        Some(RegionId { instance, region: field.find(p, n)? })
    }

    /// Techniques of an exact walk that enters `instance` at `p` (walk space), outward normal `n`.
    pub fn start(&self, walk: Walk, instance: u32, p: Vec3, n: Vec3) -> Start<'_> {
        let home = self.home(instance) as usize;
        let Some(field) = self.fields[home].as_ref().filter(|_| !matches!(walk, Walk::Poe | Walk::Cp)) else {
            let techniques = normals::without_cache(self.classical, self.guided_first && walk != Walk::Cp);
            return Start { techniques: at_entry(techniques, n), region: None, controls: None, onward: None };
        };
        let entry = |techniques: Techniques| if walk == Walk::Mixture { at_entry(techniques, n) } else { techniques };
        match self.region(instance, p, n) {
            Some(region) => {
                let of = field.region(region.region);
                let (controls, onward) = (of.controls.as_ref(), field.exits.is_some().then_some(of.onward));
                Start { techniques: entry(of.techniques), region: Some(region), controls, onward }
            }
            None => Start { techniques: at_entry(field.elsewhere, n), region: None, controls: None, onward: None },
        }
    }

    /// The region where walks enter `instance` at `p` (walk space), outward normal `n`, and what is known of them, if light that
    /// leaves it is guided.
    pub fn onward(&self, instance: u32, p: Vec3, n: Vec3) -> Option<(RegionId, Onward)> {
        let region = self.region(instance, p, n)?;
        let field = self.fields[region.instance as usize].as_ref().filter(|field| field.exits.is_some())?;
        Some((region, field.region(region.region).onward))
    }

    /// The paper's choice of a slab normal for a walk that enters `instance` at `p` (walk space), outward normal `n`.
    pub fn slab_normal(&self, instance: u32, p: Vec3, n: Vec3, u: (f32, f32), u_direction: Vec2) -> Option<Vec3> {
        let field = self.fields[self.home(instance) as usize].as_ref()?;
        field.slab_normal(field.find(p, n)?, u, u_direction)
    }

    /// The lights of a point where light leaves or enters a medium.
    pub fn exit_choice(&self, instance: u32, p: Vec3, n: Vec3) -> LightsAt {
        match self.exit_lights {
            ExitLights::One => LightsAt::One,
            ExitLights::All => LightsAt::All,
            ExitLights::Learned => self.region(instance, p, n).map_or(LightsAt::Some, LightsAt::Region),
        }
    }

    /// The cell where a walk comes out of `instance` at `p` (walk space), outward normal `n`, if directions are learned
    /// there.
    pub fn exit_cell(&self, instance: u32, p: Vec3, n: Vec3) -> Option<RegionId> {
        let instance = self.home(instance);
        let region = self.fields[instance as usize].as_ref()?.exits.as_ref()?.find(p, n)?;
        Some(RegionId { instance, region })
    }

    /// What is known of the directions there.
    pub fn exit(&self, cell: RegionId) -> Option<&Exit> {
        self.fields[cell.instance as usize].as_ref()?.exits.as_ref()?.at(cell.region)
    }

    /// The lights of the first surface behind a pixel: what is seen directly deserves them all where they are few, and some of
    /// many.
    pub fn first_hit_choice(&self) -> LightsAt {
        match self.exit_lights {
            ExitLights::One => LightsAt::One,
            ExitLights::All => LightsAt::Each,
            ExitLights::Learned => LightsAt::Some,
        }
    }

    /// The choice that `exit_choice` stands for.
    pub fn choice(&self, at: LightsAt) -> Choice<'_> {
        match at {
            LightsAt::One => Choice::ONE,
            LightsAt::Some => Choice::Drawn { count: EXIT_SAMPLES, shares: &[] },
            LightsAt::All => Choice::All(self.light_samples),
            LightsAt::Each => Choice::All(1),
            LightsAt::Region(at) => {
                let field = self.fields[at.instance as usize].as_ref();
                Choice::Drawn { count: EXIT_SAMPLES, shares: field.map_or(&[], |f| f.cache.visibility(at.region)) }
            }
        }
    }

    /// Whether neighbouring pixels share paths through any medium.
    pub fn shares(&self) -> bool {
        self.plans.iter().flatten().any(|plan| plan.shares)
    }

    /// Whether walks have anything to teach.
    pub fn learns(&self) -> bool {
        self.fields.iter().flatten().any(|field| field.learns())
    }

    /// Takes in the statistics of a pass.
    pub fn learn(&mut self, seen: &Statistics) {
        let mut walks: BTreeMap<u32, Vec<(u32, &Sums)>> = BTreeMap::new();
        seen.walks.iter().for_each(|(at, sums)| walks.entry(at.instance).or_default().push((at.region, sums)));
        for (instance, seen) in walks {
            let classical = f64::from(self.classical).max(learn::CLASSICAL_FLOOR);
            if let Some(field) = &mut self.fields[instance as usize] {
                field.learn(&seen, self.learn_shares.then_some(classical), self.controls);
            }
        }
        for (at, sums) in &seen.exits {
            if let Some(exits) = self.fields[at.instance as usize].as_mut().and_then(|field| field.exits.as_mut()) {
                exits.add(at.region, sums);
            }
        }
        self.fields.iter_mut().flatten().filter_map(|field| field.exits.as_mut()).for_each(exit::Exits::fit);
    }

    /// What was learned since the fields were filled, for a checkpoint.
    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        self.fields.iter().flatten().try_for_each(|field| field.save(to))
    }

    /// Takes it in again: into a guide whose fields were filled in the same way.
    pub(crate) fn load(&mut self, from: &mut Loader) -> io::Result<()> {
        self.fields.iter_mut().flatten().try_for_each(|field| field.load(from))
    }

    /// Regions of all fields, and those of them that are lit.
    pub fn counts(&self) -> [usize; 2] {
        self.fields.iter().flatten().map(|field| field.counts()).fold([0, 0], |a, b| [a[0] + b[0], a[1] + b[1]])
    }

    pub fn memory(&self) -> usize {
        let beams: usize = self.beams.iter().map(Beams::memory).sum();
        beams
            + size_of::<u32>() * self.beams_of.len()
            + self.fields.iter().flatten().map(|field| field.memory()).sum::<usize>()
    }
}

/// How a vertex sampled its lights: what MIS needs to know when its next segment meets one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LightsAt {
    One,
    /// As many, drawn, as an exit deserves.
    Some,
    /// Each once.
    Each,
    /// Each as often as an exit deserves.
    All,
    Region(RegionId),
}

/// With the normal of the point of entry in lane 0.
fn at_entry(mut techniques: Techniques, n: Vec3) -> Techniques {
    techniques.set_normal(0, n);
    techniques
}
