//! Hair and fur: Chiang, Bitterli, Tappan, Burley 2016, "A Practical and Controllable Hair and Fur Model for Production
//! Path Tracing", with the inputs of MaterialX' `chiang_hair_bsdf`.
//!
//! A strand is a dielectric cylinder; the whole cross-section scatters at the point of entry. Light leaves after p + 1
//! meetings with its surface: reflected (R), straight through (TT), after one inner reflection (TRT), after more; each
//! is a lobe, and its share of the light the lobe's weight. Local directions: x along the strand to its tip, z the
//! normal of the cylinder, whose azimuth against `wo` is the offset across the width (h = sin(gamma_o)).
//! Without absorption all light leaves; there is no reciprocity, as in the paper.

use super::Bsdf;
use super::check::Check;
use super::fresnel::dielectric;
use super::lobe::Lobe;
use super::surface::{Base, Surface};
use crate::flat::ChiangHair;
use crate::math::{PI, Rgb, TAU, exp};
use glam::{Vec2, Vec3};

/// Least longitudinal variance, a lobe of 0.2 degrees: sines and cosines in f32 have no finer one.
const MIN_VARIANCE: f32 = 1e-5;
/// Least azimuthal scale, 0.1 degrees, for the same reason.
const MIN_SCALE: f32 = 1e-3;
/// Largest of both: uniform to 1 %.
const MAX_ROUGHNESS: f32 = 100.0;

/// sqrt(pi / 8): the logistic with the slope of a normal distribution at the centre of its CDF (Chiang, eq. 12).
const LOGISTIC: f32 = 0.626_657_07;

/// A strand's material: constants of all points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hair {
    eta: f32,
    /// Per radius.
    sigma_a: Rgb,
    /// R, TT, TRT and beyond.
    tints: [Rgb; 3],
    variances: [f32; 3],
    scales: [f32; 3],
    /// Sine and cosine of each lobe's shift by the scales: 2, -1, -4 times their tilt (Marschner et al. 2003).
    shifts: [Vec2; 3],
}

/// One lobe of a strand for one `wo`: product of a longitudinal and an azimuthal density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strand {
    /// Sine and cosine of the inclination of `wo`, shifted.
    sin_o: f32,
    cos_o: f32,
    variance: f32,
    /// Azimuth where the lobe is centred.
    azimuth: f32,
    /// Infinite: uniform.
    scale: f32,
}

pub fn compile(m: &ChiangHair, check: &mut Check) -> Surface {
    let hair = Hair::new(m, check);
    Surface {
        emission: Rgb::ZERO,
        color: hair.color(),
        presence: check.unit("opacity", m.opacity, 1.0),
        coat: None,
        base: Base::Hair(hair),
        interior: None,
        takes_display_color: false,
        scatters_within: false,
    }
}

impl Hair {
    fn new(m: &ChiangHair, check: &mut Check) -> Self {
        let mut rough = |name, of: [f32; 2], default| of.map(|x| check.range(name, x, 0.0, MAX_ROUGHNESS, default));
        let roughness = [
            rough("roughness_R", m.roughness_r, 0.1),
            rough("roughness_TT", m.roughness_tt, 0.05),
            rough("roughness_TRT", m.roughness_trt, 0.2),
        ];
        let tilt = (check.unit("cuticle_angle", m.cuticle_angle, 0.5) - 0.5) * PI;
        Self {
            eta: check.ior("ior", m.ior),
            sigma_a: check.radiance("absorption_coefficient", m.absorption_coefficient, Rgb::ZERO),
            tints: [
                check.radiance("tint_R", m.tint_r, Rgb::ONE),
                check.radiance("tint_TT", m.tint_tt, Rgb::ONE),
                check.radiance("tint_TRT", m.tint_trt, Rgb::ONE),
            ],
            variances: roughness.map(|[v, _]| v.max(MIN_VARIANCE)),
            scales: roughness.map(|[_, s]| s.max(MIN_SCALE) * LOGISTIC),
            shifts: [2.0, -1.0, -4.0].map(|m| Vec2::from((m * tilt).sin_cos())),
        }
    }

