//! Rough diffuse reflection: the energy-preserving Oren-Nayar model (EON) of OpenPBR, Lambert at roughness 0.
//!
//! Portsmouth, Kutz, Hill 2025, "EON: A Practical Energy-Preserving Rough Diffuse BRDF", JCGT 14(1).

use crate::math::{FRAC_1_PI, PI, Rgb};
use glam::Vec3;

/// Reciprocal; a white `rho` reflects everything at every roughness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Diffuse {
    /// Albedo of the facets; the albedo of the surface at roughness 0.
    pub rho: Rgb,
    /// sigma in [0, 1].
    pub roughness: f32,
}

impl Diffuse {
    pub fn lambert(rho: Rgb) -> Self {
        Self { rho, roughness: 0.0 }
    }

    /// f * cos on the upper hemisphere.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Rgb {
        if wi.z <= 0.0 {
            return Rgb::ZERO;
        }
        if self.roughness == 0.0 {
            return self.rho * (FRAC_1_PI * wi.z);
        }
        (self.single(wo, wi) + self.multiple(wo, wi)) * (FRAC_1_PI * wi.z)
    }

    /// Fujii's Oren-Nayar term, pi f; OpenPBR 1.1 eq. "FON_brdf".
    fn single(&self, wo: Vec3, wi: Vec3) -> Rgb {
        let s = wo.dot(wi) - wo.z * wi.z;
        let s_over_t = if s > 0.0 { s / wo.z.max(wi.z) } else { s };
        self.rho * (a(self.roughness) * (1.0 + self.roughness * s_over_t))
    }

    /// Light scattered between facets, pi f; OpenPBR 1.1 eq. "EON_comp".
    fn multiple(&self, wo: Vec3, wi: Vec3) -> Rgb {
        let mean = a(self.roughness) * (1.0 + (2.0 / 3.0 - 28.0 / (15.0 * PI)) * self.roughness);
        let rho_ms = self.rho * self.rho * mean / (Rgb::ONE - self.rho * (1.0 - mean));
        let lost = |mu: f32| 1.0 - fujii_albedo(mu, self.roughness);
        rho_ms * (lost(wo.z) * lost(wi.z) / (1.0 - mean))
    }
}

fn a(roughness: f32) -> f32 {
    1.0 / (1.0 + (0.5 - 2.0 / (3.0 * PI)) * roughness)
}

/// Directional albedo of Fujii's term for rho = 1; Portsmouth et al. 2025, eq. 14.
fn fujii_albedo(mu: f32, roughness: f32) -> f32 {
    let sin = (1.0 - mu * mu).max(0.0).sqrt();
    // (sin / mu) (1 - sin^3) with the 0 / 0 at grazing divided out.
    let ratio = sin * mu * (1.0 + sin + sin * sin) / (1.0 + sin);
    let g = sin * (mu.clamp(-1.0, 1.0).acos() - sin * mu) + 2.0 / 3.0 * (ratio - sin);
    a(roughness) * (1.0 + roughness * FRAC_1_PI * g)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed form against the integral of the single-scattering term.
    #[test]
    fn fujii_albedo_is_the_integral_of_its_term() {
        let diffuse = Diffuse { rho: Rgb::ONE, roughness: 0.7 };
        for mu in [0.05_f32, 0.3, 0.8, 1.0] {
            let wo = Vec3::new((1.0 - mu * mu).sqrt(), 0.0, mu);
            let (mut sum, n) = (0.0, 400);
            for i in 0..n {
                for j in 0..n {
                    let r2 = (i as f32 + 0.5) / n as f32;
                    let (sin, cos) = (PI * (j as f32 + 0.5) / n as f32).sin_cos();
                    let wi = Vec3::new(r2.sqrt() * cos, r2.sqrt() * sin, (1.0 - r2).sqrt());
                    sum += f64::from(diffuse.single(wo, wi).x);
                }
            }
            let integral = (sum / f64::from(n * n)) as f32;
            assert!((integral - fujii_albedo(mu, 0.7)).abs() < 3e-4, "{mu}: {integral} {}", fujii_albedo(mu, 0.7));
        }
    }
}
