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

#[cfg(test)]
mod tests {
    use super::*;

    fn medium(scale: f32, g: f32) -> Medium {
        Medium { sigma_t: Rgb::new(2.0, 5.0, 20.0) / scale, albedo: Rgb::new(0.99, 0.9, 0.4), g }
    }

    fn cell(point: Vec3, normal: Vec3, scale: f32) -> Cell {
        let irradiance = Rgb::new(3.0, 2.0, 1.0);
        Cell { point: point * scale, normal, area: 0.04 * scale * scale, irradiance, lit: true }
    }

    /// Powers of two round nothing: flux per area is the same number in any unit of length.
    #[test]
    fn weights_do_not_know_the_unit_of_length() {
        let places = [(0.02, Vec3::Z), (0.3, Vec3::X), (1.0, Vec3::NEG_Z), (2.0, Vec3::NEG_Y)];
        let fluxes = |scale: f32, g: f32| {
            let profile = Profile::new(&medium(scale, g));
            let far = places.map(|(at, normal)| {
                profile.of_cell(Vec3::ZERO, Vec3::Z, &cell(Vec3::new(at, 0.5 * at, 0.0), normal, scale))
            });
            (far, profile.of_own(&cell(Vec3::ZERO, Vec3::Z, scale)))
        };
        for g in [0.0, 0.8] {
            let (far, own) = fluxes(1.0, g);
            assert!(far[0].min_element() > far[1].min_element() && far[3].min_element() > 0.0, "{far:?}");
            for scale in [1024.0, 1.0 / 1024.0] {
                assert_eq!(fluxes(scale, g), (far, own), "scale {scale}");
            }
        }
    }

    /// Light that nothing scattered passes between patches that face more than 45 degrees apart (guiding.md 2.3).
    #[test]
    fn unscattered_light_passes_between_patches_that_face_apart() {
        let medium = medium(1.0, 0.0);
        let profile = Profile::new(&medium);
        let facing = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            profile.of_cell(Vec3::ZERO, Vec3::Z, &cell(Vec3::new(0.0, 0.0, 0.5), Vec3::new(sin, 0.0, cos), 1.0))
        };
        for degrees in [10.0, 30.0, 44.0] {
            assert_eq!(facing(degrees), facing(0.0), "{degrees}");
        }
        let through = facing(180.0) - facing(0.0);
        for degrees in [46.0, 90.0, 135.0] {
            assert_eq!(facing(degrees), facing(180.0), "{degrees}");
        }
        // sigma_t^2 e^{-sigma_t r} of what enters.
        let expected = |c: usize| {
            let [sigma, e] = [medium.sigma_t[c], cell(Vec3::ZERO, Vec3::Z, 1.0).irradiance[c]].map(f64::from);
            sigma * sigma * (-sigma * 0.5).exp() * e * 0.04
        };
        for c in 0..3 {
            let ratio = f64::from(through[c]) / expected(c);
            assert!((ratio - 1.0).abs() < 1e-4, "channel {c}: {ratio}");
        }
    }

    /// More comes out near than far, of any channel; of the own cell no more than a half-space returns.
    #[test]
    fn weights_fall_with_distance() {
        let profile = Profile::new(&medium(1.0, 0.0));
        let at = |x: f32| profile.of_cell(Vec3::ZERO, Vec3::Z, &cell(Vec3::new(x, 0.0, 0.0), Vec3::Z, 1.0));
        let fluxes: Vec<Rgb> = (1..40).map(|i| at(0.1 * i as f32)).collect();
        assert!(fluxes.windows(2).all(|pair| pair[0].cmpgt(pair[1]).all()), "{fluxes:?}");
        let returned = profile.of_own(&cell(Vec3::ZERO, Vec3::Z, 1.0)) / cell(Vec3::ZERO, Vec3::Z, 1.0).irradiance;
        for c in 0..3 {
            assert!(0.0 < returned[c] && returned[c] < profile.albedo[c], "channel {c}: {returned}");
        }
    }
}
