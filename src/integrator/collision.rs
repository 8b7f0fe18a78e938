//! Light at collisions: next-event estimation from within a medium, straight through matched boundaries and bent by
//! smooth dielectric ones.

use super::direct::{transmittance, transmittance_beyond};
use super::manifold::{Crossing, Window};
use super::nest::Nest;
use super::{Bucket, add_to};
use crate::film::Sample;
use crate::light::{Choice, Emitter};
use crate::math::{Rgb, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Scene};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::Collision;
use glam::{Vec2, Vec3};

/// Light sampled at the collisions of a walk.
#[derive(Clone, Copy)]
pub(super) struct CollisionLight<'a> {
    pub scene: &'a Scene,
    /// The object that the collisions are in.
    pub instance: u32,
    /// Of objects around the path: those around the collision where the boundary is matched, around the object where it
    /// is not.
    pub around: Nest,
    /// Path throughput per unit of the walk's weight.
    pub scale: f32,
    pub bucket: Bucket,
    /// The boundary that bends the light; `None`: matched.
    pub bent: Option<Bent<'a>>,
}

impl CollisionLight<'_> {
    /// Adds to `sample` what a collision sees of a light. Returns the shadow rays that took.
    pub fn add(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        sample: &mut Sample,
    ) -> u64 {
        match &self.bent {
            None => self.add_straight(collision, enclosure, sampler, sample),
            Some(bent) => self.add_bent(bent, collision, enclosure, sampler, sample),
        }
    }

    /// Weighted against the walk's own directions.
    fn add_straight(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        sample: &mut Sample,
    ) -> u64 {
        let u = Vec2::new(sampler.random(), sampler.random());
        let p = enclosure.to_render(collision.p);
        let Some(light) = self.scene.lights.sample(p, None, Choice::One, sampler.random(), u) else {
            return 1;
        };
        let (phase, pdf) = (collision.scatter)(light.wi);
        let hit = self.scene.boundary_from_within(self.instance, collision.p, light.wi, light.reach());
        let visible = transmittance_beyond(self.scene, hit, light.wi, light.reach(), self.around);
        let weight = if light.delta { 1.0 } else { power_heuristic(light.pdf, pdf) };
        self.give(sample, collision.weight * visible * light.radiance * (phase * weight / light.pdf));
        1
    }

    /// Weighted against paths that scatter and refract the same way by chance.
    fn add_bent(
        &self,
        bent: &Bent,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        sample: &mut Sample,
    ) -> u64 {
        if sampler.random() >= TRIED {
            return 0;
        }
        let u = Vec2::new(sampler.random(), sampler.random());
        let emitter = self.scene.lights.sample_emitter(enclosure.to_render(collision.p), sampler.random(), u);
        let Some(emitter) = emitter.filter(Bent::is_small) else { return 0 };
        let ways = bent.connect(collision.p, &emitter, |survival| sampler.random() < survival);
        let mut shadow_rays = 0;
        for (at, density) in ways.into_iter().flatten() {
            let value = collision.weight * bent.unshadowed(self.scene, collision, &emitter, &at, density);
            if value.is_finite() && value != Rgb::ZERO {
                shadow_rays += 1;
                let o = bent.window.interaction(&at).origin(at.v);
                let origin = Some((self.instance, at.hit.triangle));
                self.give(sample, value * transmittance(self.scene, o, at.v, at.reach(), origin, self.around));
            }
        }
        shadow_rays
    }

    fn give(&self, sample: &mut Sample, light: Rgb) {
        add_to(sample, self.bucket, self.scale * light);
    }
}

/// Light that a boundary bends on its way to collisions in `medium`.
#[derive(Clone, Copy)]
pub(super) struct Bent<'a> {
    window: Window<'a>,
    medium: Medium,
}

/// Least density per solid angle of light that is connected to. What fills more of the sky is met by chance.
const SMALL: f32 = 0.5;

/// Share of the collisions that are tried at all: a connection costs as much as ten steps of the walk. A flat optimum, as
/// the next (docs/performance.md, "Smooth dielectrics").
const TRIED: f32 = 0.25;

