//! Piecewise-constant distributions, sampled by inverting their cumulative sums.
//!
//! Sums are f64: one texel may hold all the energy of an 8k dome, and a probability read back as the
//! difference of two sums is then exactly the one sampled with.

use glam::Vec2;
use rayon::prelude::*;
use std::ops::Range;

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

/// Columns whose weights are summed up together: cumulative sums of an 8k dome take 17 MB instead of 270.
pub const BLOCK: usize = 16;

/// Weights of some columns that follow each other, as many as there are.
pub type Block = [f64; BLOCK];

/// A distribution over the cells of a grid: a row, then a column within it. Weights are not stored: whoever has them gives
/// them again.
#[derive(Debug, Clone)]
pub struct Distribution2D {
    rows: Distribution1D,
    /// By row, cumulative sums over blocks of columns, from 0 on.
    blocks: Vec<f64>,
    width: usize,
}

impl Distribution2D {
    /// Proportional to the non-negative `weights(columns, row)`; `None` as for [`Distribution1D::new`].
    pub fn new(width: usize, height: usize, weights: impl Fn(Range<usize>, usize) -> Block + Sync) -> Option<Self> {
        let stride = width.div_ceil(BLOCK) + 1;
        let mut blocks = vec![0.0; stride * height];
        blocks.par_chunks_exact_mut(stride).enumerate().for_each(|(y, sums)| {
            for block in 0..stride - 1 {
                sums[block + 1] = sums[block] + weights(columns(block, width), y).iter().sum::<f64>();
            }
        });
        let rows = Distribution1D::new(blocks.chunks_exact(stride).map(|sums| sums[stride - 1]))?;
        Some(Self { rows, blocks, width })
    }

    /// Sum of the weights: the probability of a cell is its weight over this.
    pub fn sum(&self) -> f64 {
        self.rows.sum()
    }

    /// For `u` in [0, 1)^2: (column, row) of positive probability, and `u` remapped to the inside of the cell.
    pub fn sample(&self, u: Vec2, weights: impl Fn(Range<usize>, usize) -> Block) -> (usize, usize, [f64; 2]) {
        let (row, v) = self.rows.sample(f64::from(u.y));
        let stride = self.width.div_ceil(BLOCK) + 1;
        let sums = &self.blocks[row * stride..(row + 1) * stride];
        let target = f64::from(u.x) * sums[stride - 1];
        let block = sums.partition_point(|&sum| sum <= target).clamp(1, stride - 1) - 1;
        let mut left = target - sums[block];
        // Rounding may leave a remainder beyond the last weight: it is the last column's.
        let mut last = (block * BLOCK, 0.0);
        let columns = columns(block, self.width);
        for (column, weight) in columns.clone().zip(weights(columns, row)) {
            if left < weight {
                return (column, row, [left / weight, v]);
            }
            left -= weight;
            if weight > 0.0 {
                last = (column, 1.0 - f64::EPSILON);
            }
        }
        (last.0, row, [last.1, v])
    }
}

fn columns(block: usize, width: usize) -> Range<usize> {
    block * BLOCK..((block + 1) * BLOCK).min(width)
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

    fn by_cell(weight: impl Fn(usize, usize) -> f64) -> impl Fn(Range<usize>, usize) -> Block {
        move |columns, row| {
            std::array::from_fn(|i| if i < columns.len() { weight(columns.start + i, row) } else { 0.0 })
        }
    }

    #[test]
    fn no_weight_is_no_distribution() {
        assert!(Distribution1D::new([]).is_none());
        assert!(Distribution1D::new([0.0, 0.0]).is_none());
        assert!(Distribution1D::new([f64::NAN, 1.0]).is_none());
        assert!(Distribution2D::new(3, 2, |_, _| [0.0; BLOCK]).is_none());
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
        let d = Distribution2D::new(w, h, by_cell(weight)).unwrap();
        let total = 1e6 + 1e-6 * (w * h - 1) as f64;
        assert!((d.sum() / total - 1.0).abs() < 1e-9);
        assert_eq!(d.sample(Vec2::new(0.3, 0.6), by_cell(weight)).0, 4000);
        assert!(d.blocks.len() < w * h / 8);
    }

    #[test]
    fn a_grid_is_sampled_by_its_weights() {
        for (w, h) in [(1, 1), (2, 1), (1, 3), (17, 5), (48, 2)] {
            let weight = |x: usize, y: usize| if (x + y) % 5 == 4 { 0.0 } else { (1 + x * y) as f64 };
            let d = Distribution2D::new(w, h, by_cell(weight)).unwrap();
            let mut counts = vec![0.0; w * h];
            const N: u32 = 1024;
            for i in 0..N * N {
                let u = Vec2::new((i % N) as f32 + 0.5, (i / N) as f32 + 0.5) / N as f32;
                let (x, y, offset) = d.sample(u, by_cell(weight));
                assert!(offset.iter().all(|o| (0.0..1.0).contains(o)));
                counts[x + y * w] += 1.0;
            }
            for (i, count) in counts.iter().enumerate() {
                // Each border may take or lose a line of the N x N numbers.
                let (x, y) = (i % w, i / w);
                assert!(
                    (count / f64::from(N * N) - weight(x, y) / d.sum()).abs() < 4.0 / f64::from(N),
                    "{w} {h} {x} {y}"
                );
                assert!(*count > 0.0 || weight(x, y) < 1e-3 * d.sum());
            }
        }
    }
}
