//! Suns at collisions behind a smooth dielectric: lights so small that hardly a direction meets them, connected to.
//!
//! A collision draws a direction to a sun as a surface would, and searches the boundary for the points where the way from the
//! collision refracts into it (`manifold`). A path that leaves by chance and meets a sun without another collision could have been
//! such a connection, if the search, which draws no random numbers, finds its own way again: then both share the light by the power
//! heuristic. What the search does not find, and what is reflected inside, is left to chance. Lights of a single direction have
//! the search alone.

use super::collision::{CollisionLight, Into};
use super::manifold::{Crossing, Window};
use super::rough::by_chance;
use super::shadow::visibility;
use crate::light::{Choice, LightSample, LightsAt, SUN_PDF};
use crate::math::{Rgb, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::walk::Collision;
use glam::{Vec2, Vec3};

/// Share of the collisions that search: this times what the medium passes to the plane where the straight way leaves. On a flat
/// face no bent way is shorter, so that none is worth much more than its chance, however grazing the sun. A search costs as much as
/// ten steps of the walk. A flat optimum (docs/performance.md, "Smooth dielectrics").
const SEARCHED: f32 = 0.1;

/// Cosine of the most grazing straight way: one that is more so counts as deeper, and how far to look for the boundary has a bound.
const GRAZING: f32 = 0.02;

/// Searches for one direction, from as many starts.
const SEARCHES: usize = 4;

/// The suns of a scene behind the boundary of a body.
#[derive(Clone, Copy)]
pub(super) struct Suns<'a> {
    scene: Moment<'a>,
    instance: u32,
    window: Window<'a>,
    medium: Medium,
}

/// A search that is worth its time.
#[derive(Clone, Copy)]
pub(super) struct Search {
    sun: LightSample,
    straight: Crossing,
    /// How many are expected.
    expected: f32,
}

/// The first way of a path since a collision.
#[derive(Debug, Clone, Copy)]
pub(super) struct FirstWay {
    /// Walk space: from the collision to the boundary.
    pub x: Vec3,
    pub p: Vec3,
}

impl<'a> Suns<'a> {
    pub fn new(scene: Moment<'a>, instance: u32, window: Window<'a>, medium: Medium) -> Self {
        Self { scene, instance, window, medium }
    }

    fn lights(&self) -> LightsAt<'a> {
        self.scene.lights_for(self.instance)
    }

    /// Solid-angle pdf of a light beyond all in the direction `v`, if that is a sun.
    pub fn pdf(&self, light: u32, v: Vec3) -> Option<f32> {
        let lights = self.lights();
        lights.is_same_everywhere(light).then_some(())?;
        // From anywhere.
        let pdf = lights.pdf_escaped(light, Vec3::ZERO, None, Choice::All(1), v);
        (pdf >= SUN_PDF).then_some(pdf)
    }

    /// Whether the collision at `x` searches, and for what, by what is known without its weight.
    pub fn search(&self, enclosure: &InstanceEnclosure, x: Vec3, sampler: &mut Sampler) -> Option<Search> {
        // Drawn first: for most there is nothing more to do, and for the others the boundary must be near.
        let u = sampler.random();
        let reach = self.reach(u)?;
        let (lights, p) = (self.lights(), enclosure.to_render(x));
        let (light, chosen) = lights.draws(p, None, Choice::ONE).choose(sampler.random())?;
        (lights.is_same_everywhere(light) && self.scene.illuminates(light, self.instance)).then_some(())?;
        let sun = lights.sample_light(light, p, None, Vec2::new(sampler.random(), sampler.random()))?;
        (sun.delta || sun.pdf >= SUN_PDF).then_some(())?;
        let straight = self.window.start_within(x, sun.wi, reach)?;
        let searched = self.searched(&straight);
        (u < searched).then_some(Search { sun, straight, expected: searched * chosen })
    }

    /// Share of the collisions that search where this is their straight way.
    fn searched(&self, straight: &Crossing) -> f32 {
        let depth = straight.t * straight.d.dot(straight.frame.n).abs().max(GRAZING);
        SEARCHED * mean(self.medium.transmittance(depth))
    }

    /// Distance beyond which [`Self::searched`] is below `u`; `None` if it is anywhere.
    fn reach(&self, u: f32) -> Option<f32> {
        (u < SEARCHED).then_some(())?;
        // The clearest channel passes no less than the mean; 0 / 0, without extinction, is as far as any.
        let reach = (SEARCHED / u).ln() / (GRAZING * self.medium.sigma_t.min_element());
        Some(if reach.is_nan() { f32::INFINITY } else { reach })
    }

    /// The ways from `x` that a search finds, each once.
    fn found(&self, x: Vec3, straight: &Crossing) -> impl Iterator<Item = Crossing> {
        let mut found = [None; SEARCHES];
        for i in 0..SEARCHES {
            let start = if i == 0 { Some(*straight) } else { self.window.start_beside(x, straight, i - 1) };
            let at = start.and_then(|start| self.window.solve(x, start));
            let known = |at: &Crossing| found[..i].iter().flatten().any(|other| self.window.is_at(other, at.p));
            found[i] = at.filter(|at| !known(at));
        }
        found.into_iter().flatten()
    }

    /// Adds what the `search` of a collision finds. Returns the shadow rays that took.
    pub fn connect(&self, to: &CollisionLight, search: &Search, collision: &Collision, into: &mut Into) -> u64 {
        let (x, sun, mut shadow_rays) = (collision.p, &search.sun, 0);
        for at in self.found(x, &search.straight) {
            let (phase, _) = (collision.scatter)(at.d);
            let passed = collision.weight * self.medium.transmittance(at.t) * self.window.radiance(&at);
            let density = search.expected * sun.pdf / self.window.spread(&at);
            let weight = if sun.delta { 1.0 } else { power_heuristic(density, by_chance(&self.medium, at.t)) };
            let value = passed * sun.radiance * (phase * weight / density);
            if value.is_finite() && value != Rgb::ZERO {
                shadow_rays += 1;
                let (o, origin) = (self.window.interaction(&at).origin(at.v), Some((to.instance, at.hit.triangle)));
                let visible = visibility(to.scene, sun.light, o, at.v, f32::INFINITY, origin, to.around);
                to.give(into, sun.light, value * visible);
            }
        }
        shadow_rays
    }

    /// MIS weight of a sun met by chance along `v`, where its `light` has the solid-angle pdf `pdf`.
    pub fn weight(&self, enclosure: &InstanceEnclosure, way: &FirstWay, light: u32, v: Vec3, pdf: f32) -> f32 {
        let Some(straight) = self.window.start(way.x, v) else { return 1.0 };
        let Some(at) = self.found(way.x, &straight).find(|at| self.window.is_at(at, way.p)) else { return 1.0 };
        let chosen = self.lights().choice_probability(light, enclosure.to_render(way.x), None, Choice::ONE);
        let density = self.searched(&straight) * chosen * pdf / self.window.spread(&at);
        power_heuristic(by_chance(&self.medium, (way.p - way.x).length()), density)
    }
}

#[cfg(test)]
mod tests;
