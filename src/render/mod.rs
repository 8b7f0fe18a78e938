//! Rendering: passes over the tiles of the film until samples, time or noise say stop.

mod bodies;
mod training;

use crate::error::Result;
use crate::film::{Film, Tile};
use crate::flat::RenderSettings;
use crate::guiding::Guide;
use crate::guiding::look::TechniqueShares;
use crate::guiding::statistics::Statistics;
use crate::integrator::{PathSettings, PathStats, WalkLog, trace};
use crate::sampling::sampler::Sampler;
use crate::scene::Scene;
use glam::Vec2;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Samples of the longest pass: short enough that a time limit is met, long enough that nobody waits.
const LONGEST_PASS: u32 = 16;

/// Samples below which the noise estimate is not trusted.
const MIN_NOISE_SAMPLES: u32 = 16;

/// A render under way: shared between the thread that renders and those that watch.
pub struct Progress {
    stop: AtomicBool,
    /// Fraction done, bits of an f64.
    fraction: AtomicU64,
    stats: Mutex<PathStats>,
    guide: Mutex<GuideStats>,
}

impl Default for Progress {
    fn default() -> Self {
        Self {
            stop: AtomicBool::new(false),
            fraction: AtomicU64::new(0),
            stats: Mutex::default(),
            guide: Mutex::default(),
        }
    }
}

/// What was learned, for the statistics.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct GuideStats {
    /// Of filling the boundary caches and of learning between passes.
    pub seconds: f64,
    /// Boundary points with an irradiance estimate.
    pub records: u64,
    /// Instances with a cache, and those too small on the picture for one.
    pub bodies: usize,
    pub bodies_too_small: usize,
    pub regions: usize,
    pub lit_regions: usize,
    pub bytes: usize,
    /// Passes after which shares or control variates moved.
    pub learned_passes: u32,
    /// Regions where walks with exact weights started.
    pub walked_regions: usize,
    /// Of them, those with control variates.
    pub control_regions: usize,
    /// Means over `walked_regions`.
    pub technique_shares: TechniqueShares,
}

impl Progress {
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    pub fn fraction(&self) -> f64 {
        f64::from_bits(self.fraction.load(Ordering::Relaxed))
    }

