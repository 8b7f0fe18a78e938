//! Passes over the tiles of a film: each renders some samples of every pixel, and what its walks teach is merged in the
//! order of the tiles.

use super::tile::TilePass;
use super::{Run, locked};
use crate::film::Film;
use crate::flat::RenderSettings;
use crate::guiding::statistics::Statistics;
use std::collections::BTreeMap;
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
        let (stats, seen) =
            TilePass::new(self.scene, &self.guide, self.settings, schedule.seed, &mut tile).render(samples);
        self.progress.add(&stats);
        locked(&at.merger).add(i, seen);
        self.note(u64::from(count));
    }
}
