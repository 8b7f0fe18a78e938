//! The medium behind a surface, in the numbers of its author.

use super::check::Check;
use crate::math::Rgb;

/// How light crosses between the outside and a medium.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Boundary {
    /// Lambertian transmission in and out, beneath the specular lobe.
    Diffuse,
    /// Reflection and refraction, smooth or rough.
    Dielectric,
    /// None: light goes straight on.
    IndexMatched,
}

impl Boundary {
    /// From USD's token.
    pub fn from_token(token: &str) -> Option<Self> {
        match token {
            "diffuse" => Some(Self::Diffuse),
            "dielectric" => Some(Self::Dielectric),
            "indexMatched" => Some(Self::IndexMatched),
            _ => None,
        }
    }
}

/// What is known of absorption.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InteriorAlbedo {
    /// Multiple-scattering albedo, the colour seen; its inversion depends on boundary and eta.
    Color(Rgb),
    /// Single-scattering albedo sigma_s / sigma_t.
    Single(Rgb),
}

/// A homogeneous medium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interior {
    pub boundary: Boundary,
    /// Index of the inside / index of the outside; 1 if index-matched.
    pub eta: f32,
    /// GGX alpha of the boundary (the square of the authored roughness).
    pub alpha: f32,
    /// Mean free path 1 / sigma_t, stage units; infinite where nothing is in the way (clear glass).
    pub radius: Rgb,
    pub albedo: InteriorAlbedo,
    /// Henyey-Greenstein mean cosine.
    pub g: f32,
}

impl Interior {
    /// Extinction per stage unit.
    pub fn sigma_t(&self) -> Rgb {
        self.radius.recip()
    }

    /// True where light meets nothing inside.
    pub fn is_clear(&self) -> bool {
        self.sigma_t() == Rgb::ZERO
    }

    /// Whether light in it ever changes direction.
    pub fn scatters(&self) -> bool {
        let (InteriorAlbedo::Color(albedo) | InteriorAlbedo::Single(albedo)) = self.albedo;
        (self.sigma_t() * albedo).max_element() > 0.0
    }

    /// With the boundary that is asked for; a dielectric with eta 1 is index-matched and the other way round.
    pub fn bounded(mut self, boundary: Boundary) -> Self {
        let matched = boundary == Boundary::IndexMatched || (boundary == Boundary::Dielectric && self.eta == 1.0);
        self.boundary = if matched { Boundary::IndexMatched } else { boundary };
        self.eta = if matched { 1.0 } else { self.eta };
        self
    }
}

/// The limits of a mean free path relative to the longest one: a channel of a thousandth already looks opaque, and
/// shorter ones cost steps (and, in f32, positions) without being seen.
const SHORTEST: f32 = 1e-4;

/// A mean free path per channel that a walk can take, or `None` if all are 0: the medium is then opaque, that is a
/// Lambertian surface of its colour.
pub fn subsurface_radius(radius: Rgb, name: &str, check: &mut Check) -> Option<Rgb> {
    let floor = SHORTEST * radius.max_element();
    if floor == 0.0 {
        check.warn(|| format!("{name} is 0 in every channel: shaded as a diffuse surface of the subsurface colour"));
        return None;
    }
    if radius.min_element() < floor {
        check.warn(|| format!("{name} {radius} has a channel below {SHORTEST} of the longest; {floor} is used there"));
    }
    Some(radius.max(Rgb::splat(floor)))
}

/// Mean free path and single-scattering albedo of a transmission medium; OpenPBR 1.1, "Translucent base", and
/// Standard Surface 1.0.1, "Transmission", which agree: sigma_t = -ln(color) / depth, sigma_s = scatter / depth, and
/// a grey shift of sigma_a where it would be negative. So any scatter from 0 means something, though the tables of both
/// end at 1 (OpenPBR's pull request 286: that range "didn't make sense"). Without depth there is no medium.
pub fn transmission(color: Rgb, depth: f32, scatter: Rgb) -> (Rgb, InteriorAlbedo) {
    if depth == 0.0 {
        return (Rgb::INFINITY, InteriorAlbedo::Single(Rgb::ZERO));
    }
    // Black would be infinitely dense; 1e-6 after one depth is as black as an image holds.
    let color = color.max(Rgb::splat(1e-6));
    // Optical thicknesses of one depth: their ratios stay finite, however small it is.
    let absorbed = -Rgb::new(color.x.ln(), color.y.ln(), color.z.ln()) - scatter;
    let absorbed = absorbed - absorbed.min_element().min(0.0);
    let thickness = absorbed + scatter;
    let albedo = Rgb::select(thickness.cmpgt(Rgb::ZERO), scatter / thickness, Rgb::ZERO);
    // The least number whose inverse is one.
    ((depth / thickness).max(Rgb::splat(f32::MIN_POSITIVE)), InteriorAlbedo::Single(albedo))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transmission_follows_openpbr() {
        let (radius, albedo) = transmission(Rgb::splat((-2.0_f32).exp()), 0.5, Rgb::splat(1.0));
        assert!((radius - 0.25).abs().max_element() < 1e-6);
        let InteriorAlbedo::Single(single) = albedo else { panic!("{albedo:?}") };
        assert!((single - 0.5).abs().max_element() < 1e-6);
    }

    #[test]
    fn negative_absorption_is_shifted_by_grey() {
        // sigma_t = (1, 2, 3), sigma_s = (2, 1, 1): sigma_a = (-1, 1, 2) becomes (0, 2, 3).
        let color = Rgb::new((-1.0_f32).exp(), (-2.0_f32).exp(), (-3.0_f32).exp());
        let (radius, albedo) = transmission(color, 1.0, Rgb::new(2.0, 1.0, 1.0));
        assert!((radius.recip() - Rgb::new(2.0, 3.0, 4.0)).abs().max_element() < 1e-5, "{radius}");
        let InteriorAlbedo::Single(single) = albedo else { panic!("{albedo:?}") };
        assert!((single - Rgb::new(1.0, 1.0 / 3.0, 0.25)).abs().max_element() < 1e-5, "{single}");
    }

    #[test]
    fn clear_and_black_media_stay_finite() {
        let (radius, _) = transmission(Rgb::ONE, 1.0, Rgb::ZERO);
        assert_eq!(radius.recip(), Rgb::ZERO);
        let (radius, albedo) = transmission(Rgb::ZERO, 1e-3, Rgb::ZERO);
        assert!(radius.min_element() > 0.0);
        assert_eq!(albedo, InteriorAlbedo::Single(Rgb::ZERO));
        assert_eq!(transmission(Rgb::splat(0.5), 0.0, Rgb::ONE).0, Rgb::INFINITY);
        let (radius, albedo) = transmission(Rgb::splat(0.5), f32::MIN_POSITIVE, Rgb::splat(1e30));
        assert!(radius.recip().is_finite());
        assert_eq!(albedo, InteriorAlbedo::Single(Rgb::ONE));
    }
}
