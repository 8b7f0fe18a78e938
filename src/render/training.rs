//! Filling the boundary caches before the first pass.
//!
//! Points are spread uniformly over the boundary, which reaches the back of an ear that no walk has found yet, or
//! found as the paper does, where camera paths enter and where classical walks come out.

use super::areas::Areas;
use super::bodies::{Aim, Body, share_records};
use super::journal::Journal;
use crate::flat::RenderSettings;
use crate::guiding::beams::Beam;
use crate::guiding::cache::Record;
use crate::guiding::field::{Field, FieldSettings};
use crate::guiding::plan::{Looks, Plan, Walk};
use crate::guiding::{ExitLights, Guide};
use crate::integrator::{PathStats, beams_at, probe};
use crate::light::Parts;
use crate::math::{Frame, Rgb};
use crate::medium::Medium;
use crate::sampling::cosine_hemisphere;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, Instance, InstanceEnclosure, Moment, Scene};
use crate::subsurface::kernel::diffusion_length;
use crate::subsurface::steps::{Start, WalkEnd, WalkStats};
use crate::subsurface::walk::{Along, walk};
use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;
use std::ops::Range;
use std::time::{Duration, Instant};

/// Apart from the samples of the image.
const SEED: u32 = 0x7261_6e64;

/// Camera samples per boundary record: training is then a few percent of a render.
const SAMPLES_PER_RECORD: u64 = 10;

/// Samples per pixel that training is made for; more samples do not need more.
const ENOUGH_SAMPLES: u32 = 64;

const RECORDS: std::ops::RangeInclusive<u64> = 8_000..=400_000;

/// Share of a time limit that finding records may take; making caches of them and learning takes as much again.
const OF_LIMIT: f64 = 0.06;

/// Points that are timed for it.
const TIMED: u32 = 256;

/// Pixels across a cell: some hundred walks start there within the first passes (mixture_3d.md section 5).
const PIXELS: f32 = 6.0;

/// Records per cell on average, at least.
const RECORDS_PER_CELL: f32 = 8.0;

/// The paper's rule for records that come from walks.
const LEAST_LIT_BY_WALKS: u32 = 32;

/// With some records per cell everywhere, two that see light are no accident.
const LEAST_LIT: u32 = 2;

/// Smallest and largest cell relative to the longest side of the object.
const CELL_RANGE: [f32; 2] = [1.0 / 128.0, 1.0 / 4.0];

/// Bodies of one cache that are looked at: shadows of more say little new.
const MOST_PROBED: usize = 64;

/// What training took.
#[derive(Default)]
pub struct Trained {
    pub stats: PathStats,
    /// Records that were asked for.
    pub points: u32,
    pub records: u64,
    /// Bodies with a field, and those too small for one.
    pub bodies: [usize; 2],
}

/// Training of the guide of one render.
pub(super) struct Training<'a, Over: Fn() -> bool> {
    pub scene: &'a Scene,
    pub settings: &'a RenderSettings,
    pub journal: Journal<'a>,
    /// Of the whole render.
    pub limit: Option<Duration>,
    /// The number of records that samples were made with which it goes on from.
    pub points: Option<u32>,
    /// What it leaves out is as if nothing were known there.
    pub is_over: Over,
}

