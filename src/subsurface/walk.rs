//! The walk with the weight of the slab normal that it follows, or of none: classical.
//!
//! Direction and distance are drawn for one channel, chosen anew at every vertex in proportion to what the
//! channels still carry, and weighted by the mixture of all three (guiding.md section 1.2): unbiased for
//! any albedo in [0, 1] and any ratio of mean free paths, since the choice depends on the prefix only. The
//! normal may be random: its probability never enters (guiding.md section 2.6).

use super::kernel::Kernel;
use super::steps::{Enclosure, MAX_STEPS, Start, Step, Steps, WalkEnd, WalkStats};
use crate::math::{Frame, Rgb};
use crate::medium::{Medium, phase_eval, phase_sample};
use crate::sampling::sampler::Sampler;
use glam::Vec3;

/// A scattering vertex, as handed to the caller (for next-event estimation through matched boundaries).
#[derive(Clone, Copy)]
pub struct Collision<'a> {
    pub p: Vec3,
    /// Start weight and that of the walk so far, this collision's albedo included.
    pub weight: Rgb,
    /// With which the walk goes on, if it is at this collision.
    pub walked: Option<Rgb>,
    pub role: Role,
    /// Phase function towards a direction, and the solid-angle pdf with which the walk goes on along it.
    pub scatter: &'a dyn Fn(Vec3) -> (f32, f32),
}

/// What light at a collision stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// The light at this collision.
    Own,
    /// The light at any collision of the first segment, whose probability this is: drawn as if it had to collide, and
    /// weighted so.
    Segment(f32),
    /// Nothing: the walk's own collision after one drawn for the segment. Its weight is what that one would have had here.
    Counted(f32),
}

impl Role {
    /// The probability of a collision that it stands for.
    pub fn share(self) -> f32 {
        match self {
            Self::Own => 1.0,
            Self::Segment(share) | Self::Counted(share) => share,
        }
    }
}

/// The slab normal of a walk.
#[derive(Debug, Clone, Copy)]
pub enum Along<'a> {
    /// Classical.
    None,
    /// Known where the walk starts; the first distance may be drawn along it.
    Fixed { kernels: &'a [Kernel; 3], normal: Vec3, first_distance: bool },
    /// Known at the first collision.
    Late { kernels: &'a [Kernel; 3] },
}

/// Kernels along a slab normal.
#[derive(Clone, Copy)]
struct Guided<'a> {
    kernels: &'a [Kernel; 3],
    /// Of the slab normal.
    frame: Frame,
}

impl<'a> Guided<'a> {
    fn new(kernels: &'a [Kernel; 3], normal: Vec3) -> Self {
        Self { kernels, frame: Frame::from_normal(normal) }
    }

    fn stretches(&self, w: Vec3) -> Rgb {
        Rgb::from_array([0, 1, 2].map(|c| self.kernels[c].stretch(self.frame.n, w)))
    }

    fn pdfs(&self, d: Vec3, wi: Vec3) -> Rgb {
        Rgb::from_array([0, 1, 2].map(|c| self.kernels[c].pdf(self.frame.n, d, wi)))
    }
}

/// Share of a channel's weight that its choice keeps at albedo 0: a channel that only absorbs is still
/// seen through the medium, and never drawing it would leave that light to other channels' distances,
/// whose weights are unbounded where their mean free path is shorter.
const MIN_CHOICE: f32 = 0.05;

/// Probability of a collision below which none is drawn for a segment: rounding has no digits of it left.
const LEAST_SHARE: f32 = 1e-5;

/// Weight below which a guided walk plays roulette. A walk towards light behind a thick body carries
/// exp(-kappa depth) before it gets there, and roulette on that weight ruins it (guiding.md 8.5).
const GUIDED_ROULETTE: f32 = 1e-6;

