//! Homogeneous participating media: coefficients and the phase function.

use crate::math::{Frame, PI, Rgb, TAU};
use glam::{Vec2, Vec3};

/// A homogeneous medium, coefficients per channel in 1 / stage unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Medium {
    pub sigma_t: Rgb,
    /// Single-scattering albedo, 0..=1.
    pub albedo: Rgb,
    /// Mean cosine of the Henyey-Greenstein phase function, -1 < g < 1.
    pub g: f32,
}

impl Medium {
    /// Beer-Lambert transmittance over `t` stage units; 1 for an infinite distance through vacuum.
    pub fn transmittance(&self, t: f32) -> Rgb {
        // 0 * inf is NaN, and a channel without extinction is clear at any distance.
        let depth = self.sigma_t * t;
        crate::math::exp(-Vec3::select(self.sigma_t.cmpeq(Vec3::ZERO), Vec3::ZERO, depth))
    }

    /// Whether light in it ever changes direction.
    pub fn scatters(&self) -> bool {
        (self.sigma_t * self.albedo).max_element() > 0.0
    }
}

/// Henyey-Greenstein phase function, 1/sr; `cos_theta` between travelling directions.
pub fn phase_eval(g: f32, cos_theta: f32) -> f32 {
    let denominator = 1.0 + g * g - 2.0 * g * cos_theta;
    // Rounding can reach zero only for |g| -> 1 straight ahead; the floor keeps the peak finite.
    let denominator = denominator.max(1e-12);
    (1.0 - g * g) / (4.0 * PI * denominator * denominator.sqrt())
}

/// Direction after scattering of light travelling along `d`; solid-angle pdf is [`phase_eval`].
pub fn phase_sample(g: f32, d: Vec3, u: Vec2) -> Vec3 {
    // Below 1e-3 the inversion divides by a cancelled difference, and HG is isotropic to 0.3 %: use its
    // first-order form 1 + 3 g cos, whose inverse is mu + 3 g (mu^2 - 1) / 2 with mu = 2u - 1 to O(g^2).
    let mu = 2.0 * u.x - 1.0;
    let cos_theta = if g.abs() < 1e-3 {
        mu + 1.5 * g * (1.0 - mu * mu)
    } else {
        let s = (1.0 - g * g) / (1.0 + g * mu);
        (1.0 + g * g - s * s) / (2.0 * g)
    }
    .clamp(-1.0, 1.0); // rounding at the poles
    let sin_theta = (1.0 - cos_theta * cos_theta).max(0.0).sqrt();
    let (sin_phi, cos_phi) = (TAU * u.y).sin_cos();
    Frame::from_normal(d).to_world(Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
}
