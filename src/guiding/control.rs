//! Control variates: the techniques' own densities, with coefficients fitted to what walks brought.
//!
//! With r_t = p_t / sum_s P_s p_s, E r_t = 1 exactly, so estimate - sum_t beta_t (r_t - 1) has the same mean for any
//! beta fixed before the walk (Owen and Zhou 2000; control_variates.md). Only controls that are bounded well (their
//! technique is drawn often enough) take part; a ridge of pseudo-walks keeps the others small.

use super::statistics::ControlSums;
use crate::math::Rgb;
use crate::subsurface::technique::{PerTechnique, TECHNIQUES};
use bytemuck::{Pod, Zeroable};

/// Coefficients per channel of the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Controls {
    beta: [PerTechnique; 3],
    /// Sum of the coefficients per channel.
    sum: Rgb,
}

/// Share from which a technique's density is a control: r_t is bounded by its inverse.
const LEAST_SHARE: f32 = 0.02;

/// Pseudo-walks of the ridge, per inverse share (control_variates.md, "what matters" 3).
const RIDGE: f64 = 3.0;

/// Share of a channel's variance that the controls must take away, beyond what chance does: they leave a channel alone
/// where they do not pay.
const LEAST_GAIN: f64 = 0.02;

/// Walks from which a fit is tried: below it the coefficients add more noise than they remove.
const LEAST_WALKS: f64 = 100.0;

impl Controls {
    /// Least squares of the estimates on the ratios; `None` where there is too little to go by, or nothing to gain.
    pub fn fit(sums: &ControlSums, shares: &PerTechnique) -> Option<Self> {
        if sums.walks < LEAST_WALKS {
            return None;
        }
        let shares = shares.as_list();
        let used: Vec<usize> = (0..TECHNIQUES).filter(|&t| shares[t] >= LEAST_SHARE).collect();
        let factor = Cholesky::of(&covariance(sums, &used, &shares), used.len())?;
        let mut beta = [[0.0_f32; TECHNIQUES]; 3];
        for c in 0..3 {
            let mean = sums.estimate[c] / sums.walks;
            let right: Vec<f64> = used.iter().map(|&t| sums.cross[c][t] - mean * sums.ratio[t]).collect();
            let solved = factor.solve(right.clone());
            let explained: f64 = solved.iter().zip(&right).map(|(b, r)| b * r).sum();
            let total = sums.squares[c] - mean * sums.estimate[c];
            // A fit of noise explains its degrees of freedom, and costs as much again on new walks (Mallows' C_p).
            let by_chance = 2.0 * used.len() as f64 / sums.walks;
            if explained > (by_chance + LEAST_GAIN) * total {
                used.iter().zip(solved).for_each(|(&t, b)| beta[c][t] = b as f32);
            }
        }
        let sum = Rgb::from_array([0, 1, 2].map(|c| beta[c].iter().sum()));
        let pays = beta.as_flattened().iter().any(|b| *b != 0.0);
        (pays && sum.is_finite()).then(|| Self { beta: beta.map(|b| PerTechnique::from_list(&b)), sum })
    }

    /// sum_t beta_t (r_t - 1) per channel: to be subtracted from the estimate.
    pub fn correction(&self, ratios: &PerTechnique) -> Rgb {
        Rgb::from_array([0, 1, 2].map(|c| self.beta[c].dot(ratios))) - self.sum
    }
}

/// Covariance of the ratios times the number of walks, with the ridge on its diagonal; rows of the lower triangle.
fn covariance(sums: &ControlSums, used: &[usize], shares: &[f32; TECHNIQUES]) -> Vec<f64> {
    let mut matrix = Vec::with_capacity(used.len() * (used.len() + 1) / 2);
    for (row, &i) in used.iter().enumerate() {
        for &j in &used[..=row] {
            let product = sums.products[i * (i + 1) / 2 + j] - sums.ratio[i] * sums.ratio[j] / sums.walks;
            let ridge = if i == j { RIDGE / f64::from(shares[i]) } else { 0.0 };
            matrix.push(product + ridge);
        }
    }
    matrix
}

/// Lower triangular factor of a symmetric positive definite matrix.
struct Cholesky {
    rows: Vec<f64>,
    n: usize,
}

impl Cholesky {
    /// `None` where the matrix is not positive definite in f64.
    fn of(matrix: &[f64], n: usize) -> Option<Self> {
        let at = |i: usize, j: usize| i * (i + 1) / 2 + j;
        let mut rows = matrix.to_vec();
        for i in 0..n {
            for j in 0..=i {
                let sum: f64 = rows[at(i, j)] - (0..j).map(|k| rows[at(i, k)] * rows[at(j, k)]).sum::<f64>();
                rows[at(i, j)] = if i > j {
                    sum / rows[at(j, j)]
                } else if sum > 0.0 {
                    sum.sqrt()
                } else {
                    return None;
                };
            }
        }
        Some(Self { rows, n })
    }

    fn solve(&self, mut x: Vec<f64>) -> Vec<f64> {
        let at = |i: usize, j: usize| self.rows[i * (i + 1) / 2 + j];
        for i in 0..self.n {
            x[i] = (x[i] - (0..i).map(|k| at(i, k) * x[k]).sum::<f64>()) / at(i, i);
        }
        for i in (0..self.n).rev() {
            x[i] = (x[i] - (i + 1..self.n).map(|k| at(k, i) * x[k]).sum::<f64>()) / at(i, i);
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Estimates that are linear in the ratios are left without variance, and their mean is kept.
    #[test]
    fn a_linear_estimate_loses_its_variance() {
        let mut shares = PerTechnique { classical: [0.1; 3], ..PerTechnique::default() };
        shares.guided[0][..2].fill(0.35);
        let mut sums = ControlSums::default();
        let walk = |i: u32| {
            let mut ratios = PerTechnique { classical: [1.0; 3], ..PerTechnique::default() };
            let x = (f64::from(i) * 0.618_033_988_75).fract() as f32;
            ratios.guided[0][0] = 2.0 * x;
            ratios.guided[0][1] = 3.0 * x * x;
            (ratios, Rgb::new(1.0 + 4.0 * x, 2.0 - 1.5 * x * x, 0.5))
        };
        (0..20_000).for_each(|i| sums.add(&walk(i).0, walk(i).1));
        let controls = Controls::fit(&sums, &shares).expect("enough walks");
        let means = Rgb::new(3.0, 1.5, 0.5);
        for i in 0..50 {
            let (ratios, estimate) = walk(i);
            let left = estimate - controls.correction(&ratios);
            // Half a percent is the ridge's: of estimates that spread over 1 to 5.
            assert!((left - means).abs().max_element() < 0.02, "{left}");
        }
        assert!(Controls::fit(&ControlSums::default(), &shares).is_none());
        // Estimates that do not know of the ratios are left alone.
        let mut noise = ControlSums::default();
        (0..20_000_u32).for_each(|i| {
            let coin = (f64::from(i) * 0.414_213_562_37).fract() as f32;
            noise.add(&walk(i).0, Rgb::splat(if coin < 0.1 { 10.0 } else { 0.0 }));
        });
        assert!(Controls::fit(&noise, &shares).is_none());
    }
}
