//! The walk of the exact mixture: one technique drawn for the whole walk, weighted by the marginal over all.
//!
//! guiding.md 1.5. The weight is the path's contribution over the sum of all techniques' densities, so it is bounded
//! by the inverse share of the classical technique, whichever technique was drawn.

use super::steps::{Enclosure, MAX_STEPS, Start, Step, Steps, WalkEnd, WalkStats};
use super::technique::{At, Densities, GuidedMedium, Prefix, Technique, Techniques};
use super::walk::{Collision, Role};
use crate::math::Frame;
use crate::medium::{phase_eval, phase_sample};
use crate::sampling::sampler::Sampler;
use glam::Vec3;

/// How a walk of the mixture ended, and what learning and control variates need of it.
#[derive(Debug, Clone, Copy)]
pub struct MixtureEnd<H> {
    pub end: WalkEnd<H>,
    pub technique: Technique,
    /// At the end, where roulette killed the walk too: density ratios are martingales over prefixes, so the value
    /// there has the expectation that every continuation would have had (control_variates.md).
    pub densities: Densities,
}

/// What a caller may add to a walk.
pub trait Visitor {
    /// Light is sampled at collisions: the walk then keeps the pdf of the directions that follow.
    const AT_COLLISIONS: bool;

    /// Whether [`Self::vertex`] is to be called at the collision.
    fn notes(&self) -> bool {
        false
    }

    /// With the densities of what leads there, and the probability that roulette lets a walk get there.
    fn vertex(&mut self, _p: Vec3, _densities: &Densities, _survived: f32) {}

    /// Called where a walk ends without having met the boundary.
    fn leaked(&mut self, _p: Vec3, _densities: &Densities) {}

    /// The slab normal of lane 0 where it is only known at the first collision, `p`. Called once per walk.
    fn late_normal(&mut self, _p: Vec3) -> Option<Vec3> {
        None
    }

    /// Whether the collision at `p` samples light.
    fn looks(&mut self, _p: Vec3, _sampler: &mut Sampler) -> bool {
        Self::AT_COLLISIONS
    }

    /// Called at those that do, before their direction is drawn.
    fn collide(&mut self, _collision: &Collision, _sampler: &mut Sampler) {}
}

/// Roulette is played at every so many collisions: the marginal costs an exponential per technique.
const ROULETTE_EVERY: u32 = 16;

/// Marginal weight below which it is played; a flat optimum (mixture_3d.md section 5).
const ROULETTE_BELOW: f32 = 0.1;

/// A walk under way.
struct Walk<'a, H> {
    medium: &'a GuidedMedium,
    techniques: Techniques,
    drawn: Technique,
    /// Of the slab normal that is drawn along.
    along: Option<Frame>,
    start: Start<H>,
    prefix: Prefix,
    /// Product of the survival probabilities of roulette.
    survived: f32,
}

/// Walks from boundary to boundary with the technique of `techniques` at `u` in [0, 1).
pub fn walk_mixture<E: Enclosure, V: Visitor>(
    enclosure: &E,
    medium: &GuidedMedium,
    techniques: Techniques,
    start: Start<E::Hit>,
    u: f32,
    sampler: &mut Sampler,
    stats: &mut WalkStats,
    visitor: &mut V,
) -> MixtureEnd<E::Hit> {
    stats.walks += 1;
    let techniques = techniques.tilted(start.weight);
    let drawn = techniques.choose(u);
    let along = drawn.lane.map(|lane| Frame::from_normal(techniques.normal(lane)));
    let mut walk = Walk { medium, techniques, drawn, along, start, prefix: Prefix::new(start.d), survived: 1.0 };
    let mut steps = Steps::new(enclosure, start);
    let mut scattered = None;
    for _ in 0..MAX_STEPS {
        stats.steps += 1;
        sampler.begin_step();
        let d = walk.prefix.last;
        let t = walk.free_flight(sampler);
        match steps.advance(d, t) {
            Step::Boundary { t, hit } => {
                walk.travel(t);
                let densities = walk.densities(At::Boundary);
                let weight = start.weight * densities.weight() / walk.survived;
                let end = WalkEnd::Boundary { hit, p: steps.p + t * d, d, weight, scattered };
                return MixtureEnd { end, technique: drawn, densities };
            }
            Step::Leaked => {
                let end = walk.leak(t, stats);
                visitor.leaked(steps.p, &end.densities);
                return end;
            }
            Step::Collision => walk.travel(t),
        }
        walk.prefix.collisions += 1;
        if walk.prefix.collisions == 1
            && let Some(normal) = visitor.late_normal(steps.p)
        {
            walk.techniques.set_normal(0, normal);
            walk.along = drawn.lane.map(|lane| Frame::from_normal(walk.techniques.normal(lane)));
        }
        if visitor.notes() {
            visitor.vertex(steps.p, &walk.densities(At::Collision), walk.survived);
        }
        if walk.prefix.collisions.is_multiple_of(ROULETTE_EVERY) && !walk.survives(sampler) {
            return walk.end(WalkEnd::Absorbed, At::Collision, stats);
        }
        let pdf = if V::AT_COLLISIONS && visitor.looks(steps.p, sampler) {
            walk.scatter_lit(steps.p, visitor, sampler)
        } else {
            walk.prefix.last = walk.direction(sampler);
            f32::NAN
        };
        scattered = Some((steps.p, pdf));
    }
    // The formula of a boundary without its last segment is that of a direction just drawn.
    walk.end(WalkEnd::TooLong, At::Boundary, stats)
}

