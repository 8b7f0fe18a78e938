//! Guided sampling of directions and distances in one channel, drawn along a slab normal.
//!
//! Along n, distances are drawn with extinction sigma_t (1 - kappa mu) and directions with the eigenfunction phi of
//! the slab. The densities then telescope: over a walk of N collisions, displacement Delta (in mean free paths), first
//! and last direction w_1 and w_M, guided over non-analog classical density is
//! alpha_hat^N exp(kappa n.Delta) phi(w_M) / phi(w_1) (guiding.md sections 1.3 and 8.2).

use super::dwivedi::Dwivedi;
use super::eigenfunction::{self, Eigenfunction};
use crate::math::Frame;
use crate::medium::{phase_eval, phase_sample};
use crate::sampling::sampler::Sampler;
use crate::sampling::{UNIFORM_SPHERE_PDF, direction_in};
use glam::Vec3;
use std::sync::Arc;

/// Sampling of directions and distances of one channel, drawn along a slab normal.
#[derive(Debug, Clone)]
pub struct Kernel {
    /// 1 / nu0, per mean free path, a multiple of 2^-24; 0: the classical kernel.
    pub kappa: f32,
    /// Single-scattering albedo for which `kappa` is exact; 1 if `kappa` is 0. Not always the medium's: limits of
    /// kappa keep the numbers sound, and every pair is a valid density.
    pub alpha_hat: f32,
    /// 1 - kappa, exact.
    complement: f32,
    form: Form,
}

#[derive(Debug, Clone)]
enum Form {
    /// The phase function itself, of this g.
    Classical(f32),
    Isotropic(Dwivedi),
    Anisotropic {
        g: f32,
        eigenfunction: Arc<Eigenfunction>,
    },
}

/// Anisotropic kernels of a higher albedo are classical: with kappa below 1e-3, nothing is left to guide.
const MAX_ALBEDO: f32 = 1.0 - 1e-6;

/// Kernels of stronger anisotropy are classical: tables and series grow like 1 / (1 - |g|).
const MAX_G: f32 = 0.98;

/// Least albedo of an anisotropic kernel, raised for backward scattering: below, 1 - kappa falls under 1e-5, the
/// moments decay too slowly, and rejection takes hundreds of draws.
fn min_albedo(g: f32) -> f32 {
    0.15 + 0.4 * (-g).max(0.0)
}

impl Kernel {
    /// For single-scattering albedo 0..=1 and Henyey-Greenstein g, |g| < 1. With g != 0 it tabulates an eigenfunction,
    /// which takes milliseconds; clones share it.
    pub fn new(albedo: f32, g: f32) -> Self {
        if g == 0.0 {
            let dwivedi = Dwivedi::new(albedo);
            let Dwivedi { kappa, complement, alpha_hat, .. } = dwivedi;
            return Self { kappa, alpha_hat, complement, form: Form::Isotropic(dwivedi) };
        }
        if albedo > MAX_ALBEDO || g.abs() > MAX_G {
            return Self::classical(g);
        }
        let eigenfunction = Eigenfunction::new(albedo.max(min_albedo(g)), g);
        let Eigenfunction { kappa, complement, alpha_hat, .. } = eigenfunction;
        Self { kappa, alpha_hat, complement, form: Form::Anisotropic { g, eigenfunction: Arc::new(eigenfunction) } }
    }

    /// Directions of the phase function, distances of the medium.
    pub fn classical(g: f32) -> Self {
        Self { kappa: 0.0, alpha_hat: 1.0, complement: 1.0, form: Form::Classical(g) }
    }

    /// 1 - kappa n.w: extinction of the kernel's distances over sigma_t. Relative error of a few roundings.
    pub fn stretch(&self, n: Vec3, w: Vec3) -> f32 {
        self.stretch_at(one_minus_cos(n, w))
    }

    /// [`Kernel::stretch`] given 1 - n.w.
    pub fn stretch_at(&self, one_minus_mu: f32) -> f32 {
        self.complement + self.kappa * one_minus_mu
    }

    /// Eigenfunction at `w`, up to a factor that depends on the kernel only; isotropic: 1 / stretch.
    pub fn phi(&self, n: Vec3, w: Vec3) -> f32 {
        self.source(one_minus_cos(n, w)) / self.stretch(n, w)
    }