    /// What a mass of such strands looks like: the inverse of Chiang, eq. 9, without tints.
    fn color(&self) -> Rgb {
        let fit = color_fit(azimuthal_roughness(self.scales[0] / LOGISTIC));
        exp(-fit * Vec3::new(self.sigma_a.x.sqrt(), self.sigma_a.y.sqrt(), self.sigma_a.z.sqrt()))
    }

    /// Adds the lobes, each weighted by its share of the light (Chiang, eqs. 13 and 14).
    pub fn push(&self, bsdf: &mut Bsdf, weight: Rgb) {
        let wo = bsdf.wo;
        let (sin_o, cos_o, phi_o) = cylindrical(wo);
        // z is the normal: its azimuth is pi / 2.
        let gamma_o = phi_o - 0.5 * PI;
        // The index in the plane across the strand (Marschner et al. 2003, appendix B).
        let eta_across = (self.eta * self.eta - sin_o * sin_o).max(0.0).sqrt() / cos_o;
        let sin_gamma_t = (gamma_o.sin() / eta_across).clamp(-1.0, 1.0);
        let cos_gamma_t = (1.0 - sin_gamma_t * sin_gamma_t).sqrt();
        // An index below 1 may have no refraction along the strand; the way through is then long, not infinite.
        let cos_theta_t = (1.0 - (sin_o / self.eta) * (sin_o / self.eta)).max(1e-4).sqrt();
        let passed = exp(-self.sigma_a * (2.0 * cos_gamma_t / cos_theta_t));
        let shares = shares(dielectric(wo.z, self.eta), passed);
        for (p, share) in shares.into_iter().enumerate() {
            let of = p.min(2);
            let shift = if p < 3 { self.shifts[of] } else { Vec2::new(0.0, 1.0) };
            // 2 p gamma_t - 2 gamma_o + p pi: where a ray in the plane across leaves.
            let turn = 2.0 * p as f32 * sin_gamma_t.asin() - 2.0 * gamma_o + p as f32 * PI;
            let strand = Strand {
                sin_o: sin_o * shift.y + cos_o * shift.x,
                // Beyond the tip or the root: folded back.
                cos_o: (cos_o * shift.y - sin_o * shift.x).abs(),
                variance: self.variances[of],
                azimuth: phi_o + turn,
                scale: if p < 3 { self.scales[of] } else { f32::INFINITY },
            };
            bsdf.push(Lobe::Strand(strand), weight * self.tints[of] * share, Rgb::ONE);
        }
    }
}

/// A_p of R, TT, TRT and all beyond: Fresnel reflectance `f`, and what `passed` one way through (Chiang, eqs. 13, 14).
fn shares(f: f32, passed: Rgb) -> [Rgb; 4] {
    let through = (1.0 - f) * (1.0 - f) * passed;
    let once = through * passed * f;
    // f = 1 leaves nothing in the numerator.
    let beyond = once * passed * f / (Rgb::ONE - passed * f).max(Rgb::splat(f32::MIN_POSITIVE));
    [Rgb::splat(f), through, once, beyond]
}

/// Sine and cosine of the inclination to the plane across the strand, and the azimuth in it.
fn cylindrical(w: Vec3) -> (f32, f32, f32) {
    (w.x, (w.y * w.y + w.z * w.z).sqrt(), w.z.atan2(w.y))
}

impl Strand {
    /// Per solid angle; the integral over the sphere is 1. Also f * |cos|, for a weight of 1.
    pub fn pdf(&self, wi: Vec3) -> f32 {
        let (sin_i, cos_i, phi_i) = cylindrical(wi);
        self.longitudinal(sin_i, cos_i) * self.azimuthal(phi_i - self.azimuth)
    }