/// Of those tried, the share that goes on to search: this times what the medium passes on the straight way.
const SEARCHED: f32 = 0.4;

/// Searches for one target, from as many starts, where it is drawn with a density of at least [`TINY`].
const SEARCHES: usize = 4;

/// Density per solid angle from which on what a single search misses makes most of the noise.
const TINY: f32 = 20.0;

/// Ways to one target, each with the solid-angle pdf of connecting along it.
type Ways = [Option<(Crossing, f32)>; SEARCHES];

impl<'a> Bent<'a> {
    /// `None` unless `surface` makes a smooth dielectric boundary of `instance`.
    pub fn new(scene: &'a Scene, instance: u32, surface: u32) -> Option<Self> {
        let error = InstanceEnclosure::new(scene, instance).position_error();
        let window = Window::new(scene, instance, surface, error)?;
        Some(Self { window, medium: scene.surfaces[surface as usize].interior?.medium })
    }

    fn is_small(emitter: &Emitter) -> bool {
        emitter.straight >= SMALL
    }

    /// The different ways on which light from `emitter` is found to refract to `x` (walk space). `survives` plays roulette
    /// with the probability that it is given.
    fn connect(&self, x: Vec3, emitter: &Emitter, mut survives: impl FnMut(f32) -> bool) -> Ways {
        let target = self.window.target(emitter);
        let mut ways: Ways = [None; SEARCHES];
        let Some(straight) = self.window.start(x, &target) else { return ways };
        let searched = (SEARCHED * mean(self.medium.transmittance(straight.t))).min(1.0);
        if !survives(searched) {
            return ways;
        }
        let searches = if emitter.straight < TINY { 1 } else { SEARCHES };
        for i in 0..searches {
            let start = if i == 0 { Some(straight) } else { self.window.start_beside(x, &target, &straight, i - 1) };
            let Some(at) = start.and_then(|start| self.window.solve(x, &target, start)) else { continue };
            let known = ways[..i].iter().flatten().any(|(other, _)| self.window.is_at(other, at.p));
            let density = TRIED * searched * self.window.pdf(&at, emitter);
            if !known && density > 0.0 && density.is_finite() {
                ways[i] = Some((at, density));
            }
        }
        ways
    }

    /// What a collision scatters of the light on one of the ways, over its density, MIS weight included.
    fn unshadowed(&self, scene: &Scene, collision: &Collision, emitter: &Emitter, at: &Crossing, density: f32) -> Rgb {
        let (phase, pdf) = (collision.scatter)(at.d);
        let weight = if emitter.delta { 1.0 } else { power_heuristic(density, pdf * self.escape(at)) };
        let passed = self.medium.transmittance(at.t) * self.window.radiance(at);
        passed * scene.lights.radiance_of(emitter, at.v) * (phase * weight / density)
    }

    /// Probability that a walk which goes towards `at` gets out there.
    fn escape(&self, at: &Crossing) -> f32 {
        mean(self.medium.transmittance(at.t)) * self.window.transmitted(at)
    }
}

/// The last collision before a path refracted out into the segment under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refracted {
    pub instance: u32,
    pub surface: u32,
    /// The collision, and where the path came out; walk space.
    pub x: Vec3,
    pub p: Vec3,
    /// Of the direction between them, per solid angle.
    pub pdf: f32,
}

impl Refracted {
    /// MIS weight of having met a light by chance, given as what it is to a receiver at a point of render space.
    pub fn weight(&self, scene: &Scene, emitter: impl Fn(Vec3) -> Option<Emitter>) -> f32 {
        let x = self.x + scene.instances[self.instance as usize].to_render.translation;
        let Some(emitter) = emitter(x).filter(Bent::is_small) else { return 1.0 };
        let Some(bent) = Bent::new(scene, self.instance, self.surface) else { return 1.0 };
        let ways = bent.connect(self.x, &emitter, |_| true);
        match ways.into_iter().flatten().find(|(at, _)| bent.window.is_at(at, self.p)) {
            Some((at, density)) => power_heuristic(self.pdf * bent.escape(&at), density),
            // Found by chance alone.
            None => 1.0,
        }
    }
}
