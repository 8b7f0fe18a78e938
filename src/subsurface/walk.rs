//! The classical random walk with balance-heuristic spectral MIS over RGB.
//!
//! A walk runs from a boundary point to the next boundary point; what happens there is the caller's
//! matter. Distances are drawn for one channel, chosen anew at every vertex in proportion to what the
//! channels still carry, and weighted by the mixture of all three (guiding.md section 1.2): unbiased for
//! any albedo in [0, 1] and any ratio of mean free paths, since the choice depends on the prefix only.

use crate::math::Rgb;
use crate::medium::{Medium, phase_eval, phase_sample};
use crate::sampling::sampler::Sampler;
use glam::{Vec2, Vec3};

/// A closed boundary seen from inside: a mesh instance, or a slab in tests.
pub trait Enclosure {
    /// What identifies a boundary point to the caller.
    type Hit: Copy;

    /// First boundary along p + t d, 0 < t < `t_max`; `d` unit. `from` is the boundary point that the
    /// segment starts on (within rounding), if it does, and is not hit again.
    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<Self::Hit>) -> Option<(f32, Self::Hit)>;

    /// Whether a point can still be inside; false ends a walk that leaked.
    fn bounds_contain(&self, p: Vec3) -> bool;

    /// Bound of the absolute rounding error of positions, same length unit as the walk.
    fn position_error(&self) -> f32;
}

/// A scattering vertex, as handed to the caller (for next-event estimation through matched boundaries).
#[derive(Debug, Clone, Copy)]
pub struct Collision {
    pub p: Vec3,
    /// Direction in which light (path) travels into the collision.
    pub d: Vec3,
    /// Start weight and that of the walk so far, this collision's albedo included.
    pub weight: Rgb,
}

/// How a walk ended.
#[derive(Debug, Clone, Copy)]
pub enum WalkEnd<H> {
    /// At boundary point `hit`, `p`, travelling along `d`; `weight` includes that of the start. `scattered` is the last collision and the
    /// solid-angle pdf with which it chose `d`; `None` if the walk never scattered.
    Boundary { hit: H, p: Vec3, d: Vec3, weight: Rgb, scattered: Option<(Vec3, f32)> },
    /// Nothing left to carry.
    Absorbed,
    /// Outside of the boundary without having crossed it: an open or self-intersecting mesh.
    Leaked,
    /// The safety net of `MAX_STEPS`.
    TooLong,
}

/// Counts for the statistics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WalkStats {
    pub walks: u64,
    pub steps: u64,
    pub leaked: u64,
    pub too_long: u64,
}

impl WalkStats {
    pub fn add(&mut self, other: &WalkStats) {
        self.walks += other.walks;
        self.steps += other.steps;
        self.leaked += other.leaked;
        self.too_long += other.too_long;
    }
}

/// Safety net, counted. At albedo 1 and optical thickness 1000 one walk in a thousand is longer.
const MAX_STEPS: u64 = 1 << 20;

/// Share of a channel's weight that its choice keeps at albedo 0: a channel that only absorbs is still
/// seen through the medium, and never drawing it would leave that light to other channels' distances,
/// whose weights are unbounded where their mean free path is shorter.
const MIN_CHOICE: f32 = 0.05;

/// A boundary closer than this many position errors behind a collision pushes it back by as much, so
/// that rounding does not put the vertex outside.
const MARGIN: f32 = 4.0;

/// Within this many position errors of the entry the surface is its tangent plane, and the depth below
/// it is summed from the segments: a mean free path near the rounding error of world positions would
/// otherwise drown in it.
const TANGENT: f32 = 64.0;

/// Where a walk starts: on the boundary at `hit`, `p`, going along `d`; `normal` points out of the medium.
#[derive(Debug, Clone, Copy)]
pub struct Start<H> {
    pub p: Vec3,
    pub d: Vec3,
    pub normal: Vec3,
    pub hit: H,
    /// What the path carries into the walk, largest channel 1: channels are chosen by it from the start. A
    /// walk that starts again at every internal reflection would otherwise multiply weights without bound.
    pub weight: Rgb,
}

