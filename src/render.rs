//! Rendering: passes over the tiles of the film until samples, time or noise say stop.

use crate::error::Result;
use crate::film::{Film, Tile};
use crate::flat::RenderSettings;
use crate::integrator::{PathSettings, PathStats, trace};
use crate::sampling::sampler::Sampler;
use crate::scene::Scene;
use glam::Vec2;
use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
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
}

impl Default for Progress {
    fn default() -> Self {
        Self { stop: AtomicBool::new(false), fraction: AtomicU64::new(0), stats: Mutex::default() }
    }
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
    let mut done = 0;
    let mut pass = 1;
    while done < settings.samples && !progress.stopped() {
        let count = pass.min(settings.samples - done);
        let begin = settings.sample_offset + done;
        let tiles_done = AtomicU64::new(0);
        film.tiles.par_iter().for_each(|tile| {
            if progress.stopped() || out_of_time() {
                return;
            }
            let mut tile = tile.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let stats = render_tile(scene, settings, &mut tile, begin, count);
            progress.add(&stats);
            let tiles = tiles_done.fetch_add(1, Ordering::Relaxed) + 1;
            let samples = f64::from(done) + f64::from(count) * tiles as f64 / film.tiles.len() as f64;
            let by_samples = samples / f64::from(settings.samples);
            let by_time = limit.map_or(0.0, |limit| start.elapsed().as_secs_f64() / limit.as_secs_f64());
            progress.fraction.store(by_samples.max(by_time).min(1.0).to_bits(), Ordering::Relaxed);
        });
        done += count;
        pass = (pass * 2).min(LONGEST_PASS);
        let quiet = settings.noise_threshold > 0.0
            && done >= MIN_NOISE_SAMPLES
            && film.relative_error() < f64::from(settings.noise_threshold);
        if quiet || out_of_time() {
            break;
        }
    }
    progress.fraction.store(1.0_f64.to_bits(), Ordering::Relaxed);
}

fn render_tile(scene: &Scene, settings: &RenderSettings, tile: &mut Tile, begin: u32, count: u32) -> PathStats {
    let mut stats = PathStats::default();
    let path =
        PathSettings { max_depth: settings.max_depth, lights_visible_to_camera: settings.lights_visible_to_camera };
    for i in 0..(tile.width * tile.height) as usize {
        let (x, y) = (tile.x0 + i as u32 % tile.width, tile.y0 + i as u32 / tile.width);
        // The pixel's number in the whole image: a crop renders the pixels of the whole.
        let pixel = y * scene.camera.size[0] + x;
        for sample in begin..begin + count {
            let mut sampler = Sampler::new(settings.seed, pixel, sample);
            let (u_filter, u_lens) = (sampler.next_2d(), sampler.next_2d());
            let raster = Vec2::new(x as f32 + 0.5 + tent(u_filter.x), y as f32 + 0.5 + tent(u_filter.y));
            let ray = scene.camera.ray(raster, u_lens);
            tile.add(i, &trace(scene, path, ray, &mut sampler, &mut stats));
        }
    }
    stats
}

/// Pixel filter by importance sampling: a tent of radius 1 pixel, so that samples stay in their pixel's sum.
fn tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}
