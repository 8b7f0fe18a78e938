//! What the walks of a path have to teach: filled while the path runs, read when it is over.

use super::{Bucket, Path, add_to};
use crate::film::FirstWalk;
use crate::guiding::control::Controls;
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
    /// Subtracted from the estimate per unit of throughput.
    correction: Rgb,
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
    walks: Vec<Logged>,
    exits: Vec<Exited>,
}

impl Path<'_> {
    /// Notes a walk that started with `throughput` when the path had brought `before`.
    pub(super) fn log_walk(
        &mut self,
        region: Option<RegionId>,
        controls: Option<&Controls>,
        ratios: PerTechnique,
        throughput: Rgb,
        before: Rgb,
        first: bool,
    ) {
        let bucket = self.bucket_of_media();
        let (Some(region), Some(log)) = (region, &mut self.log) else { return };
        if log.walks.len() < MOST {
            let correction = controls.filter(|_| first).map_or(Rgb::ZERO, |controls| controls.correction(&ratios));
            log.walks.push(Logged { region, ratios, throughput, before, bucket, first, correction });
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

    /// Once the path is over: what each walk brought goes to the statistics, control variates to the image.
    pub(super) fn finish_walks(&mut self) {
        let after = self.sample.color();
        let Some(log) = &mut self.log else { return };
        for exited in log.exits.drain(..).filter(|_| after.is_finite()) {
            let brought = (after - exited.before) / exited.throughput.max_element();
            let sums = log.statistics.exits.entry(exited.cell).or_default();
            sums.add(exited.direction, exited.pdf, brought);
        }
        for walk in log.walks.drain(..) {
            add_to(&mut self.sample, walk.bucket, -walk.throughput * walk.correction);
            self.scene.lights.share_out(self.groups, -walk.throughput * walk.correction);
            if !after.is_finite() {
                continue;
            }
            // A channel that the path did not carry says nothing.
            let carried = walk.throughput.cmpgt(Rgb::ZERO);
            let estimate = Rgb::select(carried, (after - walk.before) / walk.throughput, Rgb::ZERO);
            let weight = walk.throughput / walk.throughput.max_element();
            let sums = log.statistics.walks.entry(walk.region).or_default();
            sums.add(&walk.ratios, weight * estimate, weight * (estimate - walk.correction));
            if walk.first && self.guide.controls {
                sums.controls.get_or_insert_default().add(&walk.ratios, estimate);
            }
        }
    }
}
