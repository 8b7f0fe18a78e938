//! Passes over the tiles of a film: each renders some samples of every pixel, and what its walks teach is merged in the
//! order of the tiles.

use super::{Run, locked};
use crate::film::{Film, Tile};
use crate::flat::{PRIMVAR_AOV, RenderSettings};
use crate::guiding::Guide;
use crate::guiding::statistics::Statistics;
use crate::film::Sample;
use crate::integrator::{PathSettings, PathStats, Shared, WalkLog, trace};
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::Scene;
use glam::Vec2;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError, RwLock};

/// Samples of the longest pass: short enough that a time limit is met, long enough that nobody waits.
const LONGEST_PASS: u32 = 16;

/// What a film is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    Image,
    /// Its samples only decide how many the image gets.
    Pilot,
}

/// Which samples a film gets.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    pub phase: Phase,
    seed: u32,
    offset: u32,
    /// Samples per pixel, by tile.
    pub budget: Vec<u32>,
}

/// Random numbers of the pilot, apart from those of the image.
const PILOT_SEED: u32 = 0x7069_6c6f;

impl Schedule {
    pub fn image(settings: &RenderSettings, budget: Vec<u32>) -> Self {
        Self { phase: Phase::Image, seed: settings.seed, offset: settings.sample_offset, budget }
    }

    pub fn pilot(settings: &RenderSettings, tiles: usize) -> Self {
        let budget = vec![super::adaptive::PILOT_SAMPLES; tiles];
        Self { phase: Phase::Pilot, seed: settings.seed ^ PILOT_SEED, offset: settings.sample_offset, budget }
    }

    /// Of one pixel per tile.
    pub fn samples(&self) -> u64 {
        self.budget.iter().map(|&n| u64::from(n)).sum()
    }
}

/// How far a film is.
#[derive(Default)]
pub struct Passes {
    /// Samples of the passes that are over.
    pub done: u32,
    /// Tiles of the pass under way.
    pub merger: Mutex<Merger>,
}

/// Statistics of tiles, merged in the order of the tiles whatever order they are done in.
#[derive(Default)]
pub struct Merger {
    pub merged: Statistics,
    /// All tiles below it are in `merged`.
    pub next: usize,
    pub waiting: BTreeMap<usize, Statistics>,
}

impl Merger {
    fn add(&mut self, tile: usize, seen: Statistics) {
        self.waiting.insert(tile, seen);
        while let Some(seen) = self.waiting.remove(&self.next) {
            self.merged.merge(seen);
            self.next += 1;
        }
    }

    fn has(&self, tile: usize) -> bool {
        tile < self.next || self.waiting.contains_key(&tile)
    }
}

impl Run<'_> {
    /// Renders passes of 1, 2, 4, 8, 16, 16, ... samples until every tile has its budget; false: it was ended before.
    pub(super) fn passes(&mut self, film: &Film, schedule: &Schedule, at: &mut Passes) -> bool {
        let most = schedule.budget.iter().copied().max().unwrap_or(0);
        while at.done < most {
            let count = (at.done + 1).min(LONGEST_PASS).min(most - at.done);
            self.pass(film, schedule, at, count);
            if locked(&at.merger).next < film.tiles.len() {
                self.keep_if_stopped(film, schedule, at);
                return false;
            }
            let seen = std::mem::take(&mut *locked(&at.merger)).merged;
            at.done += count;
            if self.guide.learns() && (at.done < most || schedule.phase == Phase::Pilot) {
                self.learn(&seen);
            }
            if self.is_over() && at.done < most {
                self.keep_if_stopped(film, schedule, at);
                return false;
            }
        }
        true
    }

    /// Renders up to `count` samples of the tiles that the pass has not got yet; one queue for all threads, so that few
    /// results wait for their turn.
    fn pass(&self, film: &Film, schedule: &Schedule, at: &Passes, count: u32) {
        let next = AtomicUsize::new(0);
        // Open while tiles are rendered, closed while a checkpoint is written: it holds whole tiles only.
        let gate = RwLock::new(());
        rayon::broadcast(|_| {
            loop {
                {
                    let _open = gate.read().unwrap_or_else(PoisonError::into_inner);
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    if i >= film.tiles.len() || self.is_over() {
                        return;
                    }
                    self.tile(film, schedule, at, i, count);
                }
                if self.is_due() {
                    let _closed = gate.write().unwrap_or_else(PoisonError::into_inner);
                    if self.is_due() {
                        self.keep(film, schedule, at);
                    }
                }
            }
        });
    }

    fn tile(&self, film: &Film, schedule: &Schedule, at: &Passes, i: usize, count: u32) {
        if locked(&at.merger).has(i) {
            return;
        }
        let count = count.min(schedule.budget[i].saturating_sub(at.done));
        let begin = schedule.offset + at.done;
        let mut tile = locked(&film.tiles[i]);
        let samples = begin..begin + count;
        let (stats, seen) = render_tile(self.scene, &self.guide, self.settings, schedule.seed, &mut tile, samples);
        self.progress.add(&stats);
        locked(&at.merger).add(i, seen);
        self.note(u64::from(count));
    }
}

