//! Homogeneous participating media: coefficients and the phase function.

use crate::math::{Frame, PI, Rgb, sin_cos_turns};
use crate::sampling::{UNIFORM_SPHERE_PDF, uniform_sphere};
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
    if g == 0.0 {
        return UNIFORM_SPHERE_PDF;
    }
    let denominator = 1.0 + g * g - 2.0 * g * cos_theta;
    // Rounding can reach zero only for |g| -> 1 straight ahead; the floor keeps the peak finite.
    let denominator = denominator.max(1e-12);
    (1.0 - g * g) / (4.0 * PI * denominator * denominator.sqrt())
}

/// Direction after scattering of light travelling along `d`; solid-angle pdf is [`phase_eval`].
pub fn phase_sample(g: f32, d: Vec3, u: Vec2) -> Vec3 {
    if g == 0.0 {
        return uniform_sphere(u);
    }
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
    let (sin_phi, cos_phi) = sin_cos_turns(u.y);
    Frame::from_normal(d).to_world(Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;

    const BINS: usize = 40;

    /// Integral of the phase function over directions whose cosine lies in a bin, by midpoints.
    fn bin_share(g: f32, bin: usize) -> f64 {
        const STEPS: usize = 4000;
        let width = 2.0 / (BINS * STEPS) as f64;
        let cos = |i: usize| -1.0 + (bin * STEPS + i) as f64 * width + 0.5 * width;
        (0..STEPS).map(|i| f64::from(phase_eval(g, cos(i) as f32)) * 2.0 * std::f64::consts::PI * width).sum()
    }

    /// The density integrates to 1, and directions are drawn from it: chi-square over the cosine.
    #[test]
    fn directions_follow_the_phase_function() {
        let d = Vec3::new(0.48, -0.6, 0.64);
        for (seed, g) in [-0.9, -0.4, -5e-4, 0.0, 5e-4, 0.5, 0.8, 0.95].into_iter().enumerate() {
            let shares: Vec<f64> = (0..BINS).map(|bin| bin_share(g, bin)).collect();
            let total: f64 = shares.iter().sum();
            assert!((total - 1.0).abs() < 1e-3, "g {g}: the phase function integrates to {total}");
            let (n, mut counts) = (400_000, [0_u32; BINS]);
            let mut sampler = Sampler::new(seed as u32, 0, 0);
            for _ in 0..n {
                let wi = phase_sample(g, d, Vec2::new(sampler.random(), sampler.random()));
                let bin = (0.5 * (wi.dot(d) + 1.0) * BINS as f32) as usize;
                counts[bin.min(BINS - 1)] += 1;
            }
            let chi2: f64 = counts
                .iter()
                .zip(&shares)
                .map(|(&count, share)| (f64::from(count) - share * f64::from(n)).powi(2) / (share * f64::from(n)))
                .sum();
            // Chi-square with 39 degrees of freedom exceeds 81 with probability 1e-4.
            assert!(chi2 < 81.0, "g {g}: chi-square {chi2}");
        }
    }
}
