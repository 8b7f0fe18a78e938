//! Fit of a mixture of lobes to weighted directions: expectation-maximisation with priors (guiding.md section 3).
//!
//! Priors and stopping are those of OpenPGL; sums run in sample order and in f64, so that a fit is a function of its
//! samples. Responsibilities are taken from logarithms: no sample is ever out of reach of all lobes.

use super::vmf::{MAX_CONCENTRATION, MAX_LOBES, Vmf, VmfMixture, mean_cosine};
use glam::{DVec3, Vec3};
use std::f64::consts::TAU;

/// Pseudo-samples that every lobe starts with.
const WEIGHT_PRIOR: f64 = 0.1;

/// Pseudo-samples of mean cosine 0 in every lobe: they keep a lobe of few samples wide.
const COSINE_PRIOR: f64 = 0.1;

/// Concentration of the lobes at the start.
const INITIAL_K: f64 = 5.0;

const MAX_ITERATIONS: usize = 100;

/// Relative change of the log-likelihood that ends the iterations.
const CONVERGED: f64 = 0.0025;

/// Weights are cut at so many times their mean, lest one outlier owns a lobe; but not while they are below this share
/// of the sum, where cutting would only flatten lobes that uniform samples resolve.
const WINSOR: f64 = 20.0;
const WINSOR_SHARE: f64 = 0.005;

#[derive(Debug, Clone, Copy)]
struct Sample {
    w: DVec3,
    /// Mean 1 over the samples.
    weight: f64,
}

#[derive(Debug, Clone, Copy)]
struct Lobe {
    probability: f64,
    mean: DVec3,
    k: f64,
}

/// What a lobe answers for: weight, and weighted sum of directions.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    weight: f64,
    direction: DVec3,
}

/// The mixture of `lobes` (1 to `MAX_LOBES`) that fits (unit direction, weight), weights being the function to fit over
/// the pdf of the direction. Its `integral` is their plain mean. Weights that are not positive and finite, and
/// directions that are not finite, do not count as samples; `None` without any.
pub fn fit(samples: &[(Vec3, f32)], lobes: usize) -> Option<VmfMixture> {
    let (samples, integral) = prepare(samples)?;
    let mut lobes: Vec<Lobe> = start(lobes.clamp(1, MAX_LOBES));
    let mut last = f64::NEG_INFINITY;
    for _ in 0..MAX_ITERATIONS {
        let (shares, likelihood) = expect(&samples, &lobes);
        maximise(&mut lobes, &shares, samples.len() as f64);
        // Around log-likelihood 0 (mean density 1) the samples' number stands in for it.
        if (likelihood - last).abs() < CONVERGED * likelihood.abs().max(samples.len() as f64) {
            break;
        }
        last = likelihood;
    }
    let lobe = |l: &Lobe| (l.probability as f32, Vmf { mean: l.mean.as_vec3().normalize(), k: l.k as f32 });
    VmfMixture::new(&lobes.iter().map(lobe).collect::<Vec<_>>(), integral as f32)
}

/// The samples that count, weights cut and scaled to mean 1, and the mean before that.
fn prepare(samples: &[(Vec3, f32)]) -> Option<(Vec<Sample>, f64)> {
    let counts = |(w, weight): &&(Vec3, f32)| w.is_finite() && *weight > 0.0 && weight.is_finite();
    let sample = |&(w, weight): &(Vec3, f32)| Sample { w: w.as_dvec3(), weight: f64::from(weight) };
    let mut kept: Vec<Sample> = samples.iter().filter(counts).map(sample).collect();
    if kept.is_empty() {
        return None;
    }
    let mean = |samples: &[Sample]| samples.iter().map(|s| s.weight).sum::<f64>() / samples.len() as f64;
    let integral = mean(&kept);
    let most = integral * WINSOR.max(WINSOR_SHARE * kept.len() as f64);
    kept.iter_mut().for_each(|s| s.weight = s.weight.min(most));
    let cut = mean(&kept);
    kept.iter_mut().for_each(|s| s.weight /= cut);
    Some((kept, integral))
}

/// Equal lobes on a Fibonacci lattice.
fn start(count: usize) -> Vec<Lobe> {
    let golden = TAU * (1.0 - 1.0 / ((1.0 + 5.0_f64.sqrt()) * 0.5));
    let mean = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (r, phi) = ((1.0 - z * z).sqrt(), golden * i as f64);
        DVec3::new(r * phi.cos(), r * phi.sin(), z)
    };
    (0..count).map(|i| Lobe { probability: 1.0 / count as f64, mean: mean(i), k: INITIAL_K }).collect()
}