    /// Direction after a collision of light (path) travelling along `d`; the slab normal is that of `frame`.
    #[inline]
    pub fn sample(&self, frame: &Frame, d: Vec3, sampler: &mut Sampler) -> Vec3 {
        match &self.form {
            Form::Classical(g) => phase_sample(*g, d, sampler.step_2d()),
            Form::Isotropic(dwivedi) => direction_in(frame, dwivedi.sample(sampler.step_1d()), sampler.step_1d()),
            Form::Anisotropic { eigenfunction, .. } => eigenfunction.sample(frame, d, sampler),
        }
    }

    /// Solid-angle pdf of [`Kernel::sample`].
    pub fn pdf(&self, n: Vec3, d: Vec3, wi: Vec3) -> f32 {
        match &self.form {
            Form::Classical(g) => phase_eval(*g, d.dot(wi)),
            Form::Isotropic(_) => UNIFORM_SPHERE_PDF * (self.alpha_hat / self.stretch(n, wi)),
            // stretch phi at d is the normaliser, by the eigenfunction's equation.
            Form::Anisotropic { g, .. } => {
                self.alpha_hat * phase_eval(*g, d.dot(wi)) * self.phi(n, wi) / self.source(one_minus_cos(n, d))
            }
        }
    }

    /// [`Kernel::phi`] for eight slab normals n at once, given 1 - n.w.
    pub fn phi8(&self, one_minus_mu: &[f32; 8]) -> [f32; 8] {
        let stretch = one_minus_mu.map(|c| self.stretch_at(c));
        let source = match &self.form {
            Form::Anisotropic { eigenfunction, .. } => eigenfunction.source8(one_minus_mu),
            _ => [1.0; 8],
        };
        std::array::from_fn(|i| source[i] / stretch[i])
    }

    /// stretch phi at 1 - n.w.
    fn source(&self, one_minus_mu: f32) -> f32 {
        match &self.form {
            Form::Anisotropic { eigenfunction, .. } => eigenfunction.source(one_minus_mu),
            _ => 1.0,
        }
    }
}

/// 1 - n.w of unit vectors, without the cancellation of nearly equal ones.
fn one_minus_cos(n: Vec3, w: Vec3) -> f32 {
    0.5 * (w - n).length_squared()
}

