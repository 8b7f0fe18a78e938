//! What is known of a light, or of a cluster of them, without looking closer: box, cone of directions, intensity.
//!
//! Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.

use super::choice::{ROUNDING, Spread, facing};
use crate::math::PI;
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// Bounds that can be joined.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    pub min: Vec3,
    pub max: Vec3,
    /// Of the cone of directions, unit.
    pub axis: Vec3,
    /// Half angle of the cone, radians: of normals, or of directions that a shaped light keeps to.
    pub spread: f32,
    /// Angle beyond the cone where emission ends, radians: pi / 2, with the cosine, about normals; 0 for shaped lights.
    pub falloff: f32,
    /// Radiance, mean of the channels' magnitudes, times projected area.
    pub intensity: f64,
}

impl Bound {
    pub fn union(&self, other: &Self) -> Self {
        let (axis, spread) = join_cones((self.axis, self.spread), (other.axis, other.spread));
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            axis,
            spread,
            falloff: self.falloff.max(other.falloff),
            intensity: self.intensity + other.intensity,
        }
    }

    /// Surface area orientation heuristic: intensity times the measures of box and cone.
    pub fn cost(&self) -> f64 {
        let size = (self.max - self.min).as_dvec3();
        // A thousandth of the square keeps lights on a line, whose boxes have no area, apart.
        let area = size.x * size.y + size.y * size.z + size.z * size.x + 1e-3 * size.length_squared();
        self.intensity * area * cone_measure(f64::from(self.spread), f64::from(self.falloff))
    }
}

/// Solid angle weighted by the falloff (section 4.3).
fn cone_measure(spread: f64, falloff: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, PI, TAU};
    let (sin, cos) = spread.sin_cos();
    let end = (spread + falloff).min(PI);
    TAU * (1.0 - cos) + FRAC_PI_2 * (2.0 * end * sin - (spread - 2.0 * end).cos() - 2.0 * spread * sin + cos)
}

/// The cone that holds both, as axis and half angle.
pub fn join_cones(a: (Vec3, f32), b: (Vec3, f32)) -> (Vec3, f32) {
    let (a, b) = if a.1 >= b.1 { (a, b) } else { (b, a) };
    let between = super::shaping::angle_between(a.0, b.0);
    if (between + b.1).min(PI) <= a.1 {
        return a;
    }
    let half = 0.5 * (a.1 + between + b.1);
    let side = (b.0 - a.0 * a.0.dot(b.0)).try_normalize();
    match side {
        Some(side) if half < PI => {
            let (sin, cos) = (half - a.1).sin_cos();
            // Rounding must not leave a normal outside.
            ((a.0 * cos + side * sin).normalize(), (half + 1e-5).min(PI))
        }
        _ => (a.0, PI),
    }
}

/// A bound made ready for points to ask.
#[derive(Debug, Clone)]
pub struct Cluster {
    center: Vec3,
    /// Half the sides of the box.
    half: Vec3,
    radius: f32,
    axis: Vec3,
    sin: f32,
    cos: f32,
    cos_falloff: f32,
    intensity: f64,
}

/// How far f32 angles may be off, as a cosine of the directions that a shaped light keeps to (5e-3 radians).
const SLACK: f32 = 1e-5;

/// Share of the squared radius that a squared distance counts at least: what is near or around p is not to be trusted alone.
const NEAREST: f32 = 0.25;

impl Cluster {
    pub fn new(bound: &Bound) -> Self {
        let center = 0.5 * (bound.min + bound.max);
        let (sin, cos) = if bound.spread >= PI { (0.0, -1.0) } else { bound.spread.sin_cos() };
        // Rounding must not leave an emitting point outside its bound.
        let half = (0.5 * 1.001) * (bound.max - bound.min) + 4.0 * f32::EPSILON * center.abs().max_element();
        Self {
            center,
            half,
            radius: half.length(),
            axis: bound.axis,
            sin,
            cos,
            cos_falloff: if bound.falloff >= FRAC_PI_2 { 0.0 } else { bound.falloff.cos() },
            intensity: bound.intensity,
        }
    }

    /// Estimated irradiance at p without shadows; positive wherever light may arrive.
    #[inline]
    pub fn importance(&self, p: Vec3, n: Option<Vec3>) -> f64 {
        let to = self.center - p;
        // The box' corner that is farthest along n: the ball about it reaches further.
        if n.is_some_and(|n| n.dot(to) + n.abs().dot(self.half) < 0.0) {
            return 0.0;
        }
        // The smallest f32 keeps a cluster of no size at p finite.
        let d2 = to.length_squared().max(f32::MIN_POSITIVE);
        let nearest = NEAREST * self.radius * self.radius;
        let ball = Spread::of_ball(self.radius, d2);
        if ball.is_all() {
            return self.intensity / f64::from(d2.max(nearest));
        }
        let wi = to * d2.sqrt().recip();
        let cosines = n.map_or(1.0, |n| facing(n, wi, &ball)) * self.emission(-wi, &ball);
        self.intensity * f64::from(cosines) / f64::from(d2.max(nearest))
    }

    /// Largest cosine between a normal of the cluster and `wo`, towards a receiver that sees the cluster under `ball`.
    #[inline]
    fn emission(&self, wo: Vec3, ball: &Spread) -> f32 {
        let cos = self.axis.dot(wo).clamp(-1.0, 1.0);
        let beyond = less(((1.0 - cos * cos).sqrt(), cos), (self.sin, self.cos));
        let (_, cos) = less(beyond, (ball.sin, ball.cos));
        if cos < self.cos_falloff - SLACK { 0.0 } else { cos.max(ROUNDING) }
    }
}

/// Sine and cosine of max(0, a - b) of two angles in [0, pi], each as sine and cosine.
fn less(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    if a.1 >= b.1 { (0.0, 1.0) } else { (a.0 * b.1 - a.1 * b.0, a.1 * b.1 + a.0 * b.0) }
}
