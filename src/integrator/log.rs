//! What the walks of a path have to teach: filled while the path runs, read when it is over.

use super::entry::Entry;
use super::{Bucket, Path, add_to};
use crate::film::FirstWalk;
use crate::guiding::control::Controls;
use crate::guiding::onward::Taken;
use crate::guiding::statistics::{RegionId, Statistics};
use crate::math::Rgb;
use crate::subsurface::technique::PerTechnique;
use glam::Vec3;

/// Most walks, and most exits, of a path that are logged: later ones (many internal reflections) add little.
const MOST: usize = 8;

/// A walk of the exact mixture that a region started.
struct Logged {
    region: RegionId,
    ratios: PerTechnique,
    /// Path throughput at its start.
    throughput: Rgb,
    /// What the path had brought before it.
    before: Rgb,
    bucket: Bucket,
    /// The first walk behind a camera ray: control variates are for these, and what they need is learned from them.
    first: bool,
    /// Its correction is the entry's.
    shared: bool,
    /// Subtracted from the estimate per unit of throughput.
    correction: Rgb,
    /// Cost of what was done before it.
    spent: u64,
    ways: u32,
    /// Variance between them, and their cost.
    spread: (f64, u64),
}

/// A direction out of a boundary that was drawn with solid-angle pdf `pdf`.
struct Exited {
    cell: RegionId,
    direction: Vec3,
    pdf: f32,
    /// Path throughput before it was drawn.
    throughput: Rgb,
    /// What the path had brought before it.
    before: Rgb,
}

/// Statistics of a tile's walks, and the walks of the path under way.
#[derive(Default)]
pub struct WalkLog {
    pub statistics: Statistics,
    /// Of the path under way or just over, where AOVs show it; to be taken.
    pub first: Option<FirstWalk>,
    /// Whether what paths bring from inside a medium is set apart.
    pub shares: bool,
    /// That of the path under way or just over; to be taken.
    pub entry: Option<Entry>,
    /// What it brought from inside, then what AOVs of lights and layers by lobe show of that: from the entry to the first vertex that
    /// is noted, from there to the next, and so on. (While it is under way: what it had brought, there.)
    pub rows: Vec<Rgb>,
    walks: Vec<Logged>,
    exits: Vec<Exited>,
}

impl WalkLog {
    /// Whether no walk of the path under way is noted.
    pub(super) fn is_empty(&self) -> bool {
        self.walks.is_empty()
    }
}

impl Path<'_> {
    /// Notes a walk that started with `throughput` when the path had brought `before`; its place, if it is noted.
    pub(super) fn log_walk(
        &mut self,
        region: Option<RegionId>,
        controls: Option<&Controls>,
        ratios: PerTechnique,
        throughput: Rgb,
        before: Rgb,
        spent: u64,
        first: bool,
    ) -> Option<usize> {
        let bucket = self.bucket_of_media();
        let ways = self.begun.filter(|_| first).map_or(1, |begun| begun.onward.ways);
        let (Some(region), Some(log)) = (region, &mut self.log) else { return None };
        let place = log.walks.len();
        if place < MOST {
            let entry = log.entry.as_ref().filter(|_| first);
            let correction = controls.filter(|_| first).map_or(Rgb::ZERO, |controls| {
                // What leads to the last vertex that is shared is others' too: controls are for the rest.
                let before = entry.map_or(Rgb::ZERO, |entry| controls.correction(&entry.ratios));
                controls.correction(&ratios) - before
            });
            let spread = (0.0, 0);
            log.walks.push(Logged {
                region,
                ratios,
                throughput,
                before,
                bucket,
                first,
                shared: entry.is_some(),
                correction,
                spent,
                ways,
                spread,
            });
        }
        (place < MOST).then_some(place)
    }

    /// Notes how the path went on where its first walk, noted at `place`, came out.
    pub(super) fn log_ways(&mut self, place: Option<usize>, variance: f64, cost: u64) {
        if let (Some(place), Some(log)) = (place, &mut self.log) {
            log.walks[place].spread = (variance, cost);
        }
    }

    /// Notes a direction out of the boundary at `cell`, before the throughput takes in its weight.
    pub(super) fn log_exit(&mut self, cell: Option<RegionId>, direction: Vec3, pdf: f32) {
        let (throughput, before) = (self.throughput, self.sample.color());
        let (Some(cell), Some(log)) = (cell, &mut self.log) else { return };
        if log.exits.len() < MOST && throughput.max_element() > 0.0 {
            log.exits.push(Exited { cell, direction, pdf, throughput, before });
        }
    }

    /// Walks and exits that are noted so far.
    pub(super) fn logged(&self) -> [usize; 2] {
        self.log.as_ref().map_or([0, 0], |log| [log.walks.len(), log.exits.len()])
    }

    /// Once the path is over: what each walk brought goes to the statistics, control variates to the image.
    pub(super) fn finish_walks(&mut self) {
        self.finish_walks_since([0, 0]);
    }

    /// The same of those that were noted since `logged`.
    pub(super) fn finish_walks_since(&mut self, logged: [usize; 2]) {
        let (after, spent) = (self.sample.color(), self.cost());
        let Some(log) = &mut self.log else { return };
        for exited in log.exits.drain(logged[1]..).filter(|_| after.is_finite()) {
            let brought = (after - exited.before) / exited.throughput.max_element();
            let sums = log.statistics.exits.entry(exited.cell).or_default();
            sums.add(exited.direction, exited.pdf, brought);
        }
        for walk in log.walks.drain(logged[0]..) {
            match log.entry.as_mut().filter(|_| walk.shared) {
                Some(entry) => entry.correction = walk.correction,
                None => {
                    add_to(&mut self.sample, walk.bucket, -walk.throughput * walk.correction);
                    self.scene.lights.share_out(self.groups, -walk.throughput * walk.correction);
                }
            }
            if !after.is_finite() {
                continue;
            }
            // A channel that the path did not carry says nothing.
            let carried = walk.throughput.cmpgt(Rgb::ZERO);
            let estimate = Rgb::select(carried, (after - walk.before) / walk.throughput, Rgb::ZERO);
            let weight = walk.throughput / walk.throughput.max_element();
            let sums = log.statistics.walks.entry(walk.region).or_default();
            let residual = weight * (estimate - walk.correction);
            sums.add(&walk.ratios, weight * estimate, residual);
            let (way_variance, ways_cost) = walk.spread;
            let taken = Taken { cost: spent - walk.spent, ways: walk.ways, way_variance, ways_cost };
            sums.effort.add(estimate, residual, &taken);
            if walk.first && self.guide.controls {
                sums.controls.get_or_insert_default().add(&walk.ratios, estimate);
            }
        }
    }
}
