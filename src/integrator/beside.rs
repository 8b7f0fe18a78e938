//! What the first surface reflects, followed beside what enters a medium there: neither has to be lucky.

use super::Path;
use crate::bsdf::Bsdf;
use crate::guiding::LightsAt;
use crate::guiding::statistics::RegionId;
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, Coating, InstanceEnclosure, SurfaceHit};

/// A reflection at the first surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside {
    /// Of the walk beside it.
    region: RegionId,
    /// The walk's, largest channel.
    throughput: f32,
    /// What the path had brought when it turned to the reflection, and what that had cost.
    before: Rgb,
    spent: u64,
    /// With which it would have been drawn.
    chance: f32,
}

/// What enters at the first surface, and the probability that it would not have been drawn.
pub(super) struct Entering {
    bsdf: Bsdf,
    region: RegionId,
    chance: f32,
}

impl Path<'_> {
    /// The lobes that reflect, and what enters, where both are followed: as the walks that start here have found it worth.
    pub(super) fn parted(&self, hit: &SurfaceHit, si: &Interaction, bsdf: &Bsdf) -> Option<(Bsdf, Entering)> {
        if self.depth > 0 {
            return None;
        }
        let p = InstanceEnclosure::new(self.scene, si.instance).point(&BoundaryHit::of(hit));
        let (region, _) = self.guide.onward(si.instance, p, si.ng).filter(|(_, onward)| onward.parted == 1)?;
        let (reflecting, chance, bsdf) = bsdf.parted()?;
        Some((reflecting, Entering { bsdf, region, chance }))
    }

    /// Follows what enters at the first surface to the end of its path, and comes back.
    pub(super) fn enter_first(
        &mut self,
        hit: &SurfaceHit,
        si: &Interaction,
        coating: &Coating,
        entering: &Entering,
        lights: LightsAt,
        sampler: &mut Sampler,
    ) {
        let fork = self.fork();
        let Entering { bsdf, region, chance } = entering;
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d());
        let throughput = chosen.map_or(0.0, |chosen| (self.throughput * chosen.f / chosen.pdf).max_element());
        let mut on = self.follow(hit, si, coating, bsdf, chosen, lights, sampler);
        while on.is_some() {
            on = self.segment(sampler);
        }
        self.finish_walks();
        self.set_apart();
        self.return_to(&fork);
        let (before, spent) = (self.sample.color(), self.cost());
        self.beside = Some(Beside { region: *region, throughput, before, spent, chance: *chance });
    }

    /// Once the path is over: what its reflection brought goes to the statistics.
    pub(super) fn finish_beside(&mut self) {
        let Some(beside) = self.beside.filter(|beside| beside.throughput > 0.0) else { return };
        let (brought, cost) = (self.sample.color() - beside.before, self.cost() - beside.spent);
        let Some(log) = self.log.as_mut().filter(|_| brought.is_finite()) else { return };
        let sums = log.statistics.walks.entry(beside.region).or_default();
        sums.effort.add_reflection(brought / beside.throughput, beside.chance, cost);
    }
}
