//! The walk with the weight of the slab normal that it follows, or of none: classical.
//!
//! Direction and distance are drawn for one channel, chosen anew at every vertex in proportion to what the
//! channels still carry, and weighted by the mixture of all three (guiding.md section 1.2): unbiased for
//! any albedo in [0, 1] and any ratio of mean free paths, since the choice depends on the prefix only. The
//! normal may be random: its probability never enters (guiding.md section 2.6).

use super::kernel::Kernel;
use super::steps::{Enclosure, MAX_STEPS, Start, Step, Steps, WalkEnd, WalkStats};
use crate::math::Rgb;
use crate::medium::{Medium, phase_eval, phase_sample};
use crate::sampling::sampler::Sampler;
use glam::{Vec2, Vec3};

/// A scattering vertex, as handed to the caller (for next-event estimation through matched boundaries).
#[derive(Clone, Copy)]
pub struct Collision<'a> {
    pub p: Vec3,
    /// Start weight and that of the walk so far, this collision's albedo included.
    pub weight: Rgb,
    /// Phase function towards a direction, and the solid-angle pdf with which the walk goes on along it.
    pub scatter: &'a dyn Fn(Vec3) -> (f32, f32),
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
    normal: Vec3,
}

impl Guided<'_> {
    fn stretches(&self, w: Vec3) -> Rgb {
        Rgb::from_array([0, 1, 2].map(|c| self.kernels[c].stretch(self.normal, w)))
    }

    fn pdfs(&self, d: Vec3, wi: Vec3) -> Rgb {
        Rgb::from_array([0, 1, 2].map(|c| self.kernels[c].pdf(self.normal, d, wi)))
    }
}

/// Share of a channel's weight that its choice keeps at albedo 0: a channel that only absorbs is still
/// seen through the medium, and never drawing it would leave that light to other channels' distances,
/// whose weights are unbounded where their mean free path is shorter.
const MIN_CHOICE: f32 = 0.05;

/// Weight below which a guided walk plays roulette. A walk towards light behind a thick body carries
/// exp(-kappa depth) before it gets there, and roulette on that weight ruins it (guiding.md 8.5).
const GUIDED_ROULETTE: f32 = 1e-6;

/// Walks from boundary to boundary. `late` gives the slab normal at the first collision of [`Along::Late`], `collide`
/// is called at every collision, before its direction is drawn.
#[allow(clippy::too_many_arguments)] // a walk has that many independent inputs
pub fn walk<E: Enclosure>(
    enclosure: &E,
    medium: &Medium,
    along: Along,
    start: Start<E::Hit>,
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
        let first = Guided { kernels, normal };
        guided = Some(first);
        stretch = if first_distance { first.stretches(d) } else { stretch };
    }
    let mut choice = channel_choice(weight, medium.albedo);
    let mut channel = pick(choice, sampler.random());
    let mut scattered = None;
    // Of the direction of the segment under way: f / (a common factor) over the channels' pdfs of the same.
    let mut directions = Rgb::ONE;
    let threshold = if matches!(along, Along::None) { 1.0 } else { GUIDED_ROULETTE };

    for _ in 0..MAX_STEPS {
        stats.steps += 1;
        let rate = medium.sigma_t * stretch;
        let t = free_flight(rate[channel], sampler);
        match steps.advance(d, t) {
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
        match roulette(weight, threshold, sampler) {
            Some(survivor) => weight = survivor,
            None => return WalkEnd::Absorbed,
        }
        if let (Along::Late { kernels }, None) = (along, guided) {
            guided = late(steps.p, sampler).map(|normal| Guided { kernels, normal });
        }

        // A new channel, and a direction for it.
        choice = channel_choice(weight, medium.albedo);
        channel = pick(choice, sampler.random());
        let scatter = |wi: Vec3| {
            let phase = phase_eval(medium.g, d.dot(wi));
            (phase, guided.map_or(phase, |along| choice.dot(along.pdfs(d, wi))))
        };
        collide(&Collision { p: steps.p, weight, scatter: &scatter }, sampler);
        let wi = match guided {
            Some(along) => along.kernels[channel].sample(along.normal, d, sampler),
            None => phase_sample(medium.g, d, Vec2::new(sampler.random(), sampler.random())),
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

/// Exponential of the given rate; infinite in a channel without extinction.
fn free_flight(rate: f32, sampler: &mut Sampler) -> f32 {
    let depth = -sampler.random_open().ln();
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
