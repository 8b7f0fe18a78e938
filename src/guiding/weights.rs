//! How much light that enters at one cell of a boundary comes out at another: an estimate without a walk.
//!
//! Burley's normalised diffusion plus transmittance (guiding.md 2.3), or the dipole with the exact diffusion length
//! where that is more: Burley's tail decays as e^{-r / 2.7} at albedo .99 where the truth is e^{-r / 6}
//! (mixture_3d.md section 5). All in mean free paths, so that the scale of the scene does not matter.

use super::cache::Cell;
use crate::math::{Rgb, exp_in_lanes};
use crate::medium::Medium;
use crate::subsurface::inversion::{Illumination, multiple_scattering_albedo};
use crate::subsurface::kernel::diffusion_length;
use glam::Vec3;
use std::f32::consts::{FRAC_1_SQRT_2, PI};

/// A number per channel, and one over: a register holds four, and the cost of a region is that of its profiles.
type Lanes = [f32; 4];

/// Profile of a medium, per channel.
#[derive(Debug, Clone, Copy)]
pub struct Profile {
    /// 1 / similarity-reduced mean free path, per stage unit.
    sigma: Lanes,
    /// sigma_t of unscattered light.
    sigma_t: Lanes,
    /// Colour of a half-space in diffuse light.
    albedo: Lanes,
    /// Burley's scale.
    s: Lanes,
    /// 1 / diffusion length, in reduced mean free paths.
    kappa: Lanes,
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
            sigma: lanes(medium.sigma_t * reduced),
            sigma_t: lanes(medium.sigma_t),
            albedo: lanes(albedo),
            // Diffuse entry: 1.9 - A + 3.5 (A - .8)^2
            s: lanes(1.9 - albedo + 3.5 * (albedo - 0.8) * (albedo - 0.8)),
            kappa: lanes(Rgb::from_array([0, 1, 2].map(|c| 1.0 / length(c)))),
        }
    }

    /// Flux out per area at a point with normal `n`, per channel, of the flux that enters at `source`.
    pub fn of_cell(&self, p: Vec3, n: Vec3, source: &Cell) -> Rgb {
        let r = (source.point - p).length().max(NEAREST * source.area.sqrt());
        // Unscattered light passes between patches that face apart (guiding.md 2.3).
        let through = if n.dot(source.normal) < FRAC_1_SQRT_2 { 1.0 } else { 0.0 };
        let mut flux = [0.0; 4];
        for c in 0..4 {
            let unit = self.sigma[c] * self.sigma[c]; // mfp^-2 to per area
            flux[c] = (self.diffuse(c, self.sigma[c] * r) + through * fading(self.sigma_t[c] * r)) * unit;
        }
        Rgb::new(flux[0], flux[1], flux[2]) * source.irradiance * source.area
    }

    /// The same for the cell that the point is in: Burley's mean over a disk of its area.
    pub fn of_own(&self, own: &Cell) -> Rgb {
        let radius = (own.area / PI).sqrt();
        let inside = |c: usize| {
            let x = self.s[c] * self.sigma[c] * radius;
            self.albedo[c] * (1.0 - 0.25 * fading(x) - 0.75 * fading(x / 3.0))
        };
        Rgb::from_array([0, 1, 2].map(inside)) * own.irradiance
    }

    /// The larger of Burley's profile and the dipole's at `r` reduced mean free paths, per mfp^2.
    #[inline(always)]
    fn diffuse(&self, c: usize, r: f32) -> f32 {
        let third = fading(self.s[c] * r * (1.0 / 3.0));
        let burley = self.albedo[c] * self.s[c] * (third * third * third + third) / (8.0 * PI * r);
        burley.max(self.dipole(c, r))
    }

    /// Jensen et al. 2001 eq. 4, with matched boundary (A = 1, D = 1/3) and the exact diffusion length.
    #[inline(always)]
    fn dipole(&self, c: usize, r: f32) -> f32 {
        let source = |z: f32| {
            let d2 = r * r + z * z;
            let d = d2.sqrt();
            z * (self.kappa[c] * d + 1.0) * fading(self.kappa[c] * d) / (d2 * d)
        };
        self.albedo[c] * (source(1.0) + source(1.0 + 4.0 / 3.0)) / (4.0 * PI)
    }
}

fn lanes(c: Rgb) -> Lanes {
    [c.x, c.y, c.z, c.z]
}

/// exp(-x) for x >= 0, e^-87 for what is less: as a weight it is nothing.
#[inline(always)]
fn fading(x: f32) -> f32 {
    exp_in_lanes(-x.min(87.0))
}