/// Divides the samples among the lobes; also the log-likelihood.
fn expect(samples: &[Sample], lobes: &[Lobe]) -> (Vec<Share>, f64) {
    let peaks: Vec<f64> = lobes.iter().map(|l| l.probability.ln() + log_peak(l.k)).collect();
    let (mut shares, mut likelihood) = (vec![Share::default(); lobes.len()], 0.0);
    let mut density = vec![0.0; lobes.len()];
    for s in samples {
        for ((density, lobe), peak) in density.iter_mut().zip(lobes).zip(&peaks) {
            *density = peak - 0.5 * lobe.k * (s.w - lobe.mean).length_squared();
        }
        let highest = density.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        density.iter_mut().for_each(|d| *d = (*d - highest).exp());
        let sum: f64 = density.iter().sum();
        likelihood += s.weight * (highest + sum.ln());
        for (share, density) in shares.iter_mut().zip(&density) {
            let weight = s.weight * density / sum;
            share.weight += weight;
            share.direction += weight * s.w;
        }
    }
    (shares, likelihood)
}

/// The lobes of highest posterior for their shares of `n` samples.
fn maximise(lobes: &mut [Lobe], shares: &[Share], n: f64) {
    let total = WEIGHT_PRIOR * lobes.len() as f64 + n;
    for (lobe, share) in lobes.iter_mut().zip(shares) {
        lobe.probability = (WEIGHT_PRIOR + share.weight) / total;
        let length = share.direction.length();
        // A lobe that has nothing, or whose samples cancel, keeps its direction and widens.
        let cosine = if share.weight > 0.0 { (length / share.weight).min(1.0) } else { 0.0 };
        if length > 0.0 {
            lobe.mean = share.direction / length;
        }
        let own = lobe.probability * n;
        lobe.k = concentration(cosine * own / (COSINE_PRIOR + own));
    }
}

/// Logarithm of a lobe's pdf at its mean.
fn log_peak(k: f64) -> f64 {
    if k == 0.0 { -(2.0 * TAU).ln() } else { (k / (TAU * -(-2.0 * k).exp_m1())).ln() }
}

