//! How light leaves a diffuse boundary: in one way or several, and which later walks are worth their time.

use super::direct::{R2, Rival};
use super::footprint::Cone;
use super::lobes::By;
use super::nest::Nest;
use super::{Bucket, Path};
use crate::bsdf::{Bsdf, Response};
use crate::guiding::LightsAt;
use crate::guiding::exit::Exit;
use crate::guiding::onward::Onward;
use crate::guiding::statistics::RegionId;
use crate::interaction::Interaction;
use crate::math::{Rgb, mean};
use crate::sampling::sampler::Sampler;
use glam::{Vec2, Vec3};

/// Generator of the one-dimensional lattice of directions at an exit.
const GOLDEN: f32 = 0.618_034;

/// Where the first walk of a path started, of those whose paths may go on in several ways.
#[derive(Debug, Clone, Copy)]
pub(super) struct Begun {
    pub onward: Onward,
    /// Largest channel.
    pub throughput: f32,
    /// Its place among the walks that are logged.
    pub logged: Option<usize>,
}

/// Where a path that goes on in several ways parts.
pub(super) struct Fork {
    throughput: Rgb,
    depth: u32,
    crossings: u32,
    bucket: Bucket,
    looks: bool,
    by: By,
    inside: Nest,
    cone: Cone,
}

impl Path<'_> {
    /// Lambertian transmission out of a diffuse boundary at `p`, walk space.
    pub(super) fn leave_diffuse(&mut self, exit: &Interaction, p: Vec3, sampler: &mut Sampler) -> Option<()> {
        // wo is below; the exit lobe does not depend on it.
        let bsdf = Bsdf::lambert_exit();
        let lights = self.guide.exit_choice(exit.instance, p, exit.ng);
        let cell = self.guide.exit_cell(exit.instance, p, exit.ng);
        let guide = cell.and_then(|cell| self.guide.exit(cell));
        self.next_event(exit, &bsdf, lights, guide.map_or(Rival::Nothing, Rival::Guide), sampler);
        if let Some(begun) = self.begun.filter(|begun| self.depth == 0 && begun.onward.ways > 1) {
            self.leave_in_ways(&begun, exit, &bsdf, lights, cell, guide, sampler);
            return None;
        }
        let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
        self.leave_one_way(exit, &bsdf, lights, cell, guide, u_choice, u, sampler)
    }

    /// A direction out of a diffuse boundary.
    fn leave_one_way(
        &mut self,
        exit: &Interaction,
        bsdf: &Bsdf,
        lights: LightsAt,
        cell: Option<RegionId>,
        guide: Option<&Exit>,
        u_choice: f32,
        u: Vec2,
        sampler: &mut Sampler,
    ) -> Option<()> {
        let (wi, f, pdf) = leave(exit, bsdf, guide, u_choice, u)?;
        (wi.dot(exit.ng) > 0.0).then_some(())?;
        self.log_exit(cell, wi, pdf);
        self.throughput *= f / pdf;
        self.bounce(exit, wi, false, pdf, lights, Some(Response::Scattered))?;
        self.roulette(sampler)
    }

    /// Several directions, each followed to the end of its path.
    fn leave_in_ways(
        &mut self,
        begun: &Begun,
        exit: &Interaction,
        bsdf: &Bsdf,
        lights: LightsAt,
        cell: Option<RegionId>,
        guide: Option<&Exit>,
        sampler: &mut Sampler,
    ) {
        let (ways, begin) = (begun.onward.ways, self.cost());
        self.throughput /= ways as f32;
        let (fork, logged) = (self.fork(), self.logged());
        let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
        let mut moments = [0.0; 2];
        for i in 0..ways {
            self.return_to(&fork);
            let before = self.sample.color();
            let u_choice = (u_choice + i as f32 * GOLDEN).fract();
            let mut way =
                self.leave_one_way(exit, bsdf, lights, cell, guide, u_choice, (u + i as f32 * R2).fract(), sampler);
            while way.is_some() {
                way = self.segment(sampler);
            }
            self.finish_walks_since(logged);
            let brought = f64::from(mean(self.sample.color() - before) * (ways as f32 / begun.throughput));
            moments = [moments[0] + brought, moments[1] + brought * brought];
        }
        let n = f64::from(ways);
        let variance = (moments[1] - moments[0] * moments[0] / n).max(0.0) / (n - 1.0);
        self.log_ways(begun.logged, variance, self.cost() - begin);
    }

    /// Whether a walk that enters at `p` (walk space), outward normal `n`, behind a path's first one is worth its time. What it is
    /// expected to bring is there in any case.
    pub(super) fn outlasts(&mut self, instance: u32, p: Vec3, n: Vec3, sampler: &mut Sampler) -> Option<()> {
        let throughput = self.throughput.max_element();
        let begun = self.begun.filter(|_| self.depth > 0);
        let known = begun.and_then(|begun| {
            let (_, onward) = self.guide.onward(instance, p, n)?;
            Some((onward.expected, onward.survival(throughput, &begun.onward, begun.throughput)?))
        });
        let Some((expected, survival)) = known else {
            return if self.beside.is_some() { self.survive(sampler.next_1d()) } else { Some(()) };
        };
        let survives = sampler.random() < survival;
        let left = if survives { 1.0 - 1.0 / survival } else { 1.0 };
        self.add_unlit(self.bucket, self.throughput * expected * left);
        self.throughput /= survival;
        survives.then_some(())
    }

    pub(super) fn fork(&self) -> Fork {
        let Self { throughput, depth, crossings, bucket, looks, by, inside, cone, .. } = *self;
        Fork { throughput, depth, crossings, bucket, looks, by, inside, cone }
    }

    pub(super) fn return_to(&mut self, fork: &Fork) {
        (self.throughput, self.depth, self.crossings, self.bucket) =
            (fork.throughput, fork.depth, fork.crossings, fork.bucket);
        (self.looks, self.by, self.inside, self.cone) = (fork.looks, fork.by, fork.inside, fork.cone);
    }
}

/// Direction, f |cos| and solid-angle pdf of what leaves a diffuse boundary, by the mixture with `guide` if there is one.
fn leave(exit: &Interaction, bsdf: &Bsdf, guide: Option<&Exit>, u_choice: f32, u: Vec2) -> Option<(Vec3, Rgb, f32)> {
    let Some(guide) = guide else {
        let chosen = bsdf.sample(u_choice, u)?;
        return Some((exit.frame.to_world(chosen.wi), chosen.f, chosen.pdf));
    };
    let wi = match guide.sample(u_choice, u) {
        Ok(wi) => wi,
        Err(u_choice) => exit.frame.to_world(bsdf.sample(u_choice, u)?.wi),
    };
    let local = exit.local(wi);
    (local.z > 0.0).then(|| (wi, bsdf.eval(local), guide.pdf(bsdf.pdf(local), wi)))
}
