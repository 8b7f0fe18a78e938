//! Von Mises-Fisher lobes on the sphere, and mixtures of a few of them (guiding.md section 3).

use crate::math::TAU;
use crate::sampling::{UNIFORM_SPHERE_PDF, direction_about};
use glam::{Vec2, Vec3};

/// Concentration of the sharpest lobe, 0.3 degrees wide.
pub const MAX_CONCENTRATION: f32 = 3.2e4;

/// Lobes of a mixture.
pub const MAX_LOBES: usize = 8;

/// Below it the formulas divide denormals; the lobe is uniform to far below roundoff.
const MIN_CONCENTRATION: f32 = 1e-30;

/// One lobe; solid-angle pdf k / (2 pi (1 - exp(-2k))) exp(k (mean.w - 1)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vmf {
    /// Unit.
    pub mean: Vec3,
    /// Concentration k, 0 (uniform) to [`MAX_CONCENTRATION`].
    pub k: f32,
}

impl Vmf {
    /// Solid-angle pdf of unit `w`.
    pub fn pdf(&self, w: Vec3) -> f32 {
        self.peak() * self.falloff(w)
    }

    /// Direction with density [`Vmf::pdf`].
    pub fn sample(&self, u: Vec2) -> Vec3 {
        // Jakob 2012, "Numerically stable sampling of the von Mises-Fisher distribution", for the complement of the cosine.
        let one_minus_cos = if self.k < MIN_CONCENTRATION {
            2.0 * u.x
        } else {
            (-(u.x * (-2.0 * self.k).exp_m1()).ln_1p() / self.k).clamp(0.0, 2.0) // rounding at the poles
        };
        direction_about(self.mean, one_minus_cos, u.y)
    }

    /// The pdf at the mean.
    pub(super) fn peak(&self) -> f32 {
        if self.k < MIN_CONCENTRATION { UNIFORM_SPHERE_PDF } else { self.k / (TAU * -(-2.0 * self.k).exp_m1()) }
    }

    /// The pdf over that at the mean.
    pub(super) fn falloff(&self, w: Vec3) -> f32 {
        // mean.w - 1 without the cancellation: at k = 3.2e4 its last bit would be 2e-3.
        (-0.5 * self.k * (w - self.mean).length_squared()).exp()
    }
}

/// Mean cosine to the mean direction, coth k - 1 / k.
pub(super) fn mean_cosine(k: f64) -> f64 {
    // The series is exact to 1e-12 there; the difference loses 1e-16 / k.
    if k < 0.02 { k / 3.0 - k.powi(3) / 45.0 + 2.0 * k.powi(5) / 945.0 } else { 1.0 / k.tanh() - 1.0 / k }
}

/// Lobes that share the directions among them; never without a lobe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VmfMixture {
    lobes: [Vmf; MAX_LOBES],
    /// Probabilities of the lobes, which sum to 1; 0 for those not in use.
    probability: [f32; MAX_LOBES],
    /// Pdf of each lobe at its mean, times its probability.
    peak: [f32; MAX_LOBES],
    count: usize,
    /// What [`VmfMixture::eval`] integrates to over the sphere.
    pub integral: f32,
}

impl VmfMixture {
    /// Of the first `MAX_LOBES` (relative weight >= 0, lobe); `None` where all weights together are not positive and
    /// finite.
    pub fn new(lobes: &[(f32, Vmf)], integral: f32) -> Option<Self> {
        let lobes = &lobes[..lobes.len().min(MAX_LOBES)];
        let sum: f32 = lobes.iter().map(|(weight, _)| weight).sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let unused = Vmf { mean: Vec3::Z, k: 0.0 };
        let zero = [0.0; MAX_LOBES];
        let mut new = Self { lobes: [unused; MAX_LOBES], probability: zero, peak: zero, count: lobes.len(), integral };
        for (i, (weight, lobe)) in lobes.iter().enumerate() {
            new.lobes[i] = *lobe;
            new.probability[i] = weight / sum;
            new.peak[i] = new.probability[i] * lobe.peak();
        }
        Some(new)
    }