    /// A direction by [`Strand::pdf`].
    pub fn sample(&self, u_turn: f32, u: Vec2) -> Vec3 {
        let (sin_i, cos_i) = self.sample_longitudinal(u.x, u_turn);
        let (sin, cos) = (self.azimuth + self.sample_azimuthal(u.y)).sin_cos();
        Vec3::new(sin_i, cos_i * cos, cos_i * sin)
    }

    /// M_p, per cosine-weighted inclination (d'Eon et al. 2011, eq. 7): I0(a) exp(b) / (2 v sinh(1 / v)) with the
    /// exponentials of a, b and 1 / v put together, so that nothing overflows or cancels for small v.
    fn longitudinal(&self, sin_i: f32, cos_i: f32) -> f32 {
        let v = self.variance;
        let (across, along) = (cos_i - self.cos_o, sin_i + self.sin_o);
        // 1 - cos(theta_i + theta_o).
        let bent = 0.5 * (across * across + along * along);
        bessel_i0_scaled(cos_i * self.cos_o / v) * (-bent / v).exp() / (-v * (-2.0 / v).exp_m1())
    }

    /// Around the mirrored cone (d'Eon et al. 2013, eqs. 6 and 7): sine and cosine of the inclination.
    fn sample_longitudinal(&self, u: f32, u_turn: f32) -> (f32, f32) {
        let v = self.variance;
        // 1 - cos of the angle to the cone's axis; -ln(u + (1 - u) exp(-2 / v)), u in (0, 1].
        let bent = (-v * ((1.0 - u) + u * (-2.0 / v).exp()).ln()).clamp(0.0, 2.0);
        let sin = (bent * (2.0 - bent)).sqrt();
        let sin_i = (-(1.0 - bent) * self.sin_o + sin * (TAU * u_turn).cos() * self.cos_o).clamp(-1.0, 1.0);
        (sin_i, (1.0 - sin_i * sin_i).sqrt())
    }

    /// N_p: a logistic distribution cut to one turn (Chiang, eq. 12).
    fn azimuthal(&self, phi: f32) -> f32 {
        if self.scale == f32::INFINITY {
            return 1.0 / TAU;
        }
        let x = (phi - TAU * (phi / TAU).round()).abs();
        let e = (-x / self.scale).exp();
        e / (self.scale * (1.0 + e) * (1.0 + e) * (0.5 * PI / self.scale).tanh())
    }

    fn sample_azimuthal(&self, u: f32) -> f32 {
        if self.scale == f32::INFINITY {
            return TAU * u;
        }
        // The distribution function runs from 1 / (1 + exp(pi / s)) to one minus that.
        let least = 1.0 / (1.0 + (PI / self.scale).exp());
        let cdf = (least + u * (1.0 - 2.0 * least)).clamp(f32::MIN_POSITIVE, 1.0 - f32::EPSILON);
        (-self.scale * (1.0 / cdf - 1.0).ln()).clamp(-PI, PI)
    }
}

/// exp(-x) I0(x) for x >= 0, within 2e-7 (Abramowitz and Stegun 1964, 9.8.1 and 9.8.2).
fn bessel_i0_scaled(x: f32) -> f32 {
    let series = |t: f32, coefficients: &[f32]| coefficients.iter().rev().fold(0.0, |sum, c| sum * t + c);
    if x < 3.75 {
        let t = (x / 3.75) * (x / 3.75);
        return (-x).exp()
            * series(t, &[1.0, 3.515_623, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3]);
    }
    const ASYMPTOTIC: [f32; 9] = [
        0.398_942_3,
        0.013_285_92,
        0.002_253_19,
        -0.001_575_65,
        0.009_162_81,
        -0.020_577_06,
        0.026_355_37,
        -0.016_476_33,
        0.003_923_77,
    ];
    series(3.75 / x, &ASYMPTOTIC) / x.sqrt()
}

