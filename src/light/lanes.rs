//! Eight clusters of lights weighed at once: what each might give a point, in lanes of four.
//!
//! Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.

use super::{bound::Bound, choice::ROUNDING};
use crate::math::PI;
use glam::{Vec3, Vec4};
use std::f32::consts::FRAC_PI_2;

pub const LANES: usize = 8;

/// How far f32 angles may be off, as a cosine of the directions that a shaped light keeps to (5e-3 radians).
const SLACK: f32 = 1e-5;

/// Share of the squared radius that a squared distance counts at least: what is near or around p is not to be trusted alone.
const NEAREST: f32 = 0.25;

/// Of weights, relative to the brightest cluster as far away as it is large: whatever may arrive stays positive and sums finite.
const RANGE: [f32; 2] = [1e-30, 1e30];

/// Up to [`LANES`] clusters; those that are missing weigh nothing.
#[derive(Debug, Clone)]
pub struct Lanes {
    fours: [Four; LANES / 4],
    /// What a weight of 1 is as irradiance without shadows.
    pub unit: f64,
}

/// Of eight clusters.
pub struct Weights {
    pub fours: [Vec4; LANES / 4],
    /// By bit: clusters about p, of which nothing but distance and intensity counted.
    pub near: u32,
}

impl Lanes {
    pub fn new(clusters: &[Bound]) -> Self {
        let brightest = clusters.iter().map(|bound| bound.intensity).fold(0.0, f64::max);
        let radius = clusters.iter().map(|bound| Ball::of(bound).radius).fold(0.0, f32::max);
        // f32 positions at the origin, all lights in one point: any length will do.
        let square = if radius > 0.0 { f64::from(radius) * f64::from(radius) } else { 1.0 };
        let mut lanes = Self { fours: [Four::EMPTY; LANES / 4], unit: brightest / square };
        for (i, bound) in clusters.iter().enumerate() {
            let share = (bound.intensity / brightest).max(f64::from(RANGE[0]));
            lanes.fours[i / 4].set(i % 4, bound, (share * square) as f32);
        }
        lanes
    }

    /// What each cluster might give at p, in units of [`Self::unit`]: positive wherever light may arrive.
    #[inline]
    pub fn weigh(&self, p: Vec3, n: Option<Vec3>) -> Weights {
        let [(a, near_a), (b, near_b)] = [self.fours[0].weigh(p, n), self.fours[1].weigh(p, n)];
        Weights { fours: [a, b], near: near_a | near_b << 4 }
    }

    /// `irradiance` as a weight.
    pub fn weight(&self, irradiance: f64) -> f32 {
        if irradiance > 0.0 { ((irradiance / self.unit) as f32).clamp(RANGE[0], RANGE[1]) } else { 0.0 }
    }
}

/// About a cluster's box.
struct Ball {
    center: Vec3,
    half: Vec3,
    radius: f32,
}

impl Ball {
    fn of(bound: &Bound) -> Self {
        let center = 0.5 * (bound.min + bound.max);
        // Rounding must not leave an emitting point outside its bound.
        let half = (0.5 * 1.001) * (bound.max - bound.min) + 4.0 * f32::EPSILON * center.abs().max_element();
        Self { center, half, radius: half.length() }
    }
}

/// Four clusters, by component.
#[derive(Debug, Clone)]
struct Four {
    center: V3,
    /// Half the sides of the boxes.
    half: V3,
    radius: Vec4,
    /// Largest inverse of a squared distance.
    nearest: Vec4,
    /// Cones of directions.
    axis: V3,
    sin: Vec4,
    cos: Vec4,
    /// Cosine beyond the cone where emission ends.
    end: Vec4,
    /// From the plane behind which nothing arrives to the centre.
    depth: Vec4,
    /// Times a squared length of the node; 0: no cluster.
    intensity: Vec4,
}

impl Four {
    const EMPTY: Self = Self {
        center: V3::ZERO,
        half: V3::ZERO,
        radius: Vec4::ZERO,
        nearest: Vec4::ZERO,
        axis: V3::ZERO,
        sin: Vec4::ZERO,
        cos: Vec4::ZERO,
        end: Vec4::ZERO,
        depth: Vec4::ZERO,
        intensity: Vec4::ZERO,
    };

    fn set(&mut self, lane: usize, bound: &Bound, intensity: f32) {
        let ball = Ball::of(bound);
        self.center.set(lane, ball.center);
        self.half.set(lane, ball.half);
        self.axis.set(lane, bound.axis);
        self.radius[lane] = ball.radius;
        self.nearest[lane] = (NEAREST * ball.radius * ball.radius).max(f32::MIN_POSITIVE).recip();
        (self.sin[lane], self.cos[lane]) = if bound.spread >= PI { (0.0, -1.0) } else { bound.spread.sin_cos() };
        self.end[lane] = if bound.falloff >= FRAC_PI_2 { 0.0 } else { bound.falloff.cos() } - SLACK;
        self.depth[lane] = (bound.axis.dot(ball.center) - bound.plane).min(f32::MAX);
        self.intensity[lane] = intensity;
    }

