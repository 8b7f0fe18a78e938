//! The guide of one boundary: its cache, and per region the techniques of walks that start there.

use super::cache::{Cache, Record};
use super::control::Controls;
use super::exit::Exits;
use super::learn::learn;
use super::normals::{self, Sources};
use super::onward::Onward;
use super::plan::Walk;
use super::receivers::Receivers;
use super::statistics::{ControlSums, Sums};
use super::weights::Profile;
use crate::light::Parts;
use crate::medium::Medium;
use crate::saved::{Loader, Saver, damaged};
use crate::subsurface::technique::Techniques;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::io;
use std::sync::OnceLock;

/// Techniques of a region, and what is known of them.
#[derive(Debug, Clone)]
pub struct Region {
    pub techniques: Techniques,
    pub controls: Option<Controls>,
    pub onward: Onward,
    sums: Sums,
}

#[derive(Debug)]
pub struct Field {
    pub cache: Cache,
    sources: Sources,
    settings: FieldSettings,
    /// Made when a walk first starts there, from the cache alone: threads agree.
    regions: Vec<OnceLock<Box<Region>>>,
    /// Choice of one region's normal: of the walks that follow the paper.
    receivers: Option<Receivers>,
    /// Where walks that come out go on: of the mixture.
    pub exits: Option<Exits>,
    /// Where nothing was recorded.
    pub elsewhere: Techniques,
}

/// How a field is made.
#[derive(Debug, Clone, Copy)]
pub struct FieldSettings {
    pub walk: Walk,
    pub exact: bool,
    /// Edge of a cell, stage units.
    pub cell: f32,
    /// Records that saw light from which a cell is lit.
    pub least_lit: u32,
    /// Every cell counts as the face of its voxel: the records are not uniform over the surface.
    pub uniform_area: bool,
    pub normals: usize,
    /// Share of classical walks at the start.
    pub classical: f32,
    pub guided_first: bool,
    pub guide_exits: bool,
}

/// How much of what older passes saw still counts: shares have moved since.
const FADE: f64 = 0.5;

/// The same of the sums for control variates and of efforts: a regression hardly minds that shares have moved.
const FADE_CONTROLS: f64 = 0.8;

impl Region {
    fn learn(&mut self, seen: &Sums, shares: Option<f64>, controls: bool) {
        self.sums.fade(FADE);
        if let Some(old) = &mut self.sums.controls {
            old.fade(FADE_CONTROLS);
        }
        self.sums.effort.fade(FADE_CONTROLS);
        self.sums.merge(seen);
        self.onward = self.sums.effort.onward(self.onward);
        // The controls were seen under the shares that this pass had.
        if let (true, Some(sums)) = (controls, &self.sums.controls) {
            self.controls = Controls::fit(sums, &self.techniques.shares);
        }
        if let Some(classical) = shares {
            learn(&mut self.techniques, &self.sums, classical);
        }
    }
}

impl Field {
    /// `parts`: of the lights, if it is learned which of them exits see.
    pub fn build(records: &[Record], medium: &Medium, parts: &Parts, settings: FieldSettings) -> Self {
        let build = |size: f32, parts: &Parts| {
            let mut cache = Cache::build(size, records, settings.least_lit, parts);
            if settings.uniform_area {
                cache.means.iter_mut().for_each(|cell| cell.area = size * size);
            }
            cache
        };
        let cache = build(settings.cell, parts);
        let bill = settings.walk == Walk::Bill;
        let cells = cache.means.len();
        let conditional = matches!(settings.walk, Walk::Bono | Walk::Bill) && !settings.exact;
        let sources =
            Sources::new(records, |size| build(size, &Parts::default()), settings.cell, Profile::new(medium), bill);
        Self {
            exits: settings.guide_exits.then(|| Exits::new(&sources.cache, records)),
            sources,
            regions: (0..cells).map(|_| OnceLock::new()).collect(),
            receivers: conditional.then(|| Receivers::new(cells)),
            elsewhere: normals::without_cache(settings.classical, settings.guided_first),
            settings,
            cache,
        }
    }

    pub fn find(&self, p: Vec3, n: Vec3) -> Option<u32> {
        self.cache.cells.find(p, n)
    }

    pub fn region(&self, region: u32) -> &Region {
        self.regions[region as usize].get_or_init(|| Box::new(self.first_region(region)))
    }

