//! Rendering: passes over the tiles of the film until samples, time or a stop say it is over.

mod adaptive;
mod areas;
mod beams;
mod bodies;
mod checkpoint;
mod journal;
mod pass;
mod tile;
mod training;

pub use adaptive::Adaptive;
pub use checkpoint::Keep;

use crate::error::Result;
use crate::film::Film;
use crate::flat::RenderSettings;
use crate::guiding::Guide;
use crate::guiding::look::TechniqueShares;
use crate::integrator::PathStats;
use crate::scene::Scene;
use checkpoint::Keeper;
use journal::Journal;
use pass::{Passes, Phase, Schedule};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use training::Training;

/// A render under way: shared between the thread that renders and those that watch.
pub struct Progress {
    stop: AtomicBool,
    /// Fraction done, bits of an f64.
    fraction: AtomicU64,
    stats: Mutex<PathStats>,
    guide: Mutex<GuideStats>,
    report: Mutex<Report>,
}

/// What a render has to say beside its counts.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// How pilot samples shared out the others.
    pub adaptive: Option<Adaptive>,
    /// Samples per pixel, on average, that came from a checkpoint.
    pub resumed: Option<f64>,
    /// Seconds since the start at which a checkpoint was written last.
    pub checkpoints: Vec<f64>,
    /// Checkpoints that could not be written.
    pub warnings: Vec<String>,
}

impl Default for Progress {
    fn default() -> Self {
        Self {
            stop: AtomicBool::new(false),
            fraction: AtomicU64::new(0),
            stats: Mutex::default(),
            guide: Mutex::default(),
            report: Mutex::default(),
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic elsewhere leaves sums that are still sums.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What was learned, for the statistics.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct GuideStats {
    /// Of filling the boundary caches and of learning between passes.
    pub seconds: f64,
    /// Boundary points with an irradiance estimate.
    pub records: u64,
    /// Of them and of beams of light, those that came from a checkpoint.
    pub resumed_finds: u64,
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
        *locked(&self.stats)
    }

    pub fn guide(&self) -> GuideStats {
        locked(&self.guide).clone()
    }

    pub fn report(&self) -> Report {
        locked(&self.report).clone()
    }

    fn set_guide(&self, stats: GuideStats) {
        *locked(&self.guide) = stats;
    }

    fn set_fraction(&self, fraction: f64) {
        self.fraction.store(fraction.min(1.0).to_bits(), Ordering::Relaxed);
    }

    fn add(&self, stats: &PathStats) {
        locked(&self.stats).add(stats);
    }
}

/// The film that `render` fills.
pub fn film_for(scene: &Scene, settings: &RenderSettings) -> Result<Film> {
    let film = Film::new(scene.camera.data_window, &settings.aovs, false, scene.camera.exposure)?;
    let film = film.seen_by(scene.camera.view());
    if settings.pixel_filter_mode == "weighted" { film.spreading() } else { Ok(film) }
}

/// Renders samples `sample_offset..sample_offset + samples` into `film`, or as many per tile as pilot samples say where
/// there is a noise threshold. Deterministic for any number of threads of the current rayon pool, except where a time
/// limit ends it or bounds its training. With `keep` it writes checkpoints, and goes on from one if asked to: with the same image.
///
/// # Errors
/// A checkpoint to go on from that cannot be read, or a film for which there is no memory.
pub fn render(
    scene: &Scene,
    settings: &RenderSettings,
    film: &Film,
    progress: &Progress,
    keep: Option<&Keep>,
) -> Result<()> {
    let mut run = Run::new(scene, settings, progress, keep);
    if !run.train(film)? {
        return Ok(());
    }
    let pilot = (settings.noise_threshold > 0.0 && settings.samples > adaptive::PILOT_SAMPLES)
        .then(|| adaptive::pilot_film(scene))
        .transpose()?;
    let tiles = film.tiles.len();
    let mut at = (Passes::default(), Schedule::image(settings, vec![settings.samples; tiles]));
    if let Some(pilot) = &pilot {
        at = (Passes::default(), Schedule::pilot(settings, tiles));
        run.expect(2 * u64::from(adaptive::PILOT_SAMPLES) * tiles as u64);
        run.resume(|phase| if phase == Phase::Pilot { pilot } else { film }, &mut at)?;
        if at.1.phase == Phase::Pilot && run.passes(pilot, &at.1, &mut at.0) {
            let (budget, adaptive) = adaptive::share_out(pilot, settings.noise_threshold, settings.samples);
            locked(&progress.report).adaptive = Some(adaptive);
            at = (Passes::default(), Schedule::image(settings, budget));
        }
    } else {
        run.resume(|_| film, &mut at)?;
    }
    if at.1.phase == Phase::Image {
        run.expect(at.1.samples() + pilot.map_or(0, |_| u64::from(adaptive::PILOT_SAMPLES) * tiles as u64));
        run.passes(film, &at.1, &mut at.0);
    }
    progress.set_fraction(1.0);
    Ok(())
}

/// One render: what it reads, and the guide that it teaches.
struct Run<'a> {
    scene: &'a Scene,
    settings: &'a RenderSettings,
    progress: &'a Progress,
    keeper: Option<Keeper<'a>>,
    guide: Guide,
    learned: GuideStats,
    /// Records that training asked for.
    points: u32,
    start: Instant,
    limit: Option<Duration>,
    /// Samples of one pixel, summed over tiles: done, and to be done.
    finished: AtomicU64,
    expected: u64,
}

impl<'a> Run<'a> {
    fn new(scene: &'a Scene, settings: &'a RenderSettings, progress: &'a Progress, keep: Option<&'a Keep>) -> Self {
        Self {
            scene,
            settings,
            progress,
            keeper: keep.map(Keeper::new),
            guide: Guide::new(scene, settings),
            learned: GuideStats::default(),
            points: 0,
            start: Instant::now(),
            limit: (settings.time_limit > 0.0).then(|| Duration::from_secs_f32(settings.time_limit)),
            finished: AtomicU64::new(0),
            expected: 1,
        }
    }