    #[inline(always)]
    fn weigh(&self, p: Vec3, n: Option<Vec3>) -> (Vec4, u32) {
        let to = self.center.minus(p);
        // The smallest f32 keeps a cluster of no size at p finite.
        let inverse = to.dot(&to).max(Vec4::splat(f32::MIN_POSITIVE)).sqrt().recip();
        let wi = to.times(inverse);
        let sin = self.radius * inverse;
        let within = sin.cmpge(Vec4::ONE);
        let ball = (sin, (Vec4::ONE - sin * sin).max(Vec4::ZERO).sqrt());
        let away = self.axis.dot(&wi);
        let mut cosines = Vec4::select(within, Vec4::ONE, self.emission(-away, ball));
        let mut lit = self.intensity.cmpgt(Vec4::ZERO);
        // Rounding of positions is far below that of distances.
        lit &= away.cmple(self.depth * inverse + Vec4::splat(ROUNDING));
        if let Some(n) = n {
            // The box' corner that is farthest along n: the ball about it reaches further.
            let reach = self.half.dot(&V3::splat(n.abs()));
            let height = to.dot(&V3::splat(n)) + reach;
            lit &= height.cmpge(Vec4::ZERO);
            // Of a box about p counts what is above it.
            let above = (height / (reach + reach)).max(Vec4::splat(ROUNDING)).min(Vec4::ONE);
            let cos = wi.dot(&V3::splat(n));
            let sin = (Vec4::ONE - cos * cos).max(Vec4::ZERO).sqrt();
            cosines *= Vec4::select(within, above, mean_cosine((sin, cos), ball));
        }
        lit &= cosines.cmpgt(Vec4::ZERO);
        let weight = self.intensity * cosines * (inverse * inverse).min(self.nearest);
        let weight = weight.max(Vec4::splat(RANGE[0])).min(Vec4::splat(RANGE[1]));
        (Vec4::select(lit, weight, Vec4::ZERO), (lit & within).bitmask())
    }

    /// Cosines between a normal of the cluster and the way to a receiver that sees it within `ball`, its axis under `cos`: of
    /// parallel normals the mean, else the largest.
    #[inline(always)]
    fn emission(&self, cos: Vec4, ball: (Vec4, Vec4)) -> Vec4 {
        let cos = cos.max(Vec4::NEG_ONE).min(Vec4::ONE);
        let sin = (Vec4::ONE - cos * cos).sqrt();
        let parallel = self.cos.cmpge(Vec4::ONE) & self.end.cmplt(Vec4::ZERO);
        let (_, largest) = less(less((sin, cos), (self.sin, self.cos)), ball);
        let largest = Vec4::select(largest.cmplt(self.end), Vec4::ZERO, largest.max(Vec4::splat(ROUNDING)));
        Vec4::select(parallel, mean_cosine((sin, cos), ball), largest)
    }
}

/// Mean of max(0, cos) over what is seen within `ball` about the angle `a`, as if cosines were evenly spread between the
/// largest and the least: that of a bound would favour what is large and near the horizon. Positive where any is.
#[inline(always)]
fn mean_cosine(a: (Vec4, Vec4), ball: (Vec4, Vec4)) -> Vec4 {
    let (middle, half) = (a.1 * ball.1, a.0 * ball.0);
    let largest = Vec4::select(a.1.cmpge(ball.1), Vec4::ONE, middle + half) + Vec4::splat(ROUNDING);
    let least = middle - half;
    let largest = largest.max(Vec4::ZERO);
    let cut = largest * largest / (Vec4::splat(2.0) * (largest - least).max(Vec4::splat(ROUNDING)));
    Vec4::select(least.cmpge(Vec4::ZERO), Vec4::splat(0.5) * (largest + least), cut)
}

/// Sine and cosine of max(0, a - b) of two angles in [0, pi], each as sine and cosine.
#[inline(always)]
fn less(a: (Vec4, Vec4), b: (Vec4, Vec4)) -> (Vec4, Vec4) {
    let smaller = a.1.cmpge(b.1);
    let (sin, cos) = (a.0 * b.1 - a.1 * b.0, a.1 * b.1 + a.0 * b.0);
    (Vec4::select(smaller, Vec4::ZERO, sin), Vec4::select(smaller, Vec4::ONE, cos))
}

/// Four vectors, by component.
#[derive(Debug, Clone, Copy)]
struct V3 {
    x: Vec4,
    y: Vec4,
    z: Vec4,
}

impl V3 {
    const ZERO: Self = Self { x: Vec4::ZERO, y: Vec4::ZERO, z: Vec4::ZERO };

    #[inline]
    fn splat(v: Vec3) -> Self {
        Self { x: Vec4::splat(v.x), y: Vec4::splat(v.y), z: Vec4::splat(v.z) }
    }

    fn set(&mut self, lane: usize, v: Vec3) {
        (self.x[lane], self.y[lane], self.z[lane]) = v.into();
    }

    #[inline]
    fn minus(&self, v: Vec3) -> Self {
        Self { x: self.x - v.x, y: self.y - v.y, z: self.z - v.z }
    }

    #[inline]
    fn times(&self, s: Vec4) -> Self {
        Self { x: self.x * s, y: self.y * s, z: self.z * s }
    }

    #[inline]
    fn dot(&self, other: &Self) -> Vec4 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }
}