    /// Regions where a walk has started.
    pub fn started(&self) -> impl Iterator<Item = &Region> {
        self.regions.iter().filter_map(|region| region.get().map(Box::as_ref))
    }

    pub fn walk(&self) -> Walk {
        self.settings.walk
    }

    fn first_region(&self, region: u32) -> Region {
        let FieldSettings { walk, exact, normals, classical, guided_first, .. } = self.settings;
        let receiver = &self.cache.means[region as usize];
        let techniques = match (walk, exact) {
            (Walk::Mixture, _) => {
                Some(normals::initial_techniques(&self.sources, receiver, normals, classical, guided_first))
            }
            (Walk::Bono | Walk::Bill, true) => {
                normals::paper_techniques(&self.sources, receiver, classical, guided_first)
            }
            _ => None,
        };
        // Where no light is known the point of entry's normal is left, here that of the region.
        let mut poe = self.elsewhere;
        poe.set_normal(0, receiver.normal);
        Region { techniques: techniques.unwrap_or(poe), controls: None, onward: Onward::UNKNOWN, sums: Sums::default() }
    }

    /// The paper's choice of a slab normal for a walk that starts in `region`.
    pub fn slab_normal(&self, region: u32, u: (f32, f32), u_direction: Vec2) -> Option<Vec3> {
        let receiver = &self.cache.means[region as usize];
        self.receivers.as_ref()?.sample(&self.sources, region, receiver, u, u_direction)
    }

    /// Whether walks have anything to teach: not those of the literature that are weighted by one normal.
    pub fn learns(&self) -> bool {
        self.settings.exact || self.exits.is_some()
    }

    /// Takes in what a pass has `seen`, by ascending region; `share`s and `controls` as asked for.
    pub fn learn(&mut self, seen: &[(u32, &Sums)], shares: Option<f64>, controls: bool) {
        // Shares may move: the mixture's, not those of a walk of the literature.
        let shares = shares.filter(|_| self.settings.walk == Walk::Mixture);
        let mut seen = seen.iter().peekable();
        let started = self.regions.iter_mut().zip(0..).filter_map(|(region, i)| {
            let (_, sums) = seen.next_if(|(at, _)| *at == i)?;
            Some((region.get_mut()?, *sums))
        });
        let started: Vec<(&mut Box<Region>, &Sums)> = started.collect();
        started.into_par_iter().for_each(|(region, sums)| region.learn(sums, shares, controls));
    }

    /// What regions and exits have learned; caches and slab normals are made again.
    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        let started =
            self.regions.iter().enumerate().filter_map(|(number, region)| Some((number as u32, region.get()?)));
        to.count(started.clone().count())?;
        for (number, region) in started {
            to.value(&number)?;
            to.value(&region.techniques.shares)?;
            to.value(&u8::from(region.controls.is_some()))?;
            region.controls.as_ref().map_or(Ok(()), |controls| to.value(controls))?;
            to.value(&region.onward)?;
            region.sums.save(to)?;
        }
        self.exits.as_ref().map_or(Ok(()), |exits| exits.save(to))
    }

    pub(crate) fn load(&mut self, from: &mut Loader) -> io::Result<()> {
        for _ in 0..from.count()? {
            let number: u32 = from.value()?;
            if number as usize >= self.regions.len() {
                return Err(damaged("a region"));
            }
            let mut region = self.first_region(number);
            region.techniques.shares = from.value()?;
            region.controls = if from.value::<u8>()? == 1 { Some(from.value()?) } else { None };
            region.onward = from.value()?;
            region.sums = Sums::load(from)?;
            self.regions[number as usize] = OnceLock::from(Box::new(region));
        }
        self.exits.as_mut().map_or(Ok(()), |exits| exits.load(from))
    }

    /// Regions, and those of them that are lit.
    pub fn counts(&self) -> [usize; 2] {
        [self.cache.means.len(), self.cache.means.iter().filter(|cell| cell.lit).count()]
    }

    pub fn memory(&self) -> usize {
        let of_region = |region: &Region| {
            size_of::<Region>() + region.sums.controls.as_ref().map_or(0, |_| size_of::<ControlSums>())
        };
        let regions = self.regions.iter().map(|region| 16 + region.get().map_or(0, |region| of_region(region)));
        let caches = self.cache.memory() + self.sources.cache.memory();
        let caches = caches + self.exits.as_ref().map_or(0, Exits::memory);
        caches + regions.sum::<usize>() + self.receivers.as_ref().map_or(0, Receivers::memory)
    }
}