    /// Whether passes follow: a checkpoint holds what was learned in all of the fields, so that training which is to be
    /// gone on with leaves none.
    fn train(&mut self, film: &Film) -> Result<bool> {
        let (progress, start, limit) = (self.progress, self.start, self.limit);
        let keep = self.keeper.as_ref().map(Keeper::keep);
        // What was rendered before is worth more than the time it takes to train again.
        let points = keep.map_or(Ok(None), Keep::points)?;
        let is_over = || points.is_none() && is_over(progress, start, limit);
        let (scene, settings, journal) = (self.scene, self.settings, Journal::new(keep));
        let mut training = Training { scene, settings, journal, limit, points, is_over };
        let trained = training.train(&mut self.guide);
        self.progress.add(&trained.stats);
        self.learned.resumed_finds = training.journal.resumed;
        locked(&self.progress.report).warnings.extend(training.journal.fault.map(|fault| fault.to_string()));
        self.points = trained.points;
        if keep.is_some() && (training.is_over)() {
            return Ok(false);
        }
        if film.watches_walks() {
            self.guide.number_regions();
        }
        self.learned.seconds = self.start.elapsed().as_secs_f64();
        self.learned.records = trained.records;
        [self.learned.bodies, self.learned.bodies_too_small] = trained.bodies;
        self.learned.count(&self.guide);
        self.progress.set_guide(self.learned.clone());
        Ok(true)
    }

    /// Whether a stop or the time limit ends the render.
    fn is_over(&self) -> bool {
        is_over(self.progress, self.start, self.limit)
    }

    fn expect(&mut self, samples: u64) {
        self.expected = samples.max(1);
    }

    fn note(&self, samples: u64) {
        let finished = self.finished.fetch_add(samples, Ordering::Relaxed) + samples;
        let by_samples = finished as f64 / self.expected as f64;
        let by_time = self.limit.map_or(0.0, |limit| self.start.elapsed().as_secs_f64() / limit.as_secs_f64());
        self.progress.set_fraction(by_samples.max(by_time));
    }

    /// Takes in what a pass has seen.
    fn learn(&mut self, seen: &crate::guiding::statistics::Statistics) {
        let begin = Instant::now();
        self.guide.learn(seen);
        self.learned.learned_passes += 1;
        self.learned.seconds += begin.elapsed().as_secs_f64();
        self.learned.count(&self.guide);
        self.progress.set_guide(self.learned.clone());
    }
}

fn is_over(progress: &Progress, start: Instant, limit: Option<Duration>) -> bool {
    progress.stopped() || limit.is_some_and(|limit| start.elapsed() >= limit)
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
