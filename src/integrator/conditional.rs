//! A walk along one slab normal, or classical: the walks of the literature, weighted by themselves.

use super::Path;
use super::collision::{Bends, CollisionLight, Into};
use super::medium::Passage;
use super::watch::drawn;
use crate::guiding::plan::Walk;
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::BoundaryHit;
use crate::subsurface::steps::{Start, WalkEnd};
use crate::subsurface::technique::PerTechnique;
use crate::subsurface::walk::{Along, Collision, walk};
use glam::{Vec2, Vec3};

impl Path<'_> {
    /// From boundary to boundary; the path has the `throughput` at the start.
    pub(super) fn conditional_walk(
        &mut self,
        passage: &Passage,
        start: Start<BoundaryHit>,
        throughput: Rgb,
        light: Option<CollisionLight>,
        sampler: &mut Sampler,
    ) -> WalkEnd<BoundaryHit> {
        let guide = self.guide;
        let mut kind = passage.plan.walk;
        // The classical share of the literature's walks; the weight does not know of it (guiding.md 2.6). The mixture
        // has its own.
        if !matches!(kind, Walk::Classical | Walk::Mixture)
            && guide.classical > 0.0
            && sampler.random() < guide.classical
        {
            kind = Walk::Classical;
        }
        let kernels = &passage.medium.kernels;
        let fixed = |normal| Along::Fixed { kernels, normal, first_distance: guide.guided_first };
        let slab = match kind {
            Walk::Classical => Along::None,
            Walk::Poe => fixed(start.normal),
            Walk::Cp | Walk::Ii => Along::Late { kernels },
            Walk::Mixture => {
                let techniques = guide.start(kind, passage.instance, start.p, start.normal).techniques;
                let lane = techniques.choose(sampler.random()).lane;
                lane.map_or(Along::None, |lane| fixed(techniques.normal(lane)))
            }
            Walk::Bono | Walk::Bill => {
                let u = (sampler.random(), sampler.random());
                let u2 = Vec2::new(sampler.random(), sampler.random());
                fixed(guide.slab_normal(passage.instance, start.p, start.normal, u, u2).unwrap_or(start.normal))
            }
        };
        let (enclosure, scene) = (&passage.enclosure, self.scene);
        let mut followed = if let Along::Fixed { normal, .. } = slab { Some(normal) } else { None };
        let late = |p: Vec3, sampler: &mut Sampler| {
            followed = if kind == Walk::Cp {
                enclosure.closest_point(p).and_then(|to| away(p, to))
            } else {
                let u = Vec2::new(sampler.random(), sampler.random());
                let choice = crate::light::Choice::ONE;
                let lights = scene.lights_for(passage.instance);
                lights.sample(enclosure.to_render(p), None, choice, sampler.random(), u).map(|light| light.wi)
            };
            followed
        };
        let mut into = Into::new(&mut self.sample, &mut *self.groups, &mut *self.lobes);
        let shadow_rays = &mut self.stats.shadow_rays;
        let mut notes =
            self.log.as_mut().filter(|_| passage.noted).and_then(|log| log.notes(throughput, passage.first));
        let collide = |collision: &Collision, sampler: &mut Sampler| {
            let notes = notes.as_mut().filter(|notes| notes.has_room());
            if let (Some(notes), Some(weight)) = (notes, collision.walked) {
                notes.collision(collision.p, weight / start.weight, PerTechnique::default(), &into);
            }
            let looks =
                |light: &&CollisionLight| light.looks(collision.p, collision.role, enclosure, sampler, &mut into);
            if let Some(light) = light.as_ref().filter(looks) {
                *shadow_rays += light.add(collision, enclosure, sampler, &mut into);
            }
        };
        let medium = &passage.medium.medium;
        let stats = &mut self.stats.walk;
        let segments = stats.steps;
        let ahead = matches!(passage.bends, Some(Bends::Smooth(_)));
        let end = walk(enclosure, medium, slab, start, ahead, sampler, stats, late, collide);
        if let (Some(mut notes), WalkEnd::Boundary { hit, d, weight, .. }) = (notes, &end) {
            let at = (passage.enclosure.point(hit), passage.enclosure.normal(hit));
            notes.exit(at, *d, *weight / start.weight, PerTechnique::default(), &into);
        }
        self.aim = into.aim;
        if passage.first && self.guide.watched() {
            let segments = self.stats.walk.steps - segments;
            self.watch(passage.instance, &start, segments, followed, drawn(followed, start.normal));
        }
        end
    }
}

/// Unit vector from a collision to the boundary point `to`; `None` on the boundary itself.
pub(super) fn away(p: Vec3, to: Vec3) -> Option<Vec3> {
    (to - p).try_normalize()
}
