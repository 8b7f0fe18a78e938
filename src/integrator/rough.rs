//! Light at collisions behind a rough dielectric: looked for where facets of the boundary ahead refract it to.
//!
//! A look sees a light straight from the collision, as if nothing bent it, lets a facet of the boundary on that way refract it, and
//! follows the refracted way to where it really leaves: there light is sampled with the same random numbers. A walk that goes
//! that way by chance and samples light with such numbers could have been such a look, whose density is known in closed form:
//! both share the light by the power heuristic.

use super::collision::{CollisionLight, Into};
use super::direct::arriving;
use crate::bsdf::fresnel::refract;
use crate::bsdf::{Bsdf, Dielectric, Side, Surface};
use crate::light::Choice;
use crate::math::{Frame, PI, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::Collision;
use glam::{Vec2, Vec3};

/// Looks of a collision at the boundary: deeper ones have as many less as less light gets there.
const LOOKS: f32 = 0.5;

/// Mean free paths of the clearest channel from which a boundary is seen: e^-8 of the light of what is farther is left to chance.
const REACH: f32 = 8.0;

/// Position errors that a collision has to be away from the boundary: closer to it, rays may miss the boundary that walks
/// know of.
const CLEAR: f32 = 256.0;

/// Of the directions that walks draw, for MIS: nominal, so that no walk has to know its own.
const BY_CHANCE: f32 = 0.25 / PI;

/// A rough boundary as it is seen from within.
#[derive(Clone, Copy)]
pub(super) struct Rough<'a> {
    surface: &'a Surface,
    /// From outside.
    facets: Dielectric,
    medium: Medium,
    /// Index of what is outside.
    beside: f32,
    /// Of the path's footprint.
    width: f32,
    reach: f32,
}

/// Where a light seems to be from a collision, and the boundary on the way.
#[derive(Debug, Clone, Copy)]
struct Ahead {
    frame: Frame,
    /// Local direction to the light.
    wo: Vec3,
    /// Number of looks.
    expected: f32,
}

/// A look that is worth taking.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glance {
    light: u32,
    /// Probability of its choice.
    chosen: f32,
    /// Random numbers of the light sample.
    u: Vec2,
    ahead: Ahead,
}

/// The last collision of a walk that has come to the boundary.
#[derive(Clone, Copy)]
pub(super) struct CameFrom<'a> {
    pub rough: &'a Rough<'a>,
    pub enclosure: &'a InstanceEnclosure<'a>,
    pub instance: u32,
    /// Walk space.
    pub x: Vec3,
    /// Unit.
    pub d: Vec3,
}

impl<'a> Rough<'a> {
    /// `None` unless `surface` has a rough interface; beside it is the index `beside`.
    pub fn new(surface: &'a Surface, medium: Medium, beside: f32, width: f32) -> Option<Self> {
        let facets = surface.rough_interface(beside)?;
        let reach = REACH / medium.sigma_t.min_element();
        Some(Self { surface, facets, medium, beside, width, reach })
    }

    /// The boundary on the way from `x` to where `light` is by the numbers `u`; `None`: it is not looked for.
    fn ahead(
        &self,
        scene: Moment,
        enclosure: &InstanceEnclosure,
        instance: u32,
        x: Vec3,
        light: u32,
        u: Vec2,
    ) -> Option<Ahead> {
        let wi = scene.lights_for(instance).sample_light(light, enclosure.to_render(x), None, u)?.wi;
        let (t, hit) = enclosure.cast(x, wi, self.reach, None)?;
        (t > CLEAR * enclosure.position_error()).then_some(())?;
        let at = scene.interaction(&enclosure.surface_hit(&hit), wi, Side::Inside);
        let wo = at.local(wi);
        let refracted = refract(wo, Vec3::Z, self.facets.eta).filter(|_| wo.z > 0.0)?;
        // As far as the boundary is a plane.
        let way = t * wo.z / refracted.z.abs();
        Some(Ahead { frame: at.frame, wo, expected: LOOKS * mean(self.medium.transmittance(way)) })
    }

    /// Solid-angle density of looks along `d`.
    fn density(&self, ahead: &Ahead, d: Vec3) -> f32 {
        let w = ahead.frame.to_local(-d);
        if w.z < 0.0 { ahead.expected * self.facets.pdf(ahead.wo, w) } else { 0.0 }
    }

    /// Whether the collision at `x` looks, and for what: what it carries is not known yet.
    pub fn glance(
        &self,
        to: &CollisionLight,
        enclosure: &InstanceEnclosure,
        x: Vec3,
        sampler: &mut Sampler,
    ) -> Option<Glance> {
        let chance = sampler.random();
        (chance < LOOKS).then_some(())?;
        let lights = to.scene.lights_for(to.instance);
        let (light, chosen) =
            lights.draws(enclosure.to_render(x), None, Choice::ONE).choose(sampler.random())?;
        let u = Vec2::new(sampler.random(), sampler.random());
        let ahead = self.ahead(to.scene, enclosure, to.instance, x, light, u)?;
        (chance < ahead.expected).then_some(Glance { light, chosen, u, ahead })
    }

    /// Adds what a collision sees. Returns the shadow rays that took.
    pub fn look(
        &self,
        to: &CollisionLight,
        glance: &Glance,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        let Glance { light, chosen, u, ahead } = glance;
        let u_facet = Vec2::new(sampler.random(), sampler.random());
        let w = self.facets.sample(ahead.wo, sampler.random(), u_facet).filter(|w| w.z < 0.0);
        let Some(d) = w.map(|w| -ahead.frame.to_world(w)) else { return 0 };
        let Some((t, hit)) = enclosure.cast(collision.p, d, f32::INFINITY, None) else { return 0 };
        let mut exit = to.scene.interaction(&enclosure.surface_hit(&hit), d, Side::Inside);
        to.scene.bend(&mut exit, self.width);
        let bsdf = self.seen_from(exit.local(exit.wo));
        let sample = to.scene.lights_for(to.instance).sample_light(*light, exit.p, exit.horizon(), *u);
        let arriving = sample.and_then(|sample| arriving(to.scene, &exit, &bsdf, None, to.around, &sample));
        let Some(arriving) = arriving else { return 0 };
        let density = self.density(ahead, d);
        let (phase, _) = (collision.scatter)(d);
        let value = phase * power_heuristic(density, BY_CHANCE) / (density * chosen);
        let passed = collision.weight * self.medium.transmittance(t);
        let seen = passed * arriving.light * value;
        if seen.is_finite() {
            to.give(into, *light, seen);
        }
        1
    }

    /// The boundary from within, for the local direction `wo`.
    fn seen_from(&self, wo: Vec3) -> Bsdf {
        self.surface.bsdf_beside(wo, Side::Inside, self.beside)
    }
}

impl CameFrom<'_> {
    /// MIS weight of `light` sampled with the numbers `u` where chance has led.
    pub fn weight(&self, scene: Moment, light: u32, u: Vec2) -> f32 {
        let ahead = self.rough.ahead(scene, self.enclosure, self.instance, self.x, light, u);
        ahead.map_or(1.0, |ahead| power_heuristic(BY_CHANCE, self.rough.density(&ahead, self.d)))
    }
}
