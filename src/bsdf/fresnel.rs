//! Fresnel reflectance of dielectrics, of metals by their authored colours, and Snell refraction.

use crate::math::Rgb;
use glam::Vec3;

/// How much a microfacet reflects, by the cosine between it and the direction of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fresnel {
    /// Exact, unpolarised; `eta` is the index of the far side over that of the side of sight.
    Dielectric { eta: f32 },
    /// Schlick 1994 between reflectance at normal (`f0`) and at grazing incidence (`f90`).
    Schlick { f0: Rgb, f90: Rgb },
    /// "F82-tint" of OpenPBR 1.1 (Kutz et al. 2021): Schlick from `f0` minus `b * cos * (1 - cos)^6`, times `weight`.
    F82 { f0: Rgb, b: Rgb, weight: f32 },
    /// Exact conductor with complex index n + i k per channel.
    Conductor { n: Rgb, k: Rgb },
}

impl Fresnel {
    /// From the reflectance `f0`, the tint of the Schlick curve at about 82 degrees, and an overall weight.
    pub fn f82_tint(f0: Rgb, tint: Rgb, weight: f32) -> Self {
        const COS: f32 = 1.0 / 7.0;
        let b = schlick(f0, Rgb::ONE, COS) * (Rgb::ONE - tint) / (COS * (1.0 - COS).powi(6));
        Self::F82 { f0, b, weight }
    }

    /// From reflectivity and edge tint: Gulbrandsen 2014, "Artist Friendly Metallic Fresnel", eqs. 13 to 16.
    pub fn artistic_conductor(reflectivity: Rgb, edge: Rgb) -> Self {
        // Reflectivity 1 asks for an infinite index; this is the largest that keeps f32 finite and F within 1e-4.
        let r = reflectivity.clamp(Rgb::ZERO, Rgb::splat(0.9999));
        let sqrt = Rgb::new(r.x.sqrt(), r.y.sqrt(), r.z.sqrt());
        let n_min = (Rgb::ONE - r) / (Rgb::ONE + r);
        let n_max = (Rgb::ONE + sqrt) / (Rgb::ONE - sqrt);
        let n = edge * n_min + (Rgb::ONE - edge) * n_max;
        let k2 = (r * (n + 1.0) * (n + 1.0) - (n - 1.0) * (n - 1.0)) / (Rgb::ONE - r);
        let k2 = k2.max(Rgb::ZERO); // rounding can leave -1e-7
        Self::Conductor { n, k: Rgb::new(k2.x.sqrt(), k2.y.sqrt(), k2.z.sqrt()) }
    }

    /// Reflectance in [0, 1]; `cos` in [0, 1].
    pub fn at(&self, cos: f32) -> Rgb {
        match *self {
            Self::Dielectric { eta } => Rgb::splat(dielectric(cos, eta)),
            Self::Schlick { f0, f90 } => schlick(f0, f90, cos),
            Self::F82 { f0, b, weight } => {
                let f = schlick(f0, Rgb::ONE, cos) - b * (cos * (1.0 - cos).max(0.0).powi(6));
                weight * f.clamp(Rgb::ZERO, Rgb::ONE)
            }
            Self::Conductor { n, k } => {
                Rgb::new(conductor(cos, n.x, k.x), conductor(cos, n.y, k.y), conductor(cos, n.z, k.z))
            }
        }
    }
}

/// (1 - cos)^5, the shape of Schlick's approximation.
pub fn schlick_weight(cos: f32) -> f32 {
    (1.0 - cos).max(0.0).powi(5)
}

fn schlick(f0: Rgb, f90: Rgb, cos: f32) -> Rgb {
    f0.lerp(f90, schlick_weight(cos))
}

/// Unpolarised reflectance of a smooth dielectric; 1 beyond the critical angle. `cos` in [0, 1] on the side of
/// sight, `eta` = index of the far side / index of the side of sight. (Pharr et al. 2023, section 9.3.5.)
pub fn dielectric(cos: f32, eta: f32) -> f32 {
    let cos = cos.clamp(0.0, 1.0);
    let sin2_t = (1.0 - cos * cos) / (eta * eta);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    if cos + cos_t <= 0.0 {
        return 1.0; // exactly grazing with eta = 1: the limit of both amplitudes is 0 / 0
    }
    let parallel = (eta * cos - cos_t) / (eta * cos + cos_t);
    let perpendicular = (cos - eta * cos_t) / (cos + eta * cos_t);
    0.5 * (parallel * parallel + perpendicular * perpendicular)
}

/// Unpolarised reflectance of a conductor n + i k (Lagarde 2013, "Memo on Fresnel equations").
fn conductor(cos: f32, n: f32, k: f32) -> f32 {
    let cos = cos.clamp(0.0, 1.0);
    let (cos2, n2, k2) = (cos * cos, n * n, k * k);
    let sin2 = 1.0 - cos2;
    let t0 = n2 - k2 - sin2;
    let a2_b2 = (t0 * t0 + 4.0 * n2 * k2).sqrt();
    let a = (0.5 * (a2_b2 + t0)).max(0.0).sqrt();
    let (t1, t2) = (a2_b2 + cos2, 2.0 * a * cos);
    let rs = (t1 - t2) / (t1 + t2);
    let (t3, t4) = (cos2 * a2_b2 + sin2 * sin2, t2 * sin2);
    let rp = rs * (t3 - t4) / (t3 + t4);
    (0.5 * (rs + rp)).clamp(0.0, 1.0)
}

