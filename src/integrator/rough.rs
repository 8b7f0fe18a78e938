//! Light at collisions behind a rough dielectric: looked for where facets of the boundary ahead refract it to.
//!
//! A look takes the random numbers of a light sample, sees that light from the collision, and finds where it would refract to there;
//! a facet of the boundary at that place draws a direction, which is followed to where it really leaves. There the light is
//! sampled with the same numbers. A walk that goes that way by chance and samples light with such numbers could have been
//! such a look, whose density is known in closed form: both share the light by the power heuristic.

use super::collision::{CollisionLight, Into};
use super::direct::arriving;
use crate::bsdf::fresnel::refract;
use crate::bsdf::{Dielectric, Side, Surface};
use crate::guiding::Guide;
use crate::light::{Choice, LightSample, LightsAt};
use crate::math::{Frame, PI, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::Collision;
use glam::{Vec2, Vec3};

/// Looks of a collision at the boundary: deeper ones have as many less as less light gets there. A flat optimum on
/// `dragon_rough` (docs/performance.md, "Rough dielectrics"), as the next two.
const LOOKS: f32 = 0.5;

/// Mean free paths of the clearest channel from which a boundary is seen: e^-8 of the light of what is farther is left to chance.
const REACH: f32 = 8.0;

/// Collisions that look with the same random numbers: to find a direction of a map by them costs as much as a ray.
const TOGETHER: u32 = 4;

/// Solid-angle pdf of a light's sample below which it is left to chance: directions of a rough boundary find so broad a light. Over
/// that of the facets' normals, 1 / (pi alpha^2), and by itself: efficiency over chance is 0.7, 0.9, 1.5 and 3.9 where the first
/// is 0.03, 0.2, 1 and 9 (docs/performance.md, "Rough dielectrics").
const BROAD: f32 = 0.25;
const BROAD_ALONE: f32 = 2.0;

/// Position errors that a collision has to be away from the boundary: closer to it, rays may miss the boundary that walks
/// know of.
const CLEAR: f32 = 16.0;

/// Of the directions that walks draw, for MIS: nominal, so that no walk has to know its own.
const BY_CHANCE: f32 = 0.25 / PI;

/// Nominal solid-angle density of directions that walks draw and that get to the boundary, `t` away.
pub(super) fn by_chance(medium: &Medium, t: f32) -> f32 {
    BY_CHANCE * mean(medium.transmittance(t))
}

/// A rough boundary as it is seen from within.
#[derive(Clone, Copy)]
pub(super) struct Rough<'a> {
    guide: &'a Guide,
    surface: &'a Surface,
    /// From outside.
    facets: Dielectric,
    medium: Medium,
    /// Index of what is outside.
    beside: f32,
    /// Of the path's footprint.
    width: f32,
    reach: f32,
    /// Least pdf of a light's sample that is looked for.
    least_pdf: f32,
}

/// Where a light seems to be from a collision: the boundary on the way.
#[derive(Debug, Clone, Copy)]
struct Ahead {
    frame: Frame,
    /// Local direction to the light.
    wo: Vec3,
    /// Number of looks.
    expected: f32,
}

/// The random numbers with which collisions of a walk look for lights, one after the other.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sought {
    /// Collisions until the next are drawn, whatever they see.
    left: u32,
    u: Vec2,
    /// A light that looks the same from everywhere, and its sample where it is looked for.
    known: Option<(u32, Option<LightSample>)>,
}

/// A look that is worth taking.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glance {
    light: u32,
    /// Probability of its choice.
    chosen: f32,
    /// Its sample, if that is the same from everywhere.
    known: Option<LightSample>,
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
    /// Outward normal where the walk started.
    pub entry: Vec3,
    /// Walk space.
    pub x: Vec3,
    /// Unit.
    pub d: Vec3,
    /// To the boundary.
    pub t: f32,
}

impl<'a> Rough<'a> {
    /// `None` unless `surface` has a rough interface; beside it is the index `beside`.
    pub fn new(guide: &'a Guide, surface: &'a Surface, medium: Medium, beside: f32, width: f32) -> Option<Self> {
        let facets = surface.rough_interface(beside)?;
        let reach = REACH / medium.sigma_t.min_element();
        let least_pdf = (BROAD / (PI * facets.alpha * facets.alpha)).max(BROAD_ALONE);
        Some(Self { guide, surface, facets, medium, beside, width, reach, least_pdf })
    }