impl<Over: Fn() -> bool> Training<'_, Over> {
    /// Fills the beams and fields of `guide` that its plans need.
    pub fn train(&mut self, guide: &mut Guide) -> Trained {
        let scene = self.scene;
        if !guide.plans.iter().flatten().any(|plan| guide.must_know(plan) || plan.looks == Looks::Smooth) {
            return Trained::default();
        }
        let count = self.count(guide);
        let looked = self.add_beams(guide, count);
        // A body that fills the frame has most of the records, a tooth its share.
        let (shares, small) = share_records(scene, guide, Aim::Records, count);
        let mut trained = Trained { stats: looked, points: count, bodies: [shares.len(), small], ..Trained::default() };
        let learned = guide.exit_lights == ExitLights::Learned && !shares.is_empty();
        let parts = if learned { scene.lights.parts() } else { Parts::default() };
        for body in shares {
            let instance = body.members[0];
            let Some(boundary) = BoundaryOf::new(scene.middle(), guide, instance, Aim::Records) else { continue };
            let Some((found, seen)) = self.records(guide, &body) else { break };
            if body.members.len() > 1 {
                if guide.homes.is_empty() {
                    guide.homes = (0..scene.instances.len() as u32).collect();
                }
                body.members.iter().for_each(|&member| guide.homes[member as usize] = instance);
            }
            trained.stats.add(&seen);
            trained.records += found.len() as u64;
            let of_field = boundary.field_settings(self.settings, guide, found.len());
            let field = Field::build(&found, &boundary.medium, &parts, of_field);
            guide.fields[instance as usize] = Some(Box::new(field));
        }
        trained
    }

    /// Records of all bodies. A render that goes on from samples has as many as those were made with, whatever its limit.
    fn count(&mut self, guide: &Guide) -> u32 {
        if let Some(points) = self.points {
            return self.journal.begin(points, |kept| kept == points);
        }
        let most = record_count(self.scene, self.settings);
        match self.limit {
            None => self.journal.begin(most, |kept| kept == most),
            Some(limit) => {
                let some = affordable(self.scene, self.settings, guide, limit, most);
                self.journal.begin(some, |kept| kept <= some)
            }
        }
    }

    /// The records of a body, from as many of those that share its cache as are worth a look; `None`: it is over.
    fn records(&mut self, guide: &Guide, body: &Body) -> Option<(Vec<Record>, PathStats)> {
        let probed = probed(body);
        let share = probed.len() as u32;
        let (mut all, mut stats) = (Vec::new(), PathStats::default());
        let (scene, settings) = (self.scene.middle(), self.settings);
        for boundary in probed.into_iter().filter_map(|instance| BoundaryOf::new(scene, guide, instance, Aim::Records))
        {
            let count = body.records.div_ceil(share);
            let by_walks = |pairs| boundary.records_by_walks(guide, settings, pairs);
            let by_area = |points| boundary.records_by_area(guide, settings.seed, points, count);
            let (mut found, seen) = match settings.cache_fill.as_str() {
                "camera" => self.journal.gather(count / 2, &self.is_over, by_walks)?,
                _ => self.journal.gather(count, &self.is_over, by_area)?,
            };
            // Together they stand for the boundary once.
            found.iter_mut().for_each(|record| record.area /= share as f32);
            all.append(&mut found);
            stats.add(&seen);
        }
        Some((all, stats))
    }
}

/// Those of the bodies of one cache that are looked at.
pub(super) fn probed(body: &Body) -> Vec<u32> {
    body.members.iter().copied().step_by(body.members.len().div_ceil(MOST_PROBED)).collect()
}

/// Of the `most` records those that take [`OF_LIMIT`] of a time limit, by what a few points of the largest body cost.
fn affordable(scene: &Scene, settings: &RenderSettings, guide: &Guide, limit: Duration, most: u32) -> u32 {
    let largest = |aim: Aim| {
        let (bodies, _) = share_records(scene, guide, aim, most);
        let body = bodies.iter().max_by_key(|body| body.records)?;
        Some((aim, BoundaryOf::new(scene.middle(), guide, body.members[0], aim)?))
    };
    let Some((aim, boundary)) = largest(Aim::Records).or_else(|| largest(Aim::Beams)) else { return most };
    let of_one = || {
        let begin = Instant::now();
        match aim {
            Aim::Records => drop(boundary.records_by_area(guide, settings.seed, 0..TIMED, TIMED)),
            Aim::Beams => drop(boundary.beams_by_area(settings.seed, 0..TIMED, TIMED)),
        }
        begin.elapsed().as_secs_f64() / f64::from(TIMED)
    };
    // The first find tables and pages unmade that are there from then on.
    let of_one = of_one().min(of_one());
    most.min((OF_LIMIT * limit.as_secs_f64() / of_one.max(1e-9)) as u32) // no clock is finer
}

fn record_count(scene: &Scene, settings: &RenderSettings) -> u32 {
    let window = scene.camera.data_window;
    let pixels = u64::from(window.width()) * u64::from(window.height());
    let samples = pixels * u64::from(settings.samples.min(ENOUGH_SAMPLES));
    (samples / SAMPLES_PER_RECORD).clamp(*RECORDS.start(), *RECORDS.end()) as u32
}

/// The part of an instance's surface that a medium lies behind.
pub(super) struct BoundaryOf<'a> {
    scene: Moment<'a>,
    instance: u32,
    enclosure: InstanceEnclosure<'a>,
    areas: Areas,
    pub medium: Medium,
    plan: Plan,
    /// -1 where the mesh is inside out.
    outward: f32,
}