    /// (probability, lobe) of each lobe.
    pub fn lobes(&self) -> impl Iterator<Item = (f32, &Vmf)> {
        self.probability.iter().copied().zip(&self.lobes).take(self.count)
    }

    /// The function that was fitted: `integral` times [`VmfMixture::pdf`].
    pub fn eval(&self, w: Vec3) -> f32 {
        self.integral * self.pdf(w)
    }

    /// Solid-angle pdf of unit `w`.
    pub fn pdf(&self, w: Vec3) -> f32 {
        self.peak.iter().zip(&self.lobes).take(self.count).map(|(peak, lobe)| peak * lobe.falloff(w)).sum()
    }

    /// Direction with density [`VmfMixture::pdf`]; `choice` in [0, 1) picks the lobe.
    pub fn sample(&self, choice: f32, u: Vec2) -> Vec3 {
        let mut rest = choice;
        let last = self.probability.iter().rposition(|p| *p > 0.0).unwrap_or(0);
        for (probability, lobe) in self.lobes().take(last) {
            if rest < probability {
                return lobe.sample(u);
            }
            rest -= probability;
        }
        self.lobes[last].sample(u)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;

    const MEAN: Vec3 = Vec3::new(0.48, -0.6, 0.64);
    const KS: [f32; 10] = [0.0, 1e-35, 1e-6, 1e-3, 0.1, 1.0, 10.0, 300.0, 1e4, MAX_CONCENTRATION];

    #[test]
    fn pdf_integrates_to_one() {
        const STEPS: usize = 20_000;
        for k in KS {
            let lobe = Vmf { mean: MEAN, k };
            // Beyond 1 - cos = 40 / k is exp(-40) of it. Midpoints in the root of 1 - cos, about the angle.
            let reach = 2.0_f64.min(40.0 / f64::from(k));
            let integral: f64 = (0..STEPS)
                .map(|i| {
                    let x = (i as f64 + 0.5) / STEPS as f64;
                    let w = direction_about(MEAN, (reach * x * x) as f32, i as f32 * 0.618);
                    f64::from(lobe.pdf(w)) * std::f64::consts::TAU * 2.0 * reach * x / STEPS as f64
                })
                .sum();
            assert!((integral - 1.0).abs() < 1e-5, "k {k}: {integral}");
        }
    }

    /// The mean of 1 - cos is 1 - coth k + 1 / k; that of the other components 0.
    #[test]
    fn sampled_means() {
        const COUNT: u32 = 400_000;
        for (seed, k) in KS.into_iter().enumerate() {
            let lobe = Vmf { mean: MEAN, k };
            let mut sampler = Sampler::new(seed as u32, 1, 1);
            let (mut cos, mut along) = (0.0, [0.0; 2]);
            let frame = crate::math::Frame::from_normal(MEAN);
            for _ in 0..COUNT {
                let w = lobe.sample(Vec2::new(sampler.random(), sampler.random()));
                assert!((w.length() - 1.0).abs() < 1e-6);
                cos += f64::from(0.5 * (w - MEAN).length_squared());
                along[0] += f64::from(w.dot(frame.t));
                along[1] += f64::from(w.dot(frame.b));
            }
            let (n, k, a) = (f64::from(COUNT), f64::from(k), mean_cosine(f64::from(k)));
            // <cos^2> = 1 - 2 A / k; the rest of the unit is shared by the other two.
            let ratio = if k < 1e-3 { 1.0 / 3.0 } else { a / k };
            let deviation = ((1.0 - 2.0 * ratio - a * a).max(1.0 / k.max(1.0).powi(2) / 3.0) / n).sqrt();
            assert!((cos / n - (1.0 - a)).abs() < 4.5 * deviation, "k {k}: {} for {}", cos / n, 1.0 - a);
            // 30 tests in all: 4.5 deviations have probability 2e-4.
            assert!(along.iter().all(|x| (x / n).abs() < 4.5 * (ratio / n).sqrt()), "k {k}: {along:?}");
        }
    }

    fn mixture() -> VmfMixture {
        let lobes = [
            (2.0, Vmf { mean: MEAN, k: 40.0 }),
            (0.0, Vmf { mean: -Vec3::Z, k: 300.0 }),
            (1.0, Vmf { mean: -Vec3::X, k: 3.0 }),
            (0.5, Vmf { mean: Vec3::Y, k: 0.0 }),
            (0.0, Vmf { mean: Vec3::Y, k: 5.0 }),
        ];
        VmfMixture::new(&lobes, 7.0).expect("weights")
    }

    /// Chi-square over cells of equal solid angle against the integral of the pdf.
    #[test]
    fn mixture_samples_its_pdf() {
        const CELLS: [usize; 2] = [16, 16];
        const STEPS: usize = 40;
        const COUNT: usize = 400_000;
        let mixture = mixture();
        let at = |z: f64, phi: f64| direction_about(Vec3::Z, (1.0 - z) as f32, phi as f32);
        let mut expected = vec![0.0; CELLS[0] * CELLS[1]];
        for (cell, share) in expected.iter_mut().enumerate() {
            for k in 0..STEPS * STEPS {
                let x = |i: usize, step: usize, n: usize| (i as f64 + (step as f64 + 0.5) / STEPS as f64) / n as f64;
                let (u, v) = (x(cell / CELLS[1], k / STEPS, CELLS[0]), x(cell % CELLS[1], k % STEPS, CELLS[1]));
                *share += f64::from(mixture.pdf(at(2.0 * u - 1.0, v)));
            }
            *share *= 4.0 * std::f64::consts::PI / (STEPS * STEPS * CELLS[0] * CELLS[1]) as f64;
        }
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 1e-4, "{total}");
        let (mut sampler, mut counts) = (Sampler::new(3, 1, 4), vec![0.0; expected.len()]);
        let frame = crate::math::Frame::from_normal(Vec3::Z);
        for _ in 0..COUNT {
            let w = frame.to_local(mixture.sample(sampler.random(), Vec2::new(sampler.random(), sampler.random())));
            let v = (w.y.atan2(w.x) / TAU).rem_euclid(1.0);
            let index = |u: f32, n: usize| ((u * n as f32) as usize).min(n - 1);
            counts[index(0.5 * (w.z + 1.0), CELLS[0]) * CELLS[1] + index(v, CELLS[1])] += 1.0;
        }
        let chi2: f64 = counts
            .iter()
            .zip(&expected)
            .map(|(count, share)| (count - share * COUNT as f64).powi(2) / (share * COUNT as f64))
            .sum();
        // Chi-square with 255 degrees of freedom exceeds 347 with probability 1e-4.
        assert!(chi2 < 347.0, "{chi2}");
    }

    #[test]
    fn mixture_is_the_sum_of_its_lobes() {
        let mixture = mixture();
        let w = Vec3::new(0.6, 0.0, 0.8);
        let sum: f32 = mixture.lobes().map(|(p, lobe)| p * lobe.pdf(w)).sum();
        assert!((mixture.pdf(w) / sum - 1.0).abs() < 1e-6);
        assert_eq!(mixture.eval(w), 7.0 * mixture.pdf(w));
        // Without weight no lobe is drawn, not even by a choice that rounds up to the end.
        assert!(mixture.sample(1.0, Vec2::splat(0.5)).is_finite());
        let none = Vmf { mean: Vec3::Y, k: 5.0 };
        assert_eq!(VmfMixture::new(&[(0.0, none)], 1.0), None);
        assert_eq!(VmfMixture::new(&[(f32::NAN, none), (1.0, none)], 1.0), None);
        assert_eq!(VmfMixture::new(&[], 1.0), None);
    }
}
