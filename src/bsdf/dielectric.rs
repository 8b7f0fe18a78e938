//! The boundary of a dielectric: reflection and refraction, smooth or rough, seen from either side.
//!
//! Directions are local with `wo.z > 0` on whichever side the eye is. Transmission carries radiance, so it has the
//! factor 1 / eta^2 (Veach 1997, section 5.2): entering glass divides by n^2, leaving multiplies by it.

use super::albedo::Curve;
use super::curves::{Curves, Key, Of};
use super::fresnel::{dielectric, reflect, refract};
use super::ggx::{Ggx, Masking, SMOOTH_ALPHA};
use crate::math::Rgb;
use glam::{Vec2, Vec3};

/// Below this difference from 1 a rough interface bends light by less than a milliradian and the half vector of a
/// refraction loses its digits: it is treated as smooth.
const STRAIGHT_ETA: f32 = 1e-3;

/// What one side of an interface does to light; `eta` = index of the far side / index of the side of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dielectric {
    pub eta: f32,
    pub alpha: f32,
    pub reflect_tint: Rgb,
    pub transmit_tint: Rgb,
    /// 1 / (directional albedo) at the `wo` of this vertex: what facets scatter more than once is given back in
    /// the shape of the single scattering (Turquin 2019, eq. 16, for a lossless interface). Makes a white furnace
    /// exactly white; costs reciprocity, which only the lobe with `compensation` 1 has. 1 when smooth.
    pub compensation: f32,
}

impl Dielectric {
    /// Without tints and compensation; `eta` is 1.
    pub fn bare(alpha: f32) -> Self {
        Self { eta: 1.0, alpha, reflect_tint: Rgb::ONE, transmit_tint: Rgb::ONE, compensation: 1.0 }
    }

    /// True when both lobes are single directions.
    pub fn is_smooth(&self) -> bool {
        is_smooth(self.alpha, self.eta)
    }

    fn ggx(&self) -> Ggx {
        Ggx { alpha: self.alpha }
    }

    /// The facet that carries `wo` into `wi`, with the sign of z of the side of sight; `None` if there is none
    /// (Walter et al. 2007, eqs. 13 and 16).
    fn half_vector(&self, wo: Vec3, wi: Vec3) -> Option<Vec3> {
        let reflection = wi.z > 0.0;
        let h = if reflection { wo + wi } else { wo + wi * self.eta };
        let h = h.try_normalize()?;
        let h = if h.z < 0.0 { -h } else { h };
        let faces = wo.dot(h) > 0.0 && (wi.dot(h) > 0.0) == reflection;
        (faces && wi.z != 0.0).then_some(h)
    }

    /// f * |cos|; Walter et al. 2007, eqs. 20 and 21. 0 when smooth.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Rgb {
        let Some(h) = self.half_vector(wo, wi).filter(|_| !self.is_smooth()) else {
            return Rgb::ZERO;
        };
        let fresnel = dielectric(wo.dot(h), self.eta);
        let d_g = self.ggx().d(h) * self.ggx().g2(wo, wi) * self.compensation / wo.z;
        if wi.z > 0.0 {
            return self.reflect_tint * (d_g * fresnel * 0.25);
        }
        let radiance = 1.0 / (self.eta * self.eta);
        self.transmit_tint * (d_g * (1.0 - fresnel) * wo.dot(h) * self.jacobian(wo, wi, h) * radiance)
    }

    /// Per solid angle, reflection and transmission chosen by the Fresnel reflectance of the facet. 0 when smooth.
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let Some(h) = self.half_vector(wo, wi).filter(|_| !self.is_smooth()) else {
            return 0.0;
        };
        let fresnel = dielectric(wo.dot(h), self.eta);
        let visible = self.ggx().pdf(wo, h);
        if wi.z > 0.0 {
            return visible * fresnel / (4.0 * wo.dot(h));
        }
        visible * (1.0 - fresnel) * self.jacobian(wo, wi, h)
    }

    /// d(omega_h) / d(omega_i) of a refraction (Walter et al. 2007, eq. 17).
    fn jacobian(&self, wo: Vec3, wi: Vec3, h: Vec3) -> f32 {
        let denominator = wo.dot(h) + self.eta * wi.dot(h);
        self.eta * self.eta * wi.dot(h).abs() / (denominator * denominator)
    }

    /// A direction by [`Dielectric::pdf`]; `None` where a facet sends light to the wrong side.
    pub fn sample(&self, wo: Vec3, u_choice: f32, u: Vec2) -> Option<Vec3> {
        let h = self.ggx().sample(wo, u);
        if u_choice < dielectric(wo.dot(h), self.eta) {
            return Some(reflect(wo, h)).filter(|wi| wi.z > 0.0);
        }
        refract(wo, h, self.eta).filter(|wi| wi.z < 0.0)
    }

    /// One of the two directions of a smooth interface: (wi, f, probability).
    pub fn sample_smooth(&self, wo: Vec3, u_choice: f32) -> Option<(Vec3, Rgb, f32)> {
        let fresnel = dielectric(wo.z, self.eta);
        if u_choice < fresnel {
            return Some((Vec3::new(-wo.x, -wo.y, wo.z), self.reflect_tint * fresnel, fresnel));
        }
        let radiance = 1.0 / (self.eta * self.eta);
        let share = 1.0 - fresnel;
        refract(wo, Vec3::Z, self.eta).map(|wi| (wi, self.transmit_tint * (share * radiance), share))
    }
}