/// Walks from boundary to boundary; `ahead`: a collision is drawn for the first segment before it is known whether there is
/// one. `late` gives the slab normal at the first collision of [`Along::Late`], `collide`
/// is called at every collision, before its direction is drawn.
#[allow(clippy::too_many_arguments)] // a walk has that many independent inputs
pub fn walk<E: Enclosure>(
    enclosure: &E,
    medium: &Medium,
    along: Along,
    start: Start<E::Hit>,
    ahead: bool,
    sampler: &mut Sampler,
    stats: &mut WalkStats,
    mut late: impl FnMut(Vec3, &mut Sampler) -> Option<Vec3>,
    mut collide: impl FnMut(&Collision, &mut Sampler),
) -> WalkEnd<E::Hit> {
    stats.walks += 1;
    let mut steps = Steps::new(enclosure, start);
    let (mut d, mut weight) = (start.d, start.weight);
    let (mut guided, mut stretch) = (None, Rgb::ONE);
    if let Along::Fixed { kernels, normal, first_distance } = along {
        let first = Guided::new(kernels, normal);
        guided = Some(first);
        stretch = if first_distance { first.stretches(d) } else { stretch };
    }
    let mut choice = channel_choice(weight, medium.albedo);
    let mut channel = pick(choice, sampler.next_1d());
    let mut scattered = None;
    // Of the direction of the segment under way: f / (a common factor) over the channels' pdfs of the same.
    let mut directions = Rgb::ONE;
    let threshold = if matches!(along, Along::None) { 1.0 } else { GUIDED_ROULETTE };
    // Of the first segment: what it leads to, and the probability of a collision, if light is sampled for all of it.
    let ahead = ahead && !matches!(along, Along::Late { .. });
    let mut boundary = if ahead { steps.boundary_ahead(d) } else { None };
    let rate = medium.sigma_t * stretch;
    let drawn = boundary.and_then(|(t, _)| collision_before(t, medium, rate, choice, sampler));
    let mut segment = drawn.map(|drawn| drawn.share);
    if let Some(Ahead { t, share, weight: passed }) = drawn {
        let weight = weight * passed;
        let choice = channel_choice(weight, medium.albedo);
        let scatter = |wi: Vec3| {
            let phase = phase_eval(medium.g, d.dot(wi));
            (phase, guided.map_or(phase, |along: Guided| choice.dot(along.pdfs(d, wi))))
        };
        let role = Role::Segment(share);
        collide(&Collision { p: start.p + t * d, weight, walked: None, role, scatter: &scatter }, sampler);
    }

    for _ in 0..MAX_STEPS {
        stats.steps += 1;
        sampler.begin_step();
        let rate = medium.sigma_t * stretch;
        let t = free_flight(rate[channel], sampler);
        let step = match boundary.take() {
            Some(crossing) => steps.go(d, t, Some(crossing)),
            None => steps.advance(d, t),
        };
        match step {
            Step::Boundary { t, hit } => {
                let passed = medium.transmittance(t);
                let drawn = if guided.is_some() { directions * transmittance(rate, t) } else { passed };
                weight *= passed / choice.dot(drawn);
                return WalkEnd::Boundary { hit, p: steps.p + t * d, d, weight, scattered };
            }
            Step::Leaked => {
                stats.count(&WalkEnd::<E::Hit>::Leaked);
                return WalkEnd::Leaked;
            }
            Step::Collision => {}
        }
        let passed = medium.sigma_t * medium.transmittance(t);
        let drawn = if guided.is_some() { directions * rate * transmittance(rate, t) } else { passed };
        weight *= medium.albedo * passed / choice.dot(drawn);
        let unplayed = weight;
        match roulette(weight, threshold, sampler) {
            Some(survivor) => weight = survivor,
            None => return WalkEnd::Absorbed,
        }
        if let (Along::Late { kernels }, None) = (along, guided) {
            guided = late(steps.p, sampler).map(|normal| Guided::new(kernels, normal));
        }

        // A new channel, and a direction for it.
        choice = channel_choice(weight, medium.albedo);
        channel = pick(choice, sampler.step_1d());
        let scatter = |wi: Vec3| {
            let phase = phase_eval(medium.g, d.dot(wi));
            (phase, guided.map_or(phase, |along| choice.dot(along.pdfs(d, wi))))
        };
        let (role, light) = match segment.take() {
            Some(share) => (Role::Counted(share), unplayed * share),
            None => (Role::Own, weight),
        };
        collide(&Collision { p: steps.p, weight: light, walked: Some(weight), role, scatter: &scatter }, sampler);
        let wi = match guided {
            Some(along) => along.kernels[channel].sample(&along.frame, d, sampler),
            None => phase_sample(medium.g, d, sampler.step_2d()),
        };
        let (phase, pdf) = scatter(wi);
        scattered = Some((steps.p, pdf));
        if let Some(along) = guided {
            directions = along.pdfs(d, wi) / phase;
            stretch = along.stretches(wi);
        }
        d = wi;
    }
    stats.count(&WalkEnd::<E::Hit>::TooLong);
    WalkEnd::TooLong
}

/// A collision drawn for a segment that need not have one.
#[derive(Clone, Copy)]
struct Ahead {
    t: f32,
    /// Probability that the segment has one.
    share: f32,
    /// Of the collision, over that of the segment's start, as it stands for all of them.
    weight: Rgb,
}

/// A distance as a walk with these `rate`s draws it, given that it is short of `t_boundary`.
fn collision_before(t_boundary: f32, medium: &Medium, rate: Rgb, choice: Rgb, sampler: &mut Sampler) -> Option<Ahead> {
    let stopped = Rgb::ONE - transmittance(rate, t_boundary);
    let share = choice.dot(stopped);
    if share <= LEAST_SHARE {
        return None;
    }
    let channel = pick(choice * stopped / share, sampler.random());
    let depth = -(-sampler.random() * stopped[channel]).ln_1p();
    let t = (depth / rate[channel]).min(t_boundary);
    let passed = medium.albedo * medium.sigma_t * medium.transmittance(t);
    let weight = passed * (share / choice.dot(rate * transmittance(rate, t)));
    weight.is_finite().then_some(Ahead { t, share, weight })
}

/// Exponential of the given rate; infinite in a channel without extinction.
fn free_flight(rate: f32, sampler: &mut Sampler) -> f32 {
    let depth = -sampler.step_open().ln();
    if rate > 0.0 { depth / rate } else { f32::INFINITY }
}

/// exp(-rate t); 1 over an infinite distance through vacuum.
fn transmittance(rate: Rgb, t: f32) -> Rgb {
    // 0 * inf is NaN, and a channel without extinction is clear at any distance.
    crate::math::exp(-Vec3::select(rate.cmpeq(Vec3::ZERO), Vec3::ZERO, rate * t))
}

/// Probabilities of drawing for each channel; sums to 1.
fn channel_choice(weight: Rgb, albedo: Rgb) -> Rgb {
    let q = weight * albedo.max(Rgb::splat(MIN_CHOICE));
    q / (q.x + q.y + q.z)
}

fn pick(choice: Rgb, u: f32) -> usize {
    if u < choice.x {
        0
    } else if u < choice.x + choice.y {
        1
    } else {
        2
    }
}

/// Survival with probability max_c weight_c / `threshold`. Threshold 1 is the best measured for classical walks
/// (mixture_3d.md section 1). Weight above it always survives.
fn roulette(weight: Rgb, threshold: f32, sampler: &mut Sampler) -> Option<Rgb> {
    let survival = weight.max_element() / threshold;
    if survival >= 1.0 {
        return Some(weight);
    }
    (sampler.random() < survival).then(|| weight / survival)
}
