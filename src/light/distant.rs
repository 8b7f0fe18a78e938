//! Distant lights: a cone of directions, or a single one.

use super::{
    choice::{Spread, facing},
    emission::Emission,
};
use crate::math::{Frame, Rgb, TAU};
use glam::{Vec2, Vec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Half angle in radians below which f32 directions do not resolve the cone: it is then a single direction
/// with the irradiance of the whole cone.
const UNRESOLVED: f64 = 1e-4;

#[derive(Debug, Clone)]
pub struct Distant {
    emission: Emission,
    /// Towards the light, unit.
    axis: Vec3,
    half_angle: f32,
    /// 1 - cos of the half angle; 0 for a single direction.
    one_minus_cos: f32,
    /// Irradiance of a facing surface per unit of radiance.
    facing_irradiance: f32,
}

impl Distant {
    /// `angle`: full angle in degrees. For a single direction `emission` is the irradiance of a facing
    /// surface, which UsdLux leaves as it is for angle 0.
    pub fn new(emission: Emission, angle: f32) -> Self {
        let half_angle = half_angle(angle);
        let axis = -emission.axis;
        if half_angle < UNRESOLVED {
            let irradiance = size_factor(angle) as f32;
            let emission = emission.scaled(irradiance);
            return Self { emission, axis, half_angle: 0.0, one_minus_cos: 0.0, facing_irradiance: 1.0 };
        }
        let one_minus_cos = 2.0 * (0.5 * half_angle).sin().powi(2);
        Self {
            emission,
            axis,
            half_angle: half_angle as f32,
            one_minus_cos: one_minus_cos as f32,
            facing_irradiance: size_factor(angle) as f32,
        }
    }

    pub fn is_delta(&self) -> bool {
        self.one_minus_cos == 0.0
    }

    /// Whether it fills less than a sun does ([`super::SUN_PDF`]).
    pub fn is_narrow(&self) -> bool {
        self.is_delta() || self.cone_pdf() >= super::SUN_PDF
    }

    pub fn shines(&self) -> bool {
        self.emission.radiance != Rgb::ZERO
    }

    /// Direction and its solid-angle pdf; 1 for a single direction.
    pub fn sample(&self, u: Vec2) -> (Vec3, f32) {
        if self.is_delta() {
            return (self.axis, 1.0);
        }
        let x = u.x * self.one_minus_cos;
        let sin = (x * (2.0 - x)).max(0.0).sqrt();
        let (sin_phi, cos_phi) = (TAU * u.y).sin_cos();
        let local = Vec3::new(sin * cos_phi, sin * sin_phi, 1.0 - x);
        (Frame::from_normal(self.axis).to_world(local), self.cone_pdf())
    }

    /// Solid-angle pdf of [`Self::sample`]; 0 for a single direction, which no other sampler finds.
    pub fn pdf(&self, wi: Vec3) -> f32 {
        if self.contains(wi) { self.cone_pdf() } else { 0.0 }
    }

    /// Radiance from direction `wi`; 0 for a single direction.
    pub fn radiance(&self, wi: Vec3) -> Rgb {
        if self.contains(wi) { self.emission.towards(-wi) } else { Rgb::ZERO }
    }

    /// Radiance along a direction that `sample` gave, or irradiance where it is single.
    pub fn sampled_radiance(&self, wi: Vec3) -> Rgb {
        self.emission.towards(-wi)
    }

    pub fn importance(&self, n: Option<Vec3>) -> f32 {
        let spread = Spread::of_angle(self.half_angle);
        let cos = n.map_or(1.0, |n| facing(n, self.axis, &spread));
        // Of any direction: an estimate that is only ever too large misses no light.
        self.emission.bound(-self.axis, &Spread::of_angle(std::f32::consts::PI)) * self.facing_irradiance * cos
    }

    fn cone_pdf(&self) -> f32 {
        1.0 / (TAU * self.one_minus_cos)
    }

    /// By the squared chord |wi - axis|^2 = 2 (1 - cos), which keeps its digits for narrow cones.
    fn contains(&self, wi: Vec3) -> bool {
        !self.is_delta() && (wi - self.axis).length_squared() <= 2.0 * self.one_minus_cos
    }
}

fn half_angle(angle: f32) -> f64 {
    (0.5 * f64::from(angle).to_radians()).clamp(0.0, PI)
}

/// sizeFactor of UsdLuxLightAPI: the irradiance of a facing surface per unit of radiance.
pub fn size_factor(angle: f32) -> f64 {
    let theta = half_angle(angle);
    let sin2 = theta.sin().powi(2);
    if theta == 0.0 {
        1.0
    } else if theta <= FRAC_PI_2 {
        PI * sin2
    } else {
        PI * (2.0 - sin2)
    }
}