impl<'a> BoundaryOf<'a> {
    /// `None`: no plan needs to know this boundary.
    pub(super) fn new(scene: Moment<'a>, guide: &Guide, instance: u32, aim: Aim) -> Option<Self> {
        let (of, linear) = (&scene.instances[instance as usize], scene.placed(instance).linear);
        let wanted = |triangle: u32| aim.has(guide, of, triangle);
        let all = 0..of.geometry.triangles.len() as u32;
        let first = all.clone().find(|&triangle| wanted(triangle))?;
        let (plan, medium) = guide.plan(of.surfaces + of.geometry.slot(first) as u32)?;
        let areas = Areas::new(all.end, wanted, |triangle| area(of, &linear, scene.time, triangle))?;
        // Six times the signed volume, in object space: inside out if negative.
        let volume: f32 = (0..of.geometry.triangles.len() as u32)
            .map(|t| of.geometry.corners(t, scene.time))
            .map(|[a, b, c]| a.dot(b.cross(c)))
            .sum();
        Some(Self {
            scene,
            instance,
            enclosure: InstanceEnclosure::new(scene, instance),
            medium: medium.medium,
            plan: plan.clone(),
            areas,
            outward: if volume < 0.0 { -1.0 } else { 1.0 },
        })
    }

    /// Records at `points` of `count` that are uniform over the surface.
    fn records_by_area(&self, guide: &Guide, seed: u32, points: Range<u32>, count: u32) -> (Vec<Record>, PathStats) {
        let share = (self.areas.sum() / f64::from(count)) as f32;
        let record = |i: u32| {
            let mut sampler = Sampler::new(seed ^ SEED, self.instance, i);
            let mut stats = PathStats::default();
            let hit = self.point(i, count, &mut sampler);
            (self.probe(guide, &hit, share, &mut sampler, &mut stats), stats)
        };
        collect(points.into_par_iter().map(record))
    }

    /// Light that enters at `points` of `count` that are uniform over the surface.
    pub(super) fn beams_by_area(&self, seed: u32, points: Range<u32>, count: u32) -> (Vec<Beam>, PathStats) {
        let area = (self.areas.sum() / f64::from(count)) as f32;
        let beams = |i: u32| {
            let mut sampler = Sampler::new(seed ^ SEED, self.instance, i);
            let mut stats = PathStats::default();
            let hit = self.point(i, count, &mut sampler);
            let outward = self.outward(&hit);
            let (enclosure, medium) = (&self.enclosure, &self.medium);
            let found = beams_at(self.scene, enclosure, medium, &hit, outward, area, &mut sampler, &mut stats);
            (found, stats)
        };
        let (found, seen): (Vec<Vec<Beam>>, Vec<PathStats>) = points.into_par_iter().map(beams).unzip();
        let mut stats = PathStats::default();
        seen.iter().for_each(|s| stats.add(s));
        (found.into_iter().flatten().collect(), stats)
    }

    /// Point `i` of `count`, stratified by area.
    fn point(&self, i: u32, count: u32, sampler: &mut Sampler) -> BoundaryHit {
        let u = (f64::from(i) + f64::from(sampler.random())) / f64::from(count);
        let (of, linear) = (&self.scene.instances[self.instance as usize], self.scene.placed(self.instance).linear);
        let triangle = self.areas.sample(u, |triangle| area(of, &linear, self.scene.time, triangle));
        uniform_point(self.instance, triangle, Vec2::new(sampler.random(), sampler.random()))
    }

    /// Unit normal out of the body, render space.
    fn outward(&self, hit: &BoundaryHit) -> Vec3 {
        let of = &self.scene.instances[self.instance as usize];
        let [a, b, c] = of.geometry.corners(hit.triangle, self.scene.time);
        self.outward * self.scene.placed(self.instance).normal((b - a).cross(c - a)).normalize_or(Vec3::Z)
    }

    fn probe(
        &self,
        guide: &Guide,
        hit: &BoundaryHit,
        area: f32,
        sampler: &mut Sampler,
        stats: &mut PathStats,
    ) -> Record {
        probe(self.scene, guide, &self.enclosure, hit, self.outward(hit), area, sampler, stats)
    }