    /// Whether the collision at `x` looks, and for what, by what is known without its weight.
    pub fn glance(
        &self,
        to: &CollisionLight,
        enclosure: &InstanceEnclosure,
        x: Vec3,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> Option<Glance> {
        let chance = sampler.random();
        (chance < LOOKS).then_some(())?;
        let (lights, p) = (to.scene.lights_for(to.instance), enclosure.to_render(x));
        into.sought.go_on(sampler);
        let (light, chosen) = lights.draws(p, None, Choice::ONE).choose(sampler.random())?;
        let sample = into.sought.sample(self, lights, light, p)?;
        let ahead = self.ahead(to.scene, enclosure, to.entry, x, sample.wi)?;
        let known = lights.is_same_everywhere(light).then_some(sample);
        (chance < ahead.expected).then_some(Glance { light, chosen, known, u: into.sought.u, ahead })
    }

    /// The sample `u` of `light` as seen from `p`, render space; `None` where that is too broad to be looked for.
    fn sample(&self, lights: LightsAt, light: u32, p: Vec3, u: Vec2) -> Option<LightSample> {
        lights.sample_light(light, p, None, u).filter(|sample| self.seeks(sample))
    }

    fn seeks(&self, sample: &LightSample) -> bool {
        sample.delta || sample.pdf >= self.least_pdf
    }

    /// The boundary on the way from `x` to a light that is straight along `wi`; `None`: it is not looked for.
    fn ahead(&self, scene: Moment, enclosure: &InstanceEnclosure, entry: Vec3, x: Vec3, wi: Vec3) -> Option<Ahead> {
        // As if the boundary were the plane of the entry; as if it were that which is found there.
        let guess = if wi.dot(entry) > 0.0 { -refract(wi, entry, self.facets.eta)? } else { wi };
        let (_, first, refracted) = self.boundary(scene, enclosure, x, guess, wi)?;
        let guess = -first.to_world(refracted);
        let (t, frame, refracted) = self.boundary(scene, enclosure, x, guess, wi)?;
        let way = t * frame.n.dot(guess) / refracted.z.abs();
        // A shading normal may look away from the way: that counts as no way at all.
        let expected = LOOKS * mean(self.medium.transmittance(way.max(0.0)));
        Some(Ahead { frame, wo: frame.to_local(wi), expected })
    }

    /// The boundary from `x` along `d`: how far, its frame, and where it refracts light from `wi` to, local.
    fn boundary(
        &self,
        scene: Moment,
        enclosure: &InstanceEnclosure,
        x: Vec3,
        d: Vec3,
        wi: Vec3,
    ) -> Option<(f32, Frame, Vec3)> {
        let (t, hit) = enclosure.cast(x, d, self.reach, None)?;
        (t > CLEAR * enclosure.position_error()).then_some(())?;
        let frame = scene.interaction(&enclosure.surface_hit(&hit), d, Side::Inside).frame;
        let wo = frame.to_local(wi);
        let refracted = refract(wo, Vec3::Z, self.facets.eta).filter(|_| wo.z > 0.0)?;
        Some((t, frame, refracted))
    }

    /// Solid-angle density of looks along `d`.
    fn density(&self, ahead: &Ahead, d: Vec3) -> f32 {
        let w = ahead.frame.to_local(-d);
        if w.z < 0.0 { ahead.expected * self.facets.pdf(ahead.wo, w) } else { 0.0 }
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
        let Glance { light, chosen, known, u, ahead } = *glance;
        let (u_choice, u_facet) = (sampler.random(), Vec2::new(sampler.random(), sampler.random()));
        let w = self.facets.sample(ahead.wo, u_choice, u_facet).filter(|w| w.z < 0.0);
        let Some(d) = w.map(|w| -ahead.frame.to_world(w)) else { return 0 };
        let Some((t, hit)) = enclosure.cast(collision.p, d, f32::INFINITY, None) else { return 0 };
        let mut exit = to.scene.interaction(&enclosure.surface_hit(&hit), d, Side::Inside);
        to.scene.bend(&mut exit, self.width);
        let bsdf = self.surface.bsdf_beside(exit.local(exit.wo), Side::Inside, self.beside);
        let lights = to.scene.lights_for(to.instance);
        // As many as a walk would sample there: directions of the boundary compete with all of them.
        let choice = self.guide.exit_choice(exit.instance, enclosure.point(&hit), exit.ng);
        let samples = lights.choice_probability(light, exit.p, exit.horizon(), self.guide.choice(choice));
        let sample = known.or_else(|| lights.sample_light(light, exit.p, exit.horizon(), u));
        let sample = sample.map(|sample| LightSample { pdf: sample.pdf * samples, ..sample });
        let arriving = sample.and_then(|sample| arriving(to.scene, &exit, &bsdf, None, to.around, &sample));
        let Some(arriving) = arriving else { return 0 };
        let (phase, _) = (collision.scatter)(d);
        let passed = collision.weight * self.medium.transmittance(t) * phase;
        let density = self.density(&ahead, d);
        let seen = passed
            * arriving.light
            * (samples * power_heuristic(density, by_chance(&self.medium, t)) / (density * chosen));
        if seen.is_finite() {
            to.give(into, light, seen);
        }
        1
    }
}

impl CameFrom<'_> {
    /// MIS weight of a light's `sample` by the numbers `u` where chance has led.
    pub fn weight(&self, scene: Moment, sample: &LightSample, u: Vec2) -> f32 {
        let Self { rough, enclosure, entry, x, d, t, .. } = *self;
        let lights = scene.lights_for(self.instance);
        let sought = match lights.is_same_everywhere(sample.light) {
            true => rough.seeks(sample).then_some(*sample),
            false => rough.sample(lights, sample.light, enclosure.to_render(x), u),
        };
        let ahead = sought.and_then(|sought| rough.ahead(scene, enclosure, entry, x, sought.wi));
        ahead.map_or(1.0, |ahead| power_heuristic(by_chance(&rough.medium, t), rough.density(&ahead, d)))
    }
}

impl Sought {
    fn go_on(&mut self, sampler: &mut Sampler) {
        if self.left == 0 {
            *self = Self { left: TOGETHER, u: Vec2::new(sampler.random(), sampler.random()), known: None };
        }
        self.left -= 1;
    }

    /// [`Rough::sample`] of a light, from `p`.
    fn sample(&mut self, rough: &Rough, lights: LightsAt, light: u32, p: Vec3) -> Option<LightSample> {
        if let Some((_, sample)) = self.known.filter(|(known, _)| *known == light) {
            return sample;
        }
        let sample = rough.sample(lights, light, p, self.u);
        if lights.is_same_everywhere(light) {
            self.known = Some((light, sample));
        }
        sample
    }
}

#[cfg(test)]
mod tests;