/// Factor between a colour's logarithm and the root of its absorption (Chiang, eq. 9).
fn color_fit(beta: f32) -> f32 {
    let b2 = beta * beta;
    5.969 - 0.215 * beta + 2.532 * b2 - 10.73 * b2 * beta + 5.574 * b2 * b2 + 0.245 * b2 * b2 * beta
}

/// The artist's roughness of 0 to 1 behind an azimuthal scale: the inverse of Chiang, eq. 8, by bisection.
fn azimuthal_roughness(scale: f32) -> f32 {
    let of = |beta: f32| 0.265 * beta + 1.194 * beta * beta + 5.372 * beta.powi(22);
    let halved = |(low, high): (f32, f32), _| {
        let middle = 0.5 * (low + high);
        if of(middle) < scale { (middle, high) } else { (low, middle) }
    };
    (0..16).fold((0.0, 1.0), halved).0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strand(theta: f32, variance: f32, scale: f32) -> Strand {
        Strand { sin_o: theta.sin(), cos_o: theta.cos(), variance, azimuth: 0.7, scale }
    }

    /// Integrals over inclination and azimuth are 1, for lobes of a fifth of a degree to nearly uniform ones.
    #[test]
    fn densities_are_normalised() {
        for variance in [1e-5, 1e-3, 0.02, 0.099, 0.101, 0.5, 5.0, 27.0] {
            for theta in [0.0_f32, 0.4, -1.2, 1.55] {
                let strand = strand(theta, variance, 0.1);
                let n = 200_000;
                let step = PI / n as f32;
                let at = |i: usize| f64::from(step * (i as f32 + 0.5)) - std::f64::consts::FRAC_PI_2;
                let term = |x: f64| f64::from(strand.longitudinal(x.sin() as f32, x.cos() as f32)) * x.cos();
                let sum = (0..n).map(|i| term(at(i))).sum::<f64>() * f64::from(step);
                assert!((sum - 1.0).abs() < 2e-3, "variance {variance}, theta {theta}: {sum}");
            }
        }
        for scale in [1e-3, 0.05, 0.4, 3.0, f32::INFINITY] {
            let n = 100_000;
            let step = TAU / n as f32;
            let density = |i: usize| f64::from(strand(0.0, 0.1, scale).azimuthal(step * i as f32 - 40.0));
            let sum = (0..n).map(density).sum::<f64>() * f64::from(step);
            assert!((sum - 1.0).abs() < 1e-3, "scale {scale}: {sum}");
        }
    }

    #[test]
    fn bessel_matches_its_integral() {
        // I0(x) = 1 / pi int_0^pi exp(x cos t) dt.
        for x in [0.0_f64, 0.5, 3.7, 3.8, 12.0, 300.0, 1e5] {
            let n = 200_000;
            let step = std::f64::consts::PI / f64::from(n);
            let mean =
                (0..n).map(|i| (x * (((f64::from(i) + 0.5) * step).cos() - 1.0)).exp()).sum::<f64>() / f64::from(n);
            assert!((f64::from(bessel_i0_scaled(x as f32)) / mean - 1.0).abs() < 3e-6, "{x}");
        }
    }

    /// Light that is reflected, passes, or goes round is all there is.
    #[test]
    fn shares_add_up() {
        for f in [0.0, 0.04, 0.5, 0.999, 1.0] {
            let sum: Rgb = shares(f, Rgb::ONE).into_iter().sum();
            assert!((sum - 1.0).abs().max_element() < 1e-5, "{f}: {sum}");
            let dark: Rgb = shares(f, Rgb::ZERO).into_iter().sum();
            assert_eq!(dark, Rgb::splat(f));
        }
    }

    #[test]
    fn roughness_is_found_behind_its_scale() {
        for beta in [0.05_f32, 0.3, 0.8, 0.98] {
            let scale = 0.265 * beta + 1.194 * beta * beta + 5.372 * beta.powi(22);
            assert!((azimuthal_roughness(scale) - beta).abs() < 1e-3, "{beta}");
        }
    }
}