fn render_tile(
    scene: &Scene,
    guide: &Guide,
    settings: &RenderSettings,
    seed: u32,
    tile: &mut Tile,
    samples: Range<u32>,
) -> (PathStats, Statistics) {
    let mut stats = PathStats::default();
    let mut log = WalkLog::default();
    let path =
        PathSettings { max_depth: settings.max_depth, lights_visible_to_camera: settings.lights_visible_to_camera };
    let lens = scene.camera.has_depth_of_field();
    // A pilot has none.
    let shown = settings.aovs.iter().filter(|_| tile.shows_primvars());
    let primvars: Vec<&str> = shown.filter_map(|aov| aov.strip_prefix(PRIMVAR_AOV)).collect();
    let n = (tile.width * tile.height) as usize;
    let (light_aovs, lobe_aovs) = (tile.light_aovs(), tile.lobe_aovs());
    log.shares = settings.reuse > 0 && scene.frozen.is_some();
    log.most = settings.reuse;
    let mut shared = Shared::default();
    let mut of_sample: Vec<Sample> = Vec::with_capacity(n);
    let mut lights = vec![Rgb::ZERO; n * light_aovs];
    let mut lobes = vec![Rgb::ZERO; n * lobe_aovs];
    for s in samples {
        of_sample.clear();
        shared.clear(light_aovs + lobe_aovs);
        for i in 0..n {
            let (x, y) = (tile.x0 + (i as u32 % tile.width) as i32, tile.y0 + (i as u32 / tile.width) as i32);
            // A crop renders the pixels of the whole.
            let pixel = scene.camera.pixel_number(x, y);
            let mut sampler = Sampler::new(seed, pixel, s);
            let u_filter = sampler.next_2d();
            let u_lens = if lens { sampler.next_2d() } else { sampler.skip_2d() };
            let raster = Vec2::new(x as f32 + 0.5 + tent(u_filter.x), y as f32 + 0.5 + tent(u_filter.y));
            let time = scene.frozen.unwrap_or_else(|| sampler.time());
            let ray = scene.camera.ray(raster, u_lens, time);
            let lights = &mut lights[i * light_aovs..(i + 1) * light_aovs];
            let lobes = &mut lobes[i * lobe_aovs..(i + 1) * lobe_aovs];
            let mut sample = trace(scene.at(time), guide, path, ray, &mut sampler, &mut stats, &mut log, lights, lobes);
            if let Some(surface) = sample.surface.filter(|_| tile.watches_motion()) {
                sample.motion = scene.motion_vector(&surface);
            }
            of_sample.push(sample);
            if let Some(entry) = log.entry.take() {
                shared.push(i, [x, y], entry, &log.layers);
            }
            if let Some(surface) = sample.surface.filter(|_| !primvars.is_empty()) {
                tile.add_primvars(i, primvars.iter().map(|name| scene.primvar_at(&surface, name)));
            }
            if let Some(walk) = log.first.take() {
                tile.add_walk(i, sample.first.depth, &walk);
            }
        }
        if log.shares {
            let mut place = Sampler::new(seed ^ 0x51ab_3c77, 0, s);
            let shift = glam::Vec3::new(place.random(), place.random(), place.random());
            shared.hand_out(scene.at(scene.frozen.unwrap()), shift, &mut stats, |i, shown, unlit, aovs| {
                of_sample[i].subsurface += shown;
                let (groups, of_lobes) = aovs.split_at(light_aovs);
                let mine = &mut lights[i * light_aovs..(i + 1) * light_aovs];
                mine.iter_mut().zip(groups).for_each(|(sum, light)| *sum += *light);
                scene.lights.share_out(mine, unlit);
                let mine = &mut lobes[i * lobe_aovs..(i + 1) * lobe_aovs];
                mine.iter_mut().zip(of_lobes).for_each(|(sum, light)| *sum += *light);
            });
        }
        for (i, sample) in of_sample.iter().enumerate() {
            tile.add(i, sample);
            tile.add_lights(i, &lights[i * light_aovs..(i + 1) * light_aovs]);
            tile.add_lobes(i, &lobes[i * lobe_aovs..(i + 1) * lobe_aovs]);
        }
    }
    (stats, log.statistics)
}

/// Pixel filter by importance sampling: a tent of radius 1 pixel, so that samples stay in their pixel's sum.
fn tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}