/// Walks from boundary to boundary. `collide` is called at every collision, before its direction is drawn.
pub fn walk<E: Enclosure>(
    enclosure: &E,
    medium: &Medium,
    start: Start<E::Hit>,
    sampler: &mut Sampler,
    stats: &mut WalkStats,
    mut collide: impl FnMut(&Collision, &mut Sampler),
) -> WalkEnd<E::Hit> {
    stats.walks += 1;
    let error = enclosure.position_error();
    let reach = TANGENT * error;
    let (mut p, mut d, mut weight) = (start.p, start.d, start.weight);
    let mut scattered = None;
    let mut moved = Vec3::ZERO; // since the entry, summed from segments

    for _ in 0..MAX_STEPS {
        stats.steps += 1;
        let choice = channel_choice(weight, medium.albedo);
        let t = sample_distance(medium, choice, sampler);

        // Where does the segment end: at the boundary, or at a collision before it?
        let crossing = if moved.length_squared() < reach * reach {
            crossing_near_entry(enclosure, &start, moved, d, t, reach)
        } else {
            enclosure.cast(p, d, t + MARGIN * error, None)
        };
        if let Some((t_boundary, hit)) = crossing.filter(|(t_boundary, _)| *t_boundary <= t) {
            weight *= boundary_weight(medium, choice, t_boundary);
            return WalkEnd::Boundary { hit, p: p + t_boundary * d, d, weight, scattered };
        }
        // The margin moves the vertex only; its weight is that of the distance which was drawn.
        let step = crossing.map_or(t, |(t_boundary, _)| t.min((t_boundary - MARGIN * error).max(0.5 * t)));
        if !step.is_finite() {
            stats.leaked += 1;
            return WalkEnd::Leaked;
        }
        moved += step * d;
        p = start.p + moved;
        if !enclosure.bounds_contain(p) {
            stats.leaked += 1;
            return WalkEnd::Leaked;
        }

        // Collision: weight, roulette, new direction.
        weight *= collision_weight(medium, choice, t);
        match roulette(weight, sampler) {
            Some(survivor) => weight = survivor,
            None => return WalkEnd::Absorbed,
        }
        collide(&Collision { p, d, weight }, sampler);
        let wi = phase_sample(medium.g, d, Vec2::new(sampler.random(), sampler.random()));
        scattered = Some((p, phase_eval(medium.g, d.dot(wi))));
        d = wi;
    }
    stats.too_long += 1;
    WalkEnd::TooLong
}

/// Probabilities of drawing the distance for each channel; sums to 1.
fn channel_choice(weight: Rgb, albedo: Rgb) -> Rgb {
    let q = weight * albedo.max(Rgb::splat(MIN_CHOICE));
    q / (q.x + q.y + q.z)
}

/// Free flight of the chosen channel; infinite in a channel without extinction.
fn sample_distance(medium: &Medium, choice: Rgb, sampler: &mut Sampler) -> f32 {
    let u = sampler.random();
    let sigma_t = if u < choice.x {
        medium.sigma_t.x
    } else if u < choice.x + choice.y {
        medium.sigma_t.y
    } else {
        medium.sigma_t.z
    };
    let depth = -sampler.random_open().ln();
    if sigma_t > 0.0 { depth / sigma_t } else { f32::INFINITY }
}

/// f / pdf of a collision at distance `t`: alpha sigma_t E over the mixture of the channels' densities.
fn collision_weight(medium: &Medium, choice: Rgb, t: f32) -> Rgb {
    let density = medium.sigma_t * medium.transmittance(t);
    medium.albedo * density / choice.dot(density)
}

/// f / pdf of reaching a boundary at distance `t`: E over the mixture of the channels' probabilities.
fn boundary_weight(medium: &Medium, choice: Rgb, t: f32) -> Rgb {
    let transmittance = medium.transmittance(t);
    transmittance / choice.dot(transmittance)
}

/// Survival with probability max_c weight_c: the best threshold measured for classical walks
/// (mixture_3d.md section 1). Weight above 1 always survives.
fn roulette(weight: Rgb, sampler: &mut Sampler) -> Option<Rgb> {
    let survival = weight.max_element();
    if survival >= 1.0 {
        return Some(weight);
    }
    (sampler.random() < survival).then(|| weight / survival)
}

/// First crossing for a segment that starts within `reach` of the entry, where the surface is its tangent
/// plane and the depth below it is known from the displacement `moved` better than from the position.
fn crossing_near_entry<E: Enclosure>(
    enclosure: &E,
    start: &Start<E::Hit>,
    moved: Vec3,
    d: Vec3,
    t: f32,
    reach: f32,
) -> Option<(f32, E::Hit)> {
    let approach = d.dot(start.normal);
    let p = start.p + moved;
    if approach <= 0.0 {
        return if t < reach { None } else { enclosure.cast(p, d, t, Some(start.hit)) };
    }
    let t_plane = (-moved.dot(start.normal) / approach).max(0.0);
    let plane = (t_plane <= t).then_some((t_plane, start.hit));
    if t.min(t_plane) < reach { plane } else { enclosure.cast(p, d, t, None).or(plane) }
}