/// True when an interface has single directions instead of lobes.
pub fn is_smooth(alpha: f32, eta: f32) -> bool {
    alpha < SMOOTH_ALPHA || (eta - 1.0).abs() < STRAIGHT_ETA
}

/// An interface with a medium behind it, as compiled: both sides and their directional albedos.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interface {
    /// Index of the inside / index of the outside.
    pub eta: f32,
    pub alpha: f32,
    /// Tint of the reflection seen from outside (OpenPBR: `specular_color` acts on nothing else).
    pub reflect_tint: Rgb,
    /// Tint of every crossing (OpenPBR: `transmission_color` when `transmission_depth` is 0).
    pub transmit_tint: Rgb,
    albedo_outside: Curve,
    albedo_inside: Curve,
}

impl Interface {
    pub fn new(eta: f32, alpha: f32, reflect_tint: Rgb, transmit_tint: Rgb, curves: &mut Curves) -> Self {
        let mut albedo = |eta: f32| {
            let key = Key { of: Of::Interface, masking: Masking::Smith, alpha, eta };
            if is_smooth(alpha, eta) { Curve::ONE } else { curves.get(key) }
        };
        Self { eta, alpha, reflect_tint, transmit_tint, albedo_outside: albedo(eta), albedo_inside: albedo(1.0 / eta) }
    }

    /// The same where the outside has the index `beside`, not 1. A rough one gets its albedos from the grid of [`Curves`].
    pub fn beside(&self, beside: f32) -> Self {
        let eta = self.eta / beside;
        Self::new(eta, self.alpha, self.reflect_tint, self.transmit_tint, &mut Curves::Known(&[]))
    }

    /// True when it refracts into single directions.
    pub fn is_smooth(&self) -> bool {
        is_smooth(self.alpha, self.eta)
    }

    /// As seen from outside at the cosine `mu`.
    pub fn outside(&self, mu: f32) -> Dielectric {
        Dielectric {
            eta: self.eta,
            alpha: self.alpha,
            reflect_tint: self.reflect_tint,
            transmit_tint: self.transmit_tint,
            compensation: 1.0 / self.albedo_outside.at(mu),
        }
    }

    /// As seen from inside the medium at the cosine `mu`.
    pub fn inside(&self, mu: f32) -> Dielectric {
        Dielectric {
            eta: 1.0 / self.eta,
            alpha: self.alpha,
            reflect_tint: Rgb::ONE,
            transmit_tint: self.transmit_tint,
            compensation: 1.0 / self.albedo_inside.at(mu),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;
    use crate::sampling::uniform_sphere;

    fn bare(eta: f32, alpha: f32) -> Dielectric {
        Dielectric { eta, ..Dielectric::bare(alpha) }
    }

    /// f(wo, wi) eta^2 = f(wi, wo) across the boundary (Veach 1997, eq. 5.14), f(wo, wi) = f(wi, wo) on one side.
    #[test]
    fn rough_dielectric_is_reciprocal_without_compensation() {
        let mut sampler = Sampler::new(7, 0, 0);
        let mut compared = 0;
        for (eta, alpha) in [(1.5_f32, 0.3_f32), (1.33, 0.05), (1.0 / 1.5, 0.6), (2.4, 1.0)] {
            for _ in 0..2000 {
                let wo = uniform_sphere(sampler.next_2d()).abs();
                let Some(wi) = bare(eta, alpha).sample(wo, sampler.random(), sampler.next_2d()) else { continue };
                if wo.z < 0.02 || wi.z.abs() < 0.02 {
                    continue; // f / cos amplifies rounding there
                }
                let forth = bare(eta, alpha).eval(wo, wi).x / wi.z.abs();
                let back = if wi.z > 0.0 {
                    bare(eta, alpha).eval(wi, wo).x / wo.z
                } else {
                    bare(1.0 / eta, alpha).eval(-wi, -wo).x / wo.z / (eta * eta)
                };
                assert!((forth - back).abs() <= 2e-3 * forth.max(back), "{eta} {alpha} {wo} {wi}: {forth} {back}");
                compared += 1;
            }
        }
        assert!(compared > 5000, "{compared}");
    }

    /// As alpha falls the rough interface becomes the smooth one.
    #[test]
    fn rough_tends_to_smooth() {
        let wo = Vec3::new(0.6, 0.0, 0.8);
        for eta in [1.5, 1.0 / 1.5, 1.33] {
            let rough = bare(eta, 2e-3);
            let smooth = bare(eta, 0.0);
            assert!(!rough.is_smooth() && smooth.is_smooth());
            for u_choice in [0.0, 0.999] {
                let (wi, f, pdf) = smooth.sample_smooth(wo, u_choice).unwrap();
                let near = rough.sample(wo, u_choice, Vec2::new(0.05, 0.3)).unwrap();
                assert!((wi - near).length() < 0.02, "{eta}: {wi} {near}");
                let weight = rough.eval(wo, near) / rough.pdf(wo, near);
                assert!((weight - f / pdf).abs().max_element() < 2e-3, "{eta}: {weight} {}", f / pdf);
            }
        }
    }
}