impl<H: Copy> Walk<'_, H> {
    fn densities(&self, at: At) -> Densities {
        self.techniques.densities(self.medium, &self.prefix, at)
    }

    /// Distance to the next collision, stage units.
    fn free_flight(&self, sampler: &mut Sampler) -> f32 {
        let kernel = &self.medium.kernels[self.drawn.channel];
        let mut rate = self.medium.medium.sigma_t[self.drawn.channel];
        if let Some(along) = self.along.as_ref().filter(|_| self.techniques.guided_first || self.prefix.collisions > 0)
        {
            rate *= kernel.stretch(along.n, self.prefix.last);
        }
        let depth = -sampler.step_open().ln();
        if rate > 0.0 { depth / rate } else { f32::INFINITY }
    }

    fn travel(&mut self, t: f32) {
        self.prefix.travel(f64::from(t) * f64::from(self.medium.scale));
    }

    fn direction(&self, sampler: &mut Sampler) -> Vec3 {
        let d = self.prefix.last;
        match &self.along {
            Some(along) => self.medium.kernels[self.drawn.channel].sample(along, d, sampler),
            None => phase_sample(self.medium.medium.g, d, sampler.step_2d()),
        }
    }

    /// Roulette on the marginal weight, a function of the prefix only: never of the technique that was drawn.
    fn survives(&mut self, sampler: &mut Sampler) -> bool {
        let weight = self.start.weight * self.densities(At::Collision).weight() / self.survived;
        let survival = weight.max_element() / ROULETTE_BELOW;
        if survival >= 1.0 {
            return true;
        }
        let survives = sampler.random() < survival;
        if survives {
            self.survived *= survival;
        }
        survives
    }

    /// Lets the visitor sample light, then draws a direction; its solid-angle pdf under the whole mixture.
    fn scatter_lit(&mut self, p: Vec3, visitor: &mut impl Visitor, sampler: &mut Sampler) -> f32 {
        let densities = self.densities(At::Collision);
        let (d, g) = (self.prefix.last, self.medium.medium.g);
        let scatter = |wi: Vec3| {
            let phase = phase_eval(g, d.dot(wi));
            (phase, self.techniques.direction_pdf(self.medium, &self.prefix, &densities, phase, wi))
        };
        let weight = self.start.weight * densities.weight() / self.survived;
        visitor.collide(&Collision { p, weight, walked: Some(weight), role: Role::Own, scatter: &scatter }, sampler);
        let wi = self.direction(sampler);
        let (_, pdf) = scatter(wi);
        self.prefix.last = wi;
        pdf
    }

    /// The distance `t` led out of the boundary: it decides the leak, so the densities are those of the collision there.
    fn leak(mut self, t: f32, stats: &mut WalkStats) -> MixtureEnd<H> {
        if !t.is_finite() {
            return self.end(WalkEnd::Leaked, At::Boundary, stats);
        }
        self.travel(t);
        self.prefix.collisions += 1;
        self.end(WalkEnd::Leaked, At::Collision, stats)
    }

    /// An end without light.
    fn end(&self, end: WalkEnd<H>, at: At, stats: &mut WalkStats) -> MixtureEnd<H> {
        stats.count(&end);
        MixtureEnd { end, technique: self.drawn, densities: self.densities(at) }
    }
}
