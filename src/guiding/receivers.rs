//! The paper's choice of one slab normal per walk: a region by how much light it sends to the receiver.
//!
//! guiding.md 2.4, 2.5. A cumulative distribution over all lit cells per receiving cell, made when a walk first starts
//! there (it is a function of the cell alone, so threads agree): memory is their product, which is what the mixture
//! avoids.

use super::cache::Cell;
use super::normals::Sources;
use crate::math::mean;
use glam::{Vec2, Vec3};
use std::sync::OnceLock;

#[derive(Debug)]
pub struct Receivers {
    /// Per cell: running sums of the weights of the lit sources.
    sums: Vec<OnceLock<Box<[f32]>>>,
}

impl Receivers {
    pub fn new(cells: usize) -> Self {
        Self { sums: (0..cells).map(|_| OnceLock::new()).collect() }
    }

    /// A slab normal for a walk that enters in `cell`, whose means are `receiver`; `None` where no light is known.
    pub fn sample(
        &self,
        sources: &Sources,
        cell: u32,
        receiver: &Cell,
        u: (f32, f32),
        u_direction: Vec2,
    ) -> Option<Vec3> {
        let sums = self.sums[cell as usize].get_or_init(|| {
            let running = |sum: &mut f32, (_, _, weight)| {
                *sum += mean(weight);
                Some(*sum)
            };
            sources.weights(receiver).scan(0.0, running).collect()
        });
        let total = *sums.last().filter(|total| **total > 0.0)?;
        let (u, u_lobe) = u;
        let place = sums.partition_point(|&sum| sum <= u * total).min(sums.len() - 1);
        let chosen = sources.lit[place] as usize;
        Some(match sources.cache.incident.get(chosen) {
            Some(incident) => incident.as_ref()?.sample(u_lobe, u_direction),
            None => sources.cache.means[chosen].normal,
        })
    }

    pub fn memory(&self) -> usize {
        self.sums.iter().map(|sums| size_of::<OnceLock<Box<[f32]>>>() + 4 * sums.get().map_or(0, |s| s.len())).sum()
    }
}
