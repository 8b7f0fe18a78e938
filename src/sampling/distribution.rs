//! Piecewise-constant distributions, sampled by inverting their cumulative sums.
//!
//! Sums are f64: one texel may hold all the energy of an 8k dome, and a probability read back as the
//! difference of two sums is then exactly the one sampled with.

use glam::Vec2;
use rayon::prelude::*;

/// A distribution over `0..len`.
#[derive(Debug, Clone)]
pub struct Distribution1D {
    /// `len + 1` values from 0 to 1.
    cdf: Vec<f64>,
    sum: f64,
}

impl Distribution1D {
    /// Proportional to non-negative `weights`; `None` where their sum is zero or not finite.
    pub fn new(weights: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut cdf = vec![0.0];
        let mut sum = 0.0;
        for weight in weights {
            sum += weight;
            cdf.push(sum);
        }
        let usable = sum > 0.0 && sum.is_finite();
        usable.then(|| Self { cdf: cdf.iter().map(|c| c / sum).collect(), sum })
    }

    /// Sum of the weights.
    pub fn sum(&self) -> f64 {
        self.sum
    }

    pub fn probability(&self, index: usize) -> f64 {
        self.cdf[index + 1] - self.cdf[index]
    }

    /// For `u` in [0, 1): an index of positive probability, and `u` remapped to [0, 1) inside it.
    pub fn sample(&self, u: f64) -> (usize, f64) {
        invert(&self.cdf, u)
    }
}

/// A distribution over the cells of a grid: a row, then a column within it.
#[derive(Debug, Clone)]
pub struct Distribution2D {
    rows: Distribution1D,
    /// `height` cumulative sums of `width + 1` values each.
    columns: Vec<f64>,
    width: usize,
}

impl Distribution2D {
    /// Proportional to the non-negative `weight(column, row)`; `None` as for [`Distribution1D::new`].
    pub fn new(width: usize, height: usize, weight: impl Fn(usize, usize) -> f64 + Sync) -> Option<Self> {
        let mut columns = vec![0.0; (width + 1) * height];
        let mut sums = vec![0.0; height];
        let rows = columns.par_chunks_exact_mut(width + 1).zip(&mut sums).enumerate();
        rows.for_each(|(y, (cdf, sum))| *sum = accumulate(cdf, |x| weight(x, y)));
        Some(Self { rows: Distribution1D::new(sums)?, columns, width })
    }

    /// Sum of the weights.
    pub fn sum(&self) -> f64 {
        self.rows.sum()
    }

    pub fn probability(&self, column: usize, row: usize) -> f64 {
        let cdf = self.row(row);
        self.rows.probability(row) * (cdf[column + 1] - cdf[column])
    }

    /// For `u` in [0, 1)^2: (column, row) of positive probability, and `u` remapped to the inside of the cell.
    pub fn sample(&self, u: Vec2) -> (usize, usize, [f64; 2]) {
        let (row, v) = self.rows.sample(f64::from(u.y));
        let (column, u) = invert(self.row(row), f64::from(u.x));
        (column, row, [u, v])
    }

    fn row(&self, row: usize) -> &[f64] {
        let stride = self.width + 1;
        &self.columns[row * stride..(row + 1) * stride]
    }
}

/// Fills `cdf` with normalised cumulative sums and returns the sum; a row without weight stays zero.
fn accumulate(cdf: &mut [f64], weight: impl Fn(usize) -> f64) -> f64 {
    let mut sum = 0.0;
    for (x, c) in cdf[1..].iter_mut().enumerate() {
        sum += weight(x);
        *c = sum;
    }
    if sum > 0.0 {
        cdf.iter_mut().for_each(|c| *c /= sum);
    }
    sum
}

/// The interval of `cdf` that holds `u`, and where in it.
fn invert(cdf: &[f64], u: f64) -> (usize, f64) {
    // The largest f64 below 1: u = 1 would look beyond the last interval.
    let u = u.clamp(0.0, 1.0 - f64::EPSILON / 2.0);
    // The first sum above u closes an interval of positive width.
    let index = cdf.partition_point(|&c| c <= u).clamp(1, cdf.len() - 1) - 1;
    (index, (u - cdf[index]) / (cdf[index + 1] - cdf[index]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_weight_is_no_distribution() {
        assert!(Distribution1D::new([]).is_none());
        assert!(Distribution1D::new([0.0, 0.0]).is_none());
        assert!(Distribution1D::new([f64::NAN, 1.0]).is_none());
        assert!(Distribution2D::new(3, 2, |_, _| 0.0).is_none());
    }

    #[test]
    fn frequencies_are_the_probabilities() {
        let weights = [0.0, 3.0, 0.0, 1.0, 4.0, 0.0];
        let d = Distribution1D::new(weights).unwrap();
        let mut counts = [0; 6];
        for i in 0..8000 {
            let (index, offset) = d.sample((f64::from(i) + 0.5) / 8000.0);
            assert!((0.0..1.0).contains(&offset));
            counts[index] += 1;
        }
        assert_eq!(counts, [0, 3000, 0, 1000, 4000, 0]);
        assert_eq!(d.probability(4), 0.5);
        assert_eq!((d.sample(0.0).0, d.sample(1.0).0), (1, 4));
    }

    #[test]
    fn one_cell_that_holds_all() {
        let (w, h) = (4096, 2048);
        let weight = |x: usize, y: usize| if (x, y) == (4000, 7) { 1e6 } else { 1e-6 };
        let d = Distribution2D::new(w, h, weight).unwrap();
        let total = 1e6 + 1e-6 * (w * h - 1) as f64;
        assert!((d.probability(4000, 7) * total / 1e6 - 1.0).abs() < 1e-9);
        assert!((d.probability(9, 1000) * total / 1e-6 - 1.0).abs() < 1e-3);
        assert_eq!(d.sample(Vec2::new(0.3, 0.6)).0, 4000);
    }

    #[test]
    fn a_grid_sums_to_one_and_samples_what_it_says() {
        let d = Distribution2D::new(3, 4, |x, y| if y == 2 { 0.0 } else { (x * y) as f64 }).unwrap();
        let total: f64 = (0..12).map(|i| d.probability(i % 3, i / 3)).sum();
        assert!((total - 1.0).abs() < 1e-12);
        assert_eq!(d.probability(1, 1), 1.0 / 12.0);
        let (x, y, offset) = d.sample(Vec2::new(0.5, 0.999));
        assert_eq!((x, y), (2, 3));
        assert!((offset[0] - 0.25).abs() < 1e-6, "{offset:?}");
    }
}
