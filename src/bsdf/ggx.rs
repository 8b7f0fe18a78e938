//! The isotropic GGX (Trowbridge-Reitz) microfacet distribution and its glossy reflection lobe.
//!
//! Directions are local, z = normal; `wo.z > 0`.

use super::fresnel::{Fresnel, reflect};
use crate::math::{PI, Rgb, TAU};
use glam::{Vec2, Vec3};

/// Below this alpha a lobe is a perfect mirror: narrower than a pixel of any camera, and D overflows f32 products.
pub const SMOOTH_ALPHA: f32 = 1e-3;

/// Distribution of visible normals with roughness `alpha` (the square of the authored roughness).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ggx {
    pub alpha: f32,
}

impl Ggx {
    /// Density of facet normals `h` per solid angle and projected area (Walter et al. 2007, eq. 33). Written with
    /// the tangent so that narrow lobes keep their digits.
    pub fn d(&self, h: Vec3) -> f32 {
        let cos2 = h.z * h.z;
        let tan2 = (h.x * h.x + h.y * h.y) / cos2;
        let alpha2 = self.alpha * self.alpha;
        let t = 1.0 + tan2 / alpha2;
        if !tan2.is_finite() {
            return 0.0; // a facet on edge
        }
        1.0 / (PI * alpha2 * cos2 * cos2 * t * t)
    }

    /// Smith's Lambda (Heitz 2014, eq. 72).
    pub fn lambda(&self, w: Vec3) -> f32 {
        let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
        0.5 * ((1.0 + self.alpha * self.alpha * tan2).sqrt() - 1.0)
    }

    /// Masking of one direction.
    pub fn g1(&self, w: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(w))
    }

    /// Height-correlated masking and shadowing (Heitz 2014, eq. 99), also for transmission as in Pharr et al. 2023.
    pub fn g2(&self, wo: Vec3, wi: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(wo) + self.lambda(wi))
    }

    /// A facet normal visible from `wo` (Heitz 2018), by spherical caps (Dupuy and Benyoub 2023, listing 1).
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let std = Vec3::new(wo.x * self.alpha, wo.y * self.alpha, wo.z).normalize();
        let phi = TAU * u.y;
        let z = (1.0 - u.x) * (1.0 + std.z) - std.z;
        let sin = (1.0 - z * z).max(0.0).sqrt();
        let h = Vec3::new(sin * phi.cos(), sin * phi.sin(), z) + std;
        // z of a facet is positive; rounding may leave 0 at grazing, where the 1e-7 keeps it a direction.
        Vec3::new(h.x * self.alpha, h.y * self.alpha, h.z.max(1e-7)).normalize()
    }

    /// Pdf of [`Ggx::sample`] per solid angle of `h` (Heitz 2018, eq. 3); 0 for facets seen from behind.
    pub fn pdf(&self, wo: Vec3, h: Vec3) -> f32 {
        self.g1(wo) * wo.dot(h).max(0.0) * self.d(h) / wo.z
    }
}

/// Which masking function a reflection lobe uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Masking {
    /// Height-correlated Smith.
    Smith,
    /// Schlick's approximation with k = alpha / 2, as Storm's `previewSurface.glslfx` has it.
    Storm,
}

impl Masking {
    pub fn g2(self, ggx: Ggx, wo: Vec3, wi: Vec3) -> f32 {
        let k = 0.5 * ggx.alpha;
        let g = |cos: f32| cos / (cos * (1.0 - k) + k);
        match self {
            Self::Smith => ggx.g2(wo, wi),
            Self::Storm => g(wo.z) * g(wi.z),
        }
    }
}

/// A rough reflection: single scattering of facets. Reciprocal up to `scale`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glossy {
    pub ggx: Ggx,
    pub fresnel: Fresnel,
    pub masking: Masking,
    /// Factor for what scatters between facets more than once, at the `wo` of this vertex.
    pub scale: Rgb,
}

impl Glossy {
    /// f * cos; Walter et al. 2007, eq. 20.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Rgb {
        if wi.z <= 0.0 {
            return Rgb::ZERO;
        }
        let h = (wo + wi).normalize();
        let g = self.masking.g2(self.ggx, wo, wi);
        self.scale * self.fresnel.at(wo.dot(h)) * (self.ggx.d(h) * g / (4.0 * wo.z))
    }

    /// Per solid angle: the pdf of the half vector by the Jacobian 1 / (4 wo.h).
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        if wi.z <= 0.0 {
            return 0.0;
        }
        let h = (wo + wi).normalize();
        self.ggx.g1(wo) * self.ggx.d(h) / (4.0 * wo.z)
    }

    /// `None` where the facet reflects into the surface: that share is missing from the pdf's integral.
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let wi = reflect(wo, self.ggx.sample(wo, u));
        (wi.z > 0.0).then_some(wi)
    }
}