/// nu0, decay length of light deep in a medium of single-scattering albedo 0..=1 and Henyey-Greenstein g, in mean
/// free paths: from 1 at albedo 0 to infinite at 1.
pub fn diffusion_length(albedo: f32, g: f32) -> f32 {
    (1.0 / eigenfunction::kappa(f64::from(albedo), f64::from(g))) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::direction_about;
    use std::f64::consts::TAU;

    const ALBEDOS: [f32; 7] = [0.05, 0.3, 0.8, 0.95, 0.99, 0.999, 1.0];
    const GS: [f32; 4] = [0.0, 0.5, 0.8, -0.4];

    /// A tilted normal and path directions at several angles to it.
    const N: Vec3 = Vec3::new(0.48, -0.6, 0.64);

    fn path_directions() -> [Vec3; 3] {
        [direction_about(N, 0.05, 0.3), direction_about(N, 0.9, 0.8), direction_about(N, 1.7, 0.1)]
    }

    /// Cosine bins, of equal probability under the isotropic kernel of this kappa, times azimuth bins.
    const BINS: [usize; 2] = [10, 8];
    /// Midpoints per bin and axis.
    const STEPS: usize = 48;

    /// 1 - mu at which the isotropic kernel's distribution reaches `u`, counted from mu = 1, and its slope.
    fn stratum(kernel: &Kernel, u: f64) -> (f64, f64) {
        let kappa = f64::from(kernel.kappa);
        if kappa == 0.0 {
            return (2.0 * u, 2.0);
        }
        let rate = 2.0 * kappa.atanh();
        let growth = f64::from(kernel.complement) / kappa;
        (growth * (rate * u).exp_m1(), growth * rate * (rate * u).exp())
    }

    /// Probability of a bin by quadrature of the pdf.
    fn share(kernel: &Kernel, d: Vec3, bin: [usize; 2]) -> f64 {
        let mut sum = 0.0;
        for k in 0..STEPS * STEPS {
            let at =
                |axis: usize, step: usize| (bin[axis] as f64 + (step as f64 + 0.5) / STEPS as f64) / BINS[axis] as f64;
            let (c, slope) = stratum(kernel, at(0, k % STEPS));
            sum += f64::from(kernel.pdf(N, d, direction_about(N, c as f32, at(1, k / STEPS) as f32))) * slope;
        }
        sum * TAU / (STEPS * STEPS * BINS[0] * BINS[1]) as f64
    }

    fn bin_of(kernel: &Kernel, w: Vec3) -> usize {
        let kappa = f64::from(kernel.kappa);
        let c = f64::from(one_minus_cos(N, w));
        let u = if kappa == 0.0 {
            0.5 * c
        } else {
            (c * kappa / f64::from(kernel.complement)).ln_1p() / (2.0 * kappa.atanh())
        };
        let local = crate::math::Frame::from_normal(N).to_local(w);
        let azimuth = (f64::from(local.y).atan2(f64::from(local.x)) / TAU).rem_euclid(1.0);
        let index = |u: f64, bins: usize| ((u * bins as f64) as usize).min(bins - 1);
        index(u, BINS[0]) * BINS[1] + index(azimuth, BINS[1])
    }

    /// Chi-square of counts against the pdf's integrals, which sum to 1. Sparse bins are pooled.
    fn check(kernel: &Kernel, d: Vec3, seed: u32, label: &str) {
        const COUNT: usize = 100_000;
        let bins = BINS[0] * BINS[1];
        let shares: Vec<f64> = (0..bins).map(|b| share(kernel, d, [b / BINS[1], b % BINS[1]])).collect();
        let total: f64 = shares.iter().sum();
        assert!((total - 1.0).abs() < 1e-3, "{label}: the pdf integrates to {total}");
        let mut counts = vec![0.0; bins];
        let mut sampler = Sampler::new(seed, 0, 0);
        for _ in 0..COUNT {
            let w = kernel.sample(&Frame::from_normal(N), d, &mut sampler);
            assert!((w.length() - 1.0).abs() < 1e-6, "{label}: {w}");
            counts[bin_of(kernel, w)] += 1.0;
        }
        let (mut chi2, mut freedom, mut pool) = (0.0, -1.0, (0.0, 0.0));
        for (count, share) in counts.iter().zip(shares) {
            pool = (pool.0 + count, pool.1 + share / total * COUNT as f64);
            if pool.1 > 10.0 {
                chi2 += (pool.0 - pool.1).powi(2) / pool.1;
                freedom += 1.0;
                pool = (0.0, 0.0);
            }
        }
        // Wilson and Hilferty 1931: (chi2 / f)^(1/3) is about normal. 4.5 deviations, 3.4e-6, for 84 tests.
        let spread = 2.0 / (9.0 * freedom);
        let z = ((chi2 / freedom).cbrt() - (1.0 - spread)) / f64::sqrt(spread);
        assert!(freedom > 10.0 && z < 4.5, "{label}: chi-square {chi2} of {freedom}, z {z}");
    }

    #[test]
    fn directions_follow_the_pdf() {
        for (i, albedo) in ALBEDOS.into_iter().enumerate() {
            for (j, g) in GS.into_iter().enumerate() {
                let kernel = Kernel::new(albedo, g);
                for (k, d) in path_directions().into_iter().enumerate() {
                    check(&kernel, d, (i * 16 + j * 4 + k) as u32, &format!("albedo {albedo} g {g} direction {k}"));
                }
            }
        }
    }

    /// Guided over classical density, vertex by vertex, is the closed form.
    #[test]
    fn walks_telescope() {
        const COLLISIONS: usize = 1000;
        for (i, albedo) in ALBEDOS.into_iter().enumerate() {
            for g in GS {
                let kernel = Kernel::new(albedo, g);
                let (kappa, mut sampler) = (f64::from(kernel.kappa), Sampler::new(i as u32, 1, 2));
                let first = path_directions()[1];
                let (mut w, mut product, mut along) = (first, 0.0_f64, 0.0_f64);
                for collision in 0..=COLLISIONS {
                    let stretch = f64::from(kernel.stretch(N, w));
                    let t = -f64::from(sampler.random_open()).ln() / stretch;
                    product += (1.0 - stretch) * t;
                    // n.w as 1 minus the exact complement: both vectors are unit only to f32.
                    let (n, w64) = (N.as_dvec3(), w.as_dvec3());
                    along += t * (1.0 - 0.5 * (w64 - n).length_squared());
                    if collision < COLLISIONS {
                        let wi = kernel.sample(&Frame::from_normal(N), w, &mut sampler);
                        let classical = f64::from(phase_eval(g, w.dot(wi)));
                        product += (stretch * f64::from(kernel.pdf(N, w, wi)) / classical).ln();
                        w = wi;
                    }
                }
                let ends = (f64::from(kernel.phi(N, w)) / f64::from(kernel.phi(N, first))).ln();
                let closed = COLLISIONS as f64 * f64::from(kernel.alpha_hat).ln() + kappa * along + ends;
                let error = (product - closed).exp_m1().abs();
                // Largest kappa: kappa c always rounds to the neighbour of c, by 2.5e-8 on average.
                let tolerance = if kernel.complement < 1e-6 { 5e-5 } else { 1e-5 };
                assert!(error < tolerance, "albedo {albedo} g {g}: {error}");
            }
        }
    }

    /// The values of guiding.md section 1.4.
    #[test]
    fn known_diffusion_lengths() {
        let known = [
            (0.2, 1.000_090_886_544),
            (0.5, 1.044_382_033_761),
            (0.8, 1.407_634_309_063),
            (0.9, 1.903_204_856_045),
            (0.95, 2.635_148_834_269),
            (0.99, 5.796_729_451_302),
            (0.999, 18.264_725_726_527),
            (0.9999, 57.737_336_452_026),
        ];
        for (albedo, nu) in known {
            // The albedo is rounded to f32: nu ~ (3 (1 - albedo))^-1/2.
            let tolerance = 1e-7 + 3e-8 / (1.0 - albedo);
            let error = (f64::from(diffusion_length(albedo as f32, 0.0)) / nu - 1.0).abs();
            assert!(error < tolerance, "albedo {albedo}: {error}");
            // The anisotropic solver meets the isotropic one.
            let error = (f64::from(diffusion_length(albedo as f32, 1e-9)) / nu - 1.0).abs();
            assert!(error < tolerance, "albedo {albedo}, moments: {error}");
        }
        for g in [0.0, 0.8, -0.8] {
            assert_eq!((diffusion_length(0.0, g), diffusion_length(1.0, g)), (1.0, f32::INFINITY));
        }
    }

    #[test]
    fn limits() {
        for g in [0.0, 1e-4, 0.5, 0.9, 0.99, -0.9, -0.99] {
            for albedo in [0.0, 1e-6, 0.1, 0.5, 1.0 - 1e-6, 1.0 - 6e-8, 1.0] {
                let kernel = Kernel::new(albedo, g);
                assert!((0.0..1.0).contains(&kernel.kappa) && kernel.kappa + kernel.complement == 1.0);
                assert!(kernel.alpha_hat > 0.0 && kernel.alpha_hat <= 1.0, "albedo {albedo} g {g}");
                let mut sampler = Sampler::new(5, 6, 7);
                let mut d = direction_about(N, 1.3, 0.7);
                for _ in 0..200 {
                    let wi = kernel.sample(&Frame::from_normal(N), d, &mut sampler);
                    let values = [kernel.pdf(N, d, wi), kernel.phi(N, wi), kernel.stretch(N, wi)];
                    assert!(wi.is_normalized() && values.iter().all(|v| v.is_finite() && *v > 0.0), "{values:?}");
                    d = wi;
                }
            }
        }
        let classical = Kernel::new(1.0, 0.8);
        assert_eq!((classical.kappa, classical.alpha_hat, classical.stretch(N, -N)), (0.0, 1.0, 1.0));
    }

    #[test]
    fn eight_at_once() {
        let w = direction_about(N, 0.6, 0.2);
        for (albedo, g) in [(0.8, 0.0), (0.9, 0.8), (0.7, -0.4), (1.0, 0.5)] {
            let kernel = Kernel::new(albedo, g);
            let normals: [Vec3; 8] = std::array::from_fn(|i| direction_about(w, i as f32 * 2.0 / 7.0, 0.4));
            let eight = kernel.phi8(&normals.map(|n| one_minus_cos(n, w)));
            assert_eq!(eight, normals.map(|n| kernel.phi(n, w)));
        }
    }
}
