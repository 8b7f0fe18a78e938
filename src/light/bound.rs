//! What is known of a light, or of a cluster of them, without looking closer: box, cone of directions, intensity.
//!
//! Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.

use crate::math::PI;
use glam::Vec3;

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
    /// Where all normals are `axis`, the least x . axis of what emits: nothing arrives behind. Else minus infinity.
    pub plane: f32,
    /// Radiance, mean of the channels' magnitudes, times projected area.
    pub intensity: f64,
}

impl Bound {
    pub fn union(&self, other: &Self) -> Self {
        let (axis, spread) = join_cones((self.axis, self.spread), (other.axis, other.spread));
        let parallel = self.axis == other.axis;
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            axis,
            spread,
            falloff: self.falloff.max(other.falloff),
            plane: if parallel { self.plane.min(other.plane) } else { f32::NEG_INFINITY },
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
