//! How much light that enters at one cell of a boundary comes out at another: an estimate without a walk.
//!
//! Burley's normalised diffusion plus transmittance (guiding.md 2.3), or the dipole with the exact diffusion length
//! where that is more: Burley's tail decays as e^{-r / 2.7} at albedo .99 where the truth is e^{-r / 6}
//! (mixture_3d.md section 5). All in mean free paths, so that the scale of the scene does not matter.

use super::cache::Cell;
use crate::math::Rgb;
use crate::medium::Medium;
use crate::subsurface::inversion::{Illumination, multiple_scattering_albedo};
use crate::subsurface::kernel::diffusion_length;
use glam::Vec3;
use std::f32::consts::{FRAC_1_SQRT_2, PI};

/// Profile of a medium, per channel.
#[derive(Debug, Clone, Copy)]
pub struct Profile {
    /// 1 / similarity-reduced mean free path, per stage unit.
    sigma: Rgb,
    /// sigma_t of unscattered light.
    sigma_t: Rgb,
    /// Colour of a half-space in diffuse light.
    albedo: Rgb,
    /// Burley's scale.
    s: Rgb,
    /// 1 / diffusion length, in reduced mean free paths.
    kappa: Rgb,
}

/// The nearest that a far cell counts, as a share of the square root of its area: the profile diverges at 0.
const NEAREST: f32 = 0.3;

impl Profile {
    pub fn new(medium: &Medium) -> Self {
        // Similarity (guiding.md 2.3): the profiles know isotropic media only.
        let reduced = Rgb::ONE - medium.albedo * medium.g;
        let albedo = multiple_scattering_albedo(medium.albedo, medium.g, 1.0, Illumination::Diffuse);
        let length = |c: usize| diffusion_length(medium.albedo[c] * (1.0 - medium.g) / reduced[c], 0.0);
        Self {
            sigma: medium.sigma_t * reduced,
            sigma_t: medium.sigma_t,
            albedo,
            // Diffuse entry: 1.9 - A + 3.5 (A - .8)^2
            s: 1.9 - albedo + 3.5 * (albedo - 0.8) * (albedo - 0.8),
            kappa: Rgb::from_array([0, 1, 2].map(|c| 1.0 / length(c))),
        }
    }

    /// Flux out per area at a point with normal `n`, per channel, of the flux that enters at `source`.
    pub fn of_cell(&self, p: Vec3, n: Vec3, source: &Cell) -> Rgb {
        let r = (source.point - p).length().max(NEAREST * source.area.sqrt());
        // Unscattered light passes between patches that face apart (guiding.md 2.3).
        let through = if n.dot(source.normal) < FRAC_1_SQRT_2 { 1.0 } else { 0.0 };
        let unit = self.sigma * self.sigma; // mfp^-2 to per area
        let ballistic = crate::math::exp(-self.sigma_t * r) * through;
        (self.diffuse(self.sigma * r) + ballistic) * unit * source.irradiance * source.area
    }

    /// The same for the cell that the point is in: Burley's mean over a disk of its area.
    pub fn of_own(&self, own: &Cell) -> Rgb {
        let radius = (own.area / PI).sqrt();
        let x = -self.s * self.sigma * radius;
        let inside = Rgb::ONE - 0.25 * crate::math::exp(x) - 0.75 * crate::math::exp(x / 3.0);
        self.albedo * inside * own.irradiance
    }

    /// The larger of Burley's profile and the dipole's at `r` reduced mean free paths, per mfp^2.
    fn diffuse(&self, r: Rgb) -> Rgb {
        let burley = self.albedo * self.s * (crate::math::exp(-self.s * r) + crate::math::exp(-self.s * r / 3.0))
            / (8.0 * PI * r);
        burley.max(self.dipole(r))
    }

    /// Jensen et al. 2001 eq. 4, with matched boundary (A = 1, D = 1/3) and the exact diffusion length.
    fn dipole(&self, r: Rgb) -> Rgb {
        let source = |z: f32| {
            let d2 = r * r + z * z;
            let d = d2.map(f32::sqrt);
            z * (self.kappa * d + 1.0) * crate::math::exp(-self.kappa * d) / (d2 * d)
        };
        self.albedo * (source(1.0) + source(1.0 + 4.0 / 3.0)) / (4.0 * PI)
    }
}
