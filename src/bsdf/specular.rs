//! A compiled reflection lobe: roughness, Fresnel curve, and the directional albedo that layering needs.

use super::albedo::Curve;
use super::curves::{Curves, Key, Of};
use super::fresnel::Fresnel;
use super::ggx::{Ggx, Glossy, Masking, SMOOTH_ALPHA};
use super::lobe::Lobe;
use crate::math::Rgb;

/// Directional albedo of the lobe, by the kind of its Fresnel curve.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Albedo {
    /// A mirror: the Fresnel curve itself.
    Smooth,
    Dielectric(Curve),
    /// With F = 1 and with F = (1 - cos)^5, from which every Schlick curve is a linear combination.
    Schlick {
        full: Curve,
        grazing: Curve,
    },
    /// With F = 1; the rest is given back to the lobe.
    Metal {
        full: Curve,
    },
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Specular {
    alpha: f32,
    fresnel: Fresnel,
    masking: Masking,
    albedo: Albedo,
}

impl Specular {
    /// `alpha` is the square of the authored roughness; below [`SMOOTH_ALPHA`] the lobe is a mirror. Metals
    /// ([`Fresnel::F82`], [`Fresnel::Conductor`]) get back what facets scatter more than once.
    pub fn new(alpha: f32, fresnel: Fresnel, masking: Masking, curves: &mut Curves) -> Self {
        let mut curve = |of, eta| curves.get(Key { of, masking, alpha, eta });
        let albedo = match fresnel {
            _ if alpha < SMOOTH_ALPHA => Albedo::Smooth,
            Fresnel::Dielectric { eta: 1.0 } => Albedo::Dielectric(Curve::ZERO),
            Fresnel::Dielectric { eta } => Albedo::Dielectric(curve(Of::Dielectric, eta)),
            Fresnel::Schlick { .. } => Albedo::Schlick { full: curve(Of::Full, 1.0), grazing: curve(Of::Grazing, 1.0) },
            Fresnel::F82 { .. } | Fresnel::Conductor { .. } => Albedo::Metal { full: curve(Of::Full, 1.0) },
        };
        Self { alpha, fresnel, masking, albedo }
    }

    /// Share of light reflected towards the cosine `mu` (for rough metals an estimate, used for sampling only).
    pub fn albedo(&self, mu: f32) -> Rgb {
        match (self.albedo, self.fresnel) {
            (Albedo::Dielectric(curve), _) => Rgb::splat(curve.at(mu).clamp(0.0, 1.0)),
            (Albedo::Schlick { full, grazing }, Fresnel::Schlick { f0, f90 }) => {
                let (full, grazing) = (full.at(mu), grazing.at(mu));
                (f0 * (full - grazing) + f90 * grazing).clamp(Rgb::ZERO, Rgb::ONE)
            }
            (_, fresnel) => fresnel.at(mu),
        }
    }

    pub fn lobe(&self, mu: f32) -> Lobe {
        let scale = match self.albedo {
            Albedo::Smooth => return Lobe::Mirror(self.fresnel),
            // Turquin 2019, eq. 16: exactly white for F = 1, coloured by F0 else.
            Albedo::Metal { full } => {
                let full = full.at(mu);
                Rgb::ONE + self.fresnel.at(1.0) * ((1.0 - full) / full)
            }
            Albedo::Dielectric(_) | Albedo::Schlick { .. } => Rgb::ONE,
        };
        let (ggx, fresnel, masking) = (Ggx { alpha: self.alpha }, self.fresnel, self.masking);
        Lobe::Glossy(Glossy { ggx, fresnel, masking, scale })
    }
}