    pub fn stats(&self) -> PathStats {
        *self.stats.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    pub fn guide(&self) -> GuideStats {
        self.guide.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone()
    }

    fn set_guide(&self, stats: GuideStats) {
        *self.guide.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = stats;
    }

    fn add(&self, stats: &PathStats) {
        self.stats.lock().unwrap_or_else(std::sync::PoisonError::into_inner).add(stats);
    }
}

/// The film that `render` fills.
pub fn film_for(scene: &Scene, settings: &RenderSettings) -> Result<Film> {
    let noise = settings.noise_threshold > 0.0;
    Film::new(scene.camera.data_window, &settings.aovs, noise, scene.camera.exposure)
}

/// Renders samples `sample_offset..sample_offset + samples` into `film`. Deterministic for any number of
/// threads of the current rayon pool, except where a time limit ends it.
pub fn render(scene: &Scene, settings: &RenderSettings, film: &Film, progress: &Progress) {
    let start = Instant::now();
    let limit = (settings.time_limit > 0.0).then(|| Duration::from_secs_f32(settings.time_limit));
    let out_of_time = || limit.is_some_and(|limit| start.elapsed() >= limit);
    let mut guide = Guide::new(scene, settings);
    let trained = training::train(scene, settings, &mut guide);
    progress.add(&trained.stats);
    if film.watches_walks() {
        guide.number_regions();
    }
    let [bodies, bodies_too_small] = trained.bodies;
    let (seconds, records) = (start.elapsed().as_secs_f64(), trained.records);
    let mut learned = GuideStats { seconds, records, bodies, bodies_too_small, ..GuideStats::default() };
    learned.count(&guide);
    progress.set_guide(learned.clone());
    let (mut done, mut pass) = (0, 1);
    while done < settings.samples && !progress.stopped() {
        let count = pass.min(settings.samples - done);
        let begin = settings.sample_offset + done;
        let finished = AtomicU64::new(0);
        let seen = each_tile(film, |tile| {
            if progress.stopped() || out_of_time() {
                return Statistics::default();
            }
            let (stats, seen) = render_tile(scene, &guide, settings, tile, begin, count);
            progress.add(&stats);
            let tiles = finished.fetch_add(1, Ordering::Relaxed) + 1;
            let samples = f64::from(done) + f64::from(count) * tiles as f64 / film.tiles.len() as f64;
            let by_samples = samples / f64::from(settings.samples);
            let by_time = limit.map_or(0.0, |limit| start.elapsed().as_secs_f64() / limit.as_secs_f64());
            progress.fraction.store(by_samples.max(by_time).min(1.0).to_bits(), Ordering::Relaxed);
            seen
        });
        done += count;
        pass = (pass * 2).min(LONGEST_PASS);
        let quiet = settings.noise_threshold > 0.0
            && done >= MIN_NOISE_SAMPLES
            && film.relative_error() < f64::from(settings.noise_threshold);
        if quiet || out_of_time() {
            break;
        }
        if guide.learns() && done < settings.samples {
            let begin = Instant::now();
            guide.learn(&seen);
            learned.learned_passes += 1;
            learned.seconds += begin.elapsed().as_secs_f64();
            learned.count(&guide);
            progress.set_guide(learned.clone());
        }
    }
    progress.fraction.store(1.0_f64.to_bits(), Ordering::Relaxed);
}

impl GuideStats {
    fn count(&mut self, guide: &Guide) {
        [self.regions, self.lit_regions] = guide.counts();
        self.bytes = guide.memory();
        let learned = guide.learned();
        (self.walked_regions, self.control_regions) = (learned.regions, learned.controlled);
        self.technique_shares = learned.shares;
    }
}

/// Statistics of tiles, merged in the order of the tiles whatever order they are done in.
#[derive(Default)]
struct Merger {
    merged: Statistics,
    next: usize,
    waiting: BTreeMap<usize, Statistics>,
}

impl Merger {
    fn add(&mut self, tile: usize, seen: Statistics) {
        self.waiting.insert(tile, seen);
        while let Some(seen) = self.waiting.remove(&self.next) {
            self.merged.merge(seen);
            self.next += 1;
        }
    }
}

/// Does `work` on every tile, one queue for all threads so that few results wait for their turn.
fn each_tile(film: &Film, work: impl Fn(&mut Tile) -> Statistics + Sync) -> Statistics {
    let (next, merger) = (AtomicUsize::new(0), Mutex::new(Merger::default()));
    rayon::broadcast(|_| {
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(tile) = film.tiles.get(i) else { return };
            let seen = work(&mut tile.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
            merger.lock().unwrap_or_else(std::sync::PoisonError::into_inner).add(i, seen);
        }
    });
    merger.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).merged
}

fn render_tile(
    scene: &Scene,
    guide: &Guide,
    settings: &RenderSettings,
    tile: &mut Tile,
    begin: u32,
    count: u32,
) -> (PathStats, Statistics) {
    let mut stats = PathStats::default();
    let mut log = WalkLog::default();
    let path =
        PathSettings { max_depth: settings.max_depth, lights_visible_to_camera: settings.lights_visible_to_camera };
    let lens = scene.camera.has_depth_of_field();
    for i in 0..(tile.width * tile.height) as usize {
        let (x, y) = (tile.x0 + i as u32 % tile.width, tile.y0 + i as u32 / tile.width);
        // The pixel's number in the whole image: a crop renders the pixels of the whole.
        let pixel = y * scene.camera.size[0] + x;
        for sample in begin..begin + count {
            let mut sampler = Sampler::new(settings.seed, pixel, sample);
            let u_filter = sampler.next_2d();
            let u_lens = if lens { sampler.next_2d() } else { sampler.skip_2d() };
            let raster = Vec2::new(x as f32 + 0.5 + tent(u_filter.x), y as f32 + 0.5 + tent(u_filter.y));
            let ray = scene.camera.ray(raster, u_lens);
            let sample = trace(scene, guide, path, ray, &mut sampler, &mut stats, &mut log);
            tile.add(i, &sample);
            if let Some(walk) = log.first.take() {
                tile.add_walk(i, sample.first.depth, &walk);
            }
        }
    }
    (stats, log.statistics)
}

/// Pixel filter by importance sampling: a tent of radius 1 pixel, so that samples stay in their pixel's sum.
fn tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}