/// Reflectance at normal incidence.
pub fn f0(eta: f32) -> f32 {
    let r = (eta - 1.0) / (eta + 1.0);
    r * r
}

/// OpenPBR 1.1 eq. "modulated_ior": the index whose reflectance at normal incidence is `weight` times that of `eta`.
pub fn modulated_eta(eta: f32, weight: f32) -> f32 {
    if weight == 1.0 {
        return eta; // exactly
    }
    // 0.99 keeps the index below 400, where its reflectance no longer changes visibly.
    let epsilon = (weight * f0(eta)).sqrt().min(0.99).copysign(eta - 1.0);
    (1.0 + epsilon) / (1.0 - epsilon)
}

/// Mirror direction about `h`; both point away from the surface.
pub fn reflect(wo: Vec3, h: Vec3) -> Vec3 {
    2.0 * wo.dot(h) * h - wo
}

/// Refracted direction, away from the surface on the far side of the facet `h` (with `wo . h > 0`); `None` under
/// total internal reflection. `eta` as in [`dielectric`].
pub fn refract(wo: Vec3, h: Vec3, eta: f32) -> Option<Vec3> {
    let cos = wo.dot(h);
    let sin2_t = (1.0 - cos * cos).max(0.0) / (eta * eta);
    if sin2_t >= 1.0 {
        return None;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    Some((h * (cos / eta - cos_t) - wo / eta).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dielectric_knows_its_textbook_values() {
        assert!((dielectric(1.0, 1.5) - 0.04).abs() < 1e-6);
        assert!((dielectric(1.0, 1.0 / 1.5) - 0.04).abs() < 1e-6);
        // Hecht, Optics: air to glass (1.5) at 60 degrees, R_s = 0.17663, R_p = 0.00180.
        assert!((dielectric(0.5, 1.5) - 0.0892).abs() < 1e-4);
        // Brewster: at tan = 1.5 only the perpendicular half is left, ((1 - n^2) / (1 + n^2))^2 / 2.
        let brewster = 1.0 / (1.0_f32 + 2.25).sqrt();
        assert!((dielectric(brewster, 1.5) - 0.5 * (1.25_f32 / 3.25).powi(2)).abs() < 1e-6);
        assert_eq!(dielectric(0.74, 1.0 / 1.5), 1.0, "beyond the critical cosine 0.7454");
        assert!(dielectric(0.75, 1.0 / 1.5) < 0.9);
        assert_eq!(dielectric(0.0, 1.5), 1.0);
        assert!(dielectric(0.5, 1.0) < 1e-12);
    }

    #[test]
    fn both_sides_of_a_dielectric_reflect_alike() {
        for eta in [1.1_f32, 1.33, 1.5, 2.4] {
            for i in 1..50 {
                let cos = i as f32 / 50.0;
                let cos_t = (1.0 - (1.0 - cos * cos) / (eta * eta)).sqrt();
                assert!((dielectric(cos, eta) - dielectric(cos_t, 1.0 / eta)).abs() < 2e-5, "{eta} {cos}");
            }
        }
    }

    #[test]
    fn metals_have_their_authored_colours() {
        let (f0, tint) = (Rgb::new(0.9, 0.6, 0.3), Rgb::new(0.8, 0.9, 1.0));
        let f82 = Fresnel::f82_tint(f0, tint, 1.0);
        assert!((f82.at(1.0) - f0).abs().max_element() < 1e-6);
        let edge = schlick(f0, Rgb::ONE, 1.0 / 7.0) * tint;
        assert!((f82.at(1.0 / 7.0) - edge).abs().max_element() < 1e-5);
        let conductor = Fresnel::artistic_conductor(f0, tint);
        assert!((conductor.at(1.0) - f0).abs().max_element() < 1e-4);
        assert!((conductor.at(0.0) - 1.0).abs().max_element() < 1e-4);
    }

    #[test]
    fn modulated_eta_scales_the_reflectance() {
        for (eta, weight) in [(1.5, 0.5), (1.5, 2.0), (0.7, 0.25), (1.4, 0.0)] {
            assert!((f0(modulated_eta(eta, weight)) - weight * f0(eta)).abs() < 1e-6);
        }
        assert_eq!(modulated_eta(1.4, 1.0), 1.4);
    }

    #[test]
    fn refraction_obeys_snell() {
        let wo = Vec3::new(0.6, 0.0, 0.8);
        let wi = refract(wo, Vec3::Z, 1.5).unwrap();
        assert!((wi - Vec3::new(-0.4, 0.0, -(1.0_f32 - 0.16).sqrt())).length() < 1e-6);
        assert!(refract(Vec3::new(0.8, 0.0, 0.6), Vec3::Z, 1.0 / 1.5).is_none());
    }
}