/// The k whose lobe has mean cosine `r` in 0..=1, at most [`MAX_CONCENTRATION`].
fn concentration(r: f64) -> f64 {
    // 1 - r = 1 / k for sharp lobes.
    let most = f64::from(MAX_CONCENTRATION);
    if r >= 1.0 - 1.0 / most {
        return most;
    }
    // Banerjee et al. 2005, eq. 4.4, up to 4 % off; then Newton, whose slope is 1 - A^2 - 2 A / k.
    let mut k = r * (3.0 - r * r) / (1.0 - r * r);
    for _ in 0..3 {
        let a = mean_cosine(k);
        let slope = if k < 0.02 { 1.0 / 3.0 - k * k / 15.0 } else { 1.0 - a * a - 2.0 * a / k };
        k -= (a - r) / slope;
    }
    k.clamp(0.0, most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;
    use crate::sampling::{UNIFORM_SPHERE_PDF, uniform_sphere};
    use glam::Vec2;

    fn truth() -> VmfMixture {
        let lobes = [
            (0.5, Vmf { mean: Vec3::new(0.48, -0.6, 0.64), k: 60.0 }),
            (0.3, Vmf { mean: Vec3::new(-0.8, 0.0, -0.6), k: 8.0 }),
            (0.2, Vmf { mean: Vec3::new(0.0, 0.8, 0.6), k: 400.0 }),
        ];
        VmfMixture::new(&lobes, 3.0).expect("weights")
    }

    /// Uniform directions weighted by the mixture over their pdf, or directions of the mixture, of equal weight.
    fn samples(mixture: &VmfMixture, n: usize, uniform: bool) -> Vec<(Vec3, f32)> {
        let mut sampler = Sampler::new(7, 8, 9);
        let one = |_| {
            let (choice, u) = (sampler.random(), Vec2::new(sampler.random(), sampler.random()));
            let w = if uniform { uniform_sphere(u) } else { mixture.sample(choice, u) };
            (w, mixture.eval(w) / if uniform { UNIFORM_SPHERE_PDF } else { mixture.pdf(w) })
        };
        (0..n).map(one).collect()
    }

    /// Kullback-Leibler divergence of `q` from `p`, by sampling p.
    fn divergence(p: &VmfMixture, q: &VmfMixture) -> f64 {
        let samples = samples(p, 20_000, false);
        samples.iter().map(|(w, _)| f64::from((p.pdf(*w) / q.pdf(*w)).ln())).sum::<f64>() / samples.len() as f64
    }

    #[test]
    fn a_known_mixture_is_recovered() {
        let truth = truth();
        // Uniform samples of a lobe of k = 400 are few: one in 200.
        for (n, uniform, tolerance) in [(20_000, false, 0.05), (200_000, true, 0.08)] {
            let samples = samples(&truth, n, uniform);
            let fitted = fit(&samples, 3).expect("samples");
            for (p, lobe) in truth.lobes() {
                let nearest = |a: &(f32, &Vmf)| a.1.mean.dot(lobe.mean);
                let (q, got) = fitted.lobes().max_by(|a, b| nearest(a).total_cmp(&nearest(b))).expect("lobes");
                assert!((q - p).abs() < 0.01, "{q} of {p}");
                assert!(got.mean.distance(lobe.mean) < 0.01, "{got:?} for {lobe:?}");
                assert!((got.k / lobe.k - 1.0).abs() < tolerance, "{got:?} for {lobe:?}");
            }
            assert!((fitted.integral / 3.0 - 1.0).abs() < 0.02, "{}", fitted.integral);
            assert!(divergence(&truth, &fitted) < 0.005);
            assert!(divergence(&truth, &fit(&samples, MAX_LOBES).expect("samples")) < 0.01);
        }
    }

    /// Few samples give wide lobes, and still what they say.
    #[test]
    fn few_samples_are_smoothed() {
        let truth = truth();
        let uniform = VmfMixture::new(&[(1.0, Vmf { mean: Vec3::X, k: 0.0 })], 1.0).expect("a lobe");
        let baseline = divergence(&truth, &uniform);
        for n in [32, 128, 1024] {
            let kl = divergence(&truth, &fit(&samples(&truth, n, false), MAX_LOBES).expect("samples"));
            assert!(kl < 0.5 * baseline, "{n} samples: {kl} of {baseline}");
        }
    }

    fn sound(mixture: &VmfMixture) {
        let sum: f32 = mixture.lobes().map(|(p, _)| p).sum();
        assert!((sum - 1.0).abs() < 1e-5 && mixture.integral > 0.0 && mixture.integral.is_finite());
        for (p, lobe) in mixture.lobes() {
            assert!(p > 0.0 && lobe.mean.is_normalized() && (0.0..=MAX_CONCENTRATION).contains(&lobe.k), "{lobe:?}");
        }
        let mut sampler = Sampler::new(1, 2, 3);
        for _ in 0..1000 {
            let w = mixture.sample(sampler.random(), Vec2::new(sampler.random(), sampler.random()));
            let pdf = mixture.pdf(w);
            assert!(w.is_normalized() && pdf > 0.0 && pdf.is_finite(), "{pdf} at {w}");
        }
    }

    #[test]
    fn degenerate_samples() {
        let w = Vec3::new(0.48, -0.6, 0.64);
        let random = samples(&truth(), 500, true);
        let wide = |i: usize| 10.0_f32.powf(-4.0 + 8.0 * (i % 101) as f32 / 100.0);
        let cases: Vec<(&str, Vec<(Vec3, f32)>)> = vec![
            ("one", vec![(w, 2.0)]),
            ("one, faint", vec![(w, 1e-38)]),
            ("one, strong", vec![(w, f32::MAX)]),
            ("two opposite", vec![(w, 1.0), (-w, 1.0)]),
            ("identical", vec![(w, 0.5); 1000]),
            ("opposite", (0..1000).map(|i| (if i % 2 == 0 { w } else { -w }, 1.0)).collect()),
            ("range 1e8", random.iter().enumerate().map(|(i, (w, _))| (*w, wide(i))).collect()),
            ("one outlier", random.iter().copied().chain([(w, 1e12)]).collect()),
        ];
        for (name, samples) in cases {
            for lobes in [1, 3, MAX_LOBES, 100] {
                let mixture = fit(&samples, lobes).unwrap_or_else(|| panic!("{name}: no fit"));
                sound(&mixture);
                assert_eq!(Some(mixture), fit(&samples, lobes), "{name} is not repeatable");
            }
        }
        // What does not count changes nothing.
        let mut dirty = random.clone();
        dirty.extend([(w, 0.0), (w, -1.0), (w, f32::NAN), (w, f32::INFINITY), (Vec3::NAN, 1.0)]);
        assert_eq!(fit(&dirty, 4), fit(&random, 4));
        assert_eq!(fit(&[], 4), None);
        assert_eq!(fit(&[(w, 0.0), (w, f32::NAN)], 4), None);
    }

    /// Identical directions make lobes as sharp as the prior allows: 1 / k = 1 - n / (n + .1).
    #[test]
    fn identical_directions_are_limited_by_the_prior() {
        for n in [1_usize, 10, 1000] {
            let mixture = fit(&vec![(Vec3::Y, 1.0); n], 1).expect("samples");
            let (_, lobe) = mixture.lobes().next().expect("a lobe");
            let expected = concentration(n as f64 / (n as f64 + COSINE_PRIOR)) as f32;
            assert!((lobe.k / expected - 1.0).abs() < 1e-6 && lobe.mean == Vec3::Y, "{lobe:?} for {expected}");
        }
    }

    #[test]
    fn concentration_inverts_the_mean_cosine() {
        for i in 0..=300 {
            let k = 10.0_f64.powf(-8.0 + i as f64 * 12.5 / 300.0).min(3.1e4);
            let back = concentration(mean_cosine(k));
            assert!((back / k - 1.0).abs() < 1e-6, "{back} for {k}");
        }
        assert_eq!((concentration(0.0), concentration(1.0)), (0.0, f64::from(MAX_CONCENTRATION)));
    }
}
