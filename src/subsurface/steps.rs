//! The geometry of a walk: segments from a boundary point to the next one.

use crate::math::Rgb;
use bytemuck::{Pod, Zeroable};
use glam::Vec3;

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

/// How a walk ended.
#[derive(Debug, Clone, Copy)]
pub enum WalkEnd<H> {
    /// At boundary point `hit`, `p`, travelling along `d`; `weight` includes that of the start. `scattered` is the
    /// last collision and the solid-angle pdf with which it chose `d`, NaN from a walk of the mixture that keeps none;
    /// `None` if the walk never scattered.
    Boundary { hit: H, p: Vec3, d: Vec3, weight: Rgb, scattered: Option<(Vec3, f32)> },
    /// Nothing left to carry.
    Absorbed,
    /// Outside of the boundary without having crossed it: an open or self-intersecting mesh.
    Leaked,
    /// The safety net of [`MAX_STEPS`].
    TooLong,
}

/// Counts for the statistics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
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

    /// Counts an end that is no end of a walk in a closed boundary.
    pub fn count<H>(&mut self, end: &WalkEnd<H>) {
        self.leaked += u64::from(matches!(end, WalkEnd::Leaked));
        self.too_long += u64::from(matches!(end, WalkEnd::TooLong));
    }
}

/// Safety net, counted. At albedo 1 and optical thickness 1000 one walk in a thousand is longer.
pub const MAX_STEPS: u64 = 1 << 20;

/// A boundary closer than this many position errors behind a collision pushes it back by as much, so
/// that rounding does not put the vertex outside.
const MARGIN: f32 = 4.0;

/// Within this many position errors of the entry the surface is its tangent plane, and the depth below
/// it is summed from the segments: a mean free path near the rounding error of world positions would
/// otherwise drown in it.
const TANGENT: f32 = 64.0;

/// A walk under way.
pub(crate) struct Steps<'a, E: Enclosure> {
    enclosure: &'a E,
    start: Start<E::Hit>,
    /// The last vertex.
    pub p: Vec3,
    /// From the entry, summed from segments.
    moved: Vec3,
    error: f32,
}

/// What a segment led to.
pub(crate) enum Step<H> {
    /// The boundary, at distance `t`.
    Boundary {
        t: f32,
        hit: H,
    },
    Collision,
    Leaked,
}

impl<'a, E: Enclosure> Steps<'a, E> {
    pub fn new(enclosure: &'a E, start: Start<E::Hit>) -> Self {
        Self { enclosure, start, p: start.p, moved: Vec3::ZERO, error: enclosure.position_error() }
    }

    /// Goes `t` along `d`, or to the boundary before.
    pub fn advance(&mut self, d: Vec3, t: f32) -> Step<E::Hit> {
        let reach = TANGENT * self.error;
        let crossing = if self.moved.length_squared() < reach * reach {
            self.crossing_near_entry(d, t, reach)
        } else {
            self.enclosure.cast(self.p, d, t + MARGIN * self.error, None)
        };
        self.go(d, t, crossing)
    }

    /// The boundary along `d` from the entry, however far.
    pub fn boundary_ahead(&self, d: Vec3) -> Option<(f32, E::Hit)> {
        self.crossing_near_entry(d, f32::INFINITY, TANGENT * self.error)
    }

    /// [`Self::advance`] where the first `crossing` along `d`, as far as `t` at least, is known.
    pub fn go(&mut self, d: Vec3, t: f32, crossing: Option<(f32, E::Hit)>) -> Step<E::Hit> {
        if let Some((t, hit)) = crossing.filter(|(t_boundary, _)| *t_boundary <= t) {
            return Step::Boundary { t, hit };
        }
        // The margin moves the vertex only; its weight is that of the distance which was drawn.
        let step = crossing.map_or(t, |(t_boundary, _)| t.min((t_boundary - MARGIN * self.error).max(0.5 * t)));
        self.moved += step * d;
        self.p = self.start.p + self.moved;
        if step.is_finite() && self.enclosure.bounds_contain(self.p) { Step::Collision } else { Step::Leaked }
    }

    /// First crossing beyond the margin: rounding may have put the entry outside of the triangles about its own, and their
    /// outer side is no way out.
    fn cast_inward(&self, p: Vec3, d: Vec3, t: f32) -> Option<(f32, E::Hit)> {
        let margin = MARGIN * self.error;
        let (t, hit) = self.enclosure.cast(p + margin * d, d, t - margin, Some(self.start.hit))?;
        Some((t + margin, hit))
    }

    /// First crossing for a segment that starts within `reach` of the entry, where the surface is its tangent
    /// plane and the depth below it is known from the displacement `moved` better than from the position.
    fn crossing_near_entry(&self, d: Vec3, t: f32, reach: f32) -> Option<(f32, E::Hit)> {
        let start = &self.start;
        let approach = d.dot(start.normal);
        let p = start.p + self.moved;
        if approach <= 0.0 {
            return if t < reach { None } else { self.cast_inward(p, d, t) };
        }
        let t_plane = (-self.moved.dot(start.normal) / approach).max(0.0);
        let plane = (t_plane <= t).then_some((t_plane, start.hit));
        if t.min(t_plane) < reach { plane } else { self.enclosure.cast(p, d, t, None).or(plane) }
    }
}