    /// `pairs` of records, where camera rays enter and where classical walks from there come out.
    fn records_by_walks(
        &self,
        guide: &Guide,
        settings: &RenderSettings,
        pairs: Range<u32>,
    ) -> (Vec<Record>, PathStats) {
        let window = self.scene.camera.data_window;
        let pair = |i: u32| {
            let mut sampler = Sampler::new(settings.seed ^ SEED, self.instance, i);
            let mut stats = PathStats::default();
            let at = Vec2::new(sampler.random(), sampler.random());
            let size = Vec2::new(window.width() as f32, window.height() as f32);
            let raster = Vec2::new(window.x0 as f32, window.y0 as f32) + at * size;
            let ray = self.scene.camera.ray(raster, Vec2::splat(0.5), self.scene.time);
            let hit = self.scene.closest(ray.o, ray.d, ray.t_max, None)?;
            let of = &self.scene.instances[self.instance as usize];
            let ours = hit.instance == self.instance
                && guide.plan(of.surfaces + of.geometry.slot(hit.triangle) as u32).is_some();
            if !ours {
                return None;
            }
            let entry = BoundaryHit::of(&hit);
            let mut records = vec![self.probe(guide, &entry, 1.0, &mut sampler, &mut stats)];
            let normal = records[0].n;
            let u = Vec2::new(sampler.random(), sampler.random());
            let d = -Frame::from_normal(normal).to_world(cosine_hemisphere(u));
            let start = Start { p: self.enclosure.point(&entry), d, normal, hit: entry, weight: Rgb::ONE };
            let mut walks = WalkStats::default();
            let end = walk(
                &self.enclosure,
                &self.medium,
                Along::None,
                start,
                false,
                &mut sampler,
                &mut walks,
                |_, _| None,
                |_, _| (),
            );
            stats.walk.add(&walks);
            if let WalkEnd::Boundary { hit, .. } = end {
                records.push(self.probe(guide, &hit, 1.0, &mut sampler, &mut stats));
            }
            Some((records, stats))
        };
        let found: Vec<(Vec<Record>, PathStats)> = pairs.into_par_iter().filter_map(pair).collect();
        let mut stats = PathStats::default();
        found.iter().for_each(|(_, seen)| stats.add(seen));
        (found.into_iter().flat_map(|(records, _)| records).collect(), stats)
    }

    fn field_settings(&self, settings: &RenderSettings, guide: &Guide, records: usize) -> FieldSettings {
        let by_walks = settings.cache_fill == "camera";
        FieldSettings {
            walk: self.plan.walk,
            exact: self.plan.exact,
            cell: self.cell(settings, records),
            least_lit: if by_walks { LEAST_LIT_BY_WALKS } else { LEAST_LIT },
            uniform_area: by_walks,
            normals: settings.normals as usize,
            classical: guide.start_fraction(self.plan.walk == Walk::Mixture),
            guided_first: guide.guided_first,
            guide_exits: settings.guide_exits && self.plan.walk == Walk::Mixture,
        }
    }

    /// Edge of a cell: about the longest diffusion length, over which light mixes, and no fewer pixels or records
    /// than it takes to learn from.
    fn cell(&self, settings: &RenderSettings, records: usize) -> f32 {
        let of = &self.scene.instances[self.instance as usize];
        let longest = 2.0 * of.half_size().max_element();
        if settings.cache_resolution > 0 {
            return longest / settings.cache_resolution as f32;
        }
        let lengths =
            [0, 1, 2].map(|c| diffusion_length(self.medium.albedo[c], self.medium.g) / self.medium.sigma_t[c]);
        let mixing = lengths.into_iter().filter(|l| l.is_finite()).fold(0.0, f32::max);
        let by_records = (RECORDS_PER_CELL * self.areas.sum() as f32 / records.max(1) as f32).sqrt();
        let cell = mixing.max(by_records).max(PIXELS * self.pixel_size());
        cell.clamp(CELL_RANGE[0] * longest, CELL_RANGE[1] * longest)
    }

    /// Side of a pixel at the near side of the object.
    fn pixel_size(&self) -> f32 {
        let of = &self.scene.instances[self.instance as usize];
        let distance = (of.to_render.translation.length() - of.half_size().length()).max(of.half_size().min_element());
        let camera = &self.scene.camera;
        let middle = Vec2::new(camera.size[0] as f32, camera.size[1] as f32) * 0.5;
        let [a, b] = [middle, middle + Vec2::X].map(|raster| camera.ray(raster, Vec2::splat(0.5), self.scene.time));
        (b.o + b.d * distance - a.o - a.d * distance).length()
    }
}

/// Of a triangle under the `linear` part of a placement.
fn area(of: &Instance, linear: &Mat3, time: f32, triangle: u32) -> f64 {
    let [a, b, c] = of.geometry.corners(triangle, time).map(|p| *linear * p);
    f64::from(0.5 * (b - a).cross(c - a).length())
}

/// Uniform over a triangle (Heitz 2019 is not needed: no stratification to keep).
fn uniform_point(instance: u32, triangle: u32, u: Vec2) -> BoundaryHit {
    let s = u.x.sqrt();
    BoundaryHit { instance, triangle, u: 1.0 - s, v: u.y * s }
}

fn collect(found: impl IndexedParallelIterator<Item = (Record, PathStats)>) -> (Vec<Record>, PathStats) {
    let (records, seen): (Vec<Record>, Vec<PathStats>) = found.unzip();
    let mut stats = PathStats::default();
    seen.iter().for_each(|s| stats.add(s));
    (records, stats)
}
