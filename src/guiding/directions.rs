//! A density of directions that is learned: constant over equal-area bins of the sphere.
//!
//! The variance of f / p is least where p follows the root of E[f^2 | direction] (Rath et al. 2020, "Variance-aware path
//! guiding"); samples say how large that is in every bin.

use crate::math::{Rgb, TAU, mean};
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

/// Equal bands in z, each cut into equal angles.
const BANDS: usize = 8;
const SECTORS: usize = 16;
pub const BINS: usize = BANDS * SECTORS;

/// Solid-angle pdf of a bin that has all directions, uniform within.
const BIN_PDF: f32 = BINS as f32 / (2.0 * TAU);

/// A learned density; never without a bin.
#[derive(Debug, Clone)]
pub struct Directions {
    /// Running sums of the bins' probabilities, the last 1.
    running: [f32; BINS],
}

/// Sums over samples of directions.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DirectionSums {
    samples: f64,
    /// Of estimates f / p.
    estimate: [f64; 3],
    /// Of their means over channels, and of the squares of those.
    moments: [f64; 2],
    /// Of squared estimates times the pdf of their direction, by bin: f^2 / p.
    squares: [[f64; BINS]; 3],
}

impl Default for DirectionSums {
    fn default() -> Self {
        Self { samples: 0.0, estimate: [0.0; 3], moments: [0.0; 2], squares: [[0.0; BINS]; 3] }
    }
}

/// Dim channels count relative to their own mean, but not below this share of the brightest channel's.
const DIM: f64 = 0.1;

impl Directions {
    /// Of (sums, weight) with weights that sum to 1; `None` where there is nothing to go by.
    pub fn fit<'a>(sums: impl IntoIterator<Item = (&'a DirectionSums, f64)>) -> Option<Self> {
        let (mut probabilities, mut total) = ([0.0; BINS], 0.0);
        for (sums, weight) in sums {
            let Some(own) = sums.probabilities() else { continue };
            probabilities.iter_mut().zip(own).for_each(|(sum, p)| *sum += weight * p);
            total += weight;
        }
        let mut sum = 0.0;
        let running = probabilities.map(|p| {
            sum += p / total;
            sum as f32
        });
        (total > 0.0).then_some(Self { running })
    }

    /// Solid-angle pdf of unit `w`.
    pub fn pdf(&self, w: Vec3) -> f32 {
        self.probability(bin_of(w)) * BIN_PDF
    }

    fn probability(&self, bin: usize) -> f32 {
        self.running[bin] - if bin > 0 { self.running[bin - 1] } else { 0.0 }
    }

    /// Direction with density [`Self::pdf`]; `choice` in [0, 1) picks the bin.
    pub fn sample(&self, choice: f32, u: Vec2) -> Vec3 {
        let choice = choice * self.running[BINS - 1]; // rounding may end below 1
        let bin = self.running.partition_point(|&sum| sum <= choice).min(BINS - 1);
        let (band, sector) = (bin / SECTORS, bin % SECTORS);
        // Strictly inside, so that the pdf is that of the bin that was drawn.
        let inside = u.clamp(Vec2::splat(1e-4), Vec2::splat(1.0 - 1e-4));
        let z = (band as f32 + inside.x) * (2.0 / BANDS as f32) - 1.0;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = ((sector as f32 + inside.y) * (TAU / SECTORS as f32) - 0.5 * TAU).sin_cos();
        Vec3::new(r * cos, r * sin, z)
    }
}

impl DirectionSums {
    /// `estimate` f / p of a sample in direction `w`, drawn with solid-angle pdf `pdf`.
    pub fn add(&mut self, w: Vec3, pdf: f32, estimate: Rgb) {
        let bin = bin_of(w);
        let gray = f64::from(mean(estimate));
        self.samples += 1.0;
        self.moments[0] += gray;
        self.moments[1] += gray * gray;
        for c in 0..3 {
            let x = f64::from(estimate[c]);
            self.estimate[c] += x;
            self.squares[c][bin] += x * x * f64::from(pdf);
        }
    }

    /// How many equal samples would tell as much: the few that find light count.
    pub fn telling(&self) -> f64 {
        let [sum, squares] = self.moments;
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }

    /// Of the bins; `None` without light.
    fn probabilities(&self) -> Option<[f64; BINS]> {
        let mean = self.estimate.map(|sum| (sum / self.samples).abs());
        let brightest = mean.iter().copied().fold(0.0, f64::max);
        let mut weights = [0.0; BINS];
        for (mean, squares) in mean.into_iter().zip(&self.squares) {
            let scale = mean * mean + DIM * DIM * brightest * brightest;
            if scale > 0.0 {
                weights.iter_mut().zip(squares).for_each(|(weight, square)| *weight += square / scale);
            }
        }
        let roots = weights.map(f64::sqrt);
        let total: f64 = roots.iter().sum();
        (total > 0.0 && total.is_finite()).then(|| roots.map(|root| root / total))
    }

    pub fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.moments.iter_mut().zip(&other.moments).for_each(|(a, b)| *a += b);
        self.estimate.iter_mut().zip(&other.estimate).for_each(|(a, b)| *a += b);
        let squares = self.squares.as_flattened_mut().iter_mut();
        squares.zip(other.squares.as_flattened()).for_each(|(a, b)| *a += b);
    }
}

fn bin_of(w: Vec3) -> usize {
    let band = ((w.z * 0.5 + 0.5) * BANDS as f32).clamp(0.0, BANDS as f32 - 1.0) as usize;
    band * SECTORS + sector_of(w.x, w.y)
}

/// The sector of a direction, from -x on towards -y: by slopes, without an arc tangent.
fn sector_of(x: f32, y: f32) -> usize {
    const { assert!(SECTORS == 16) };
    /// Tangent of the 22.5 degrees of a sector.
    const SECTOR: f32 = std::f32::consts::SQRT_2 - 1.0;
    let (along, up) = (x.abs(), y.abs());
    let from_axis = usize::from(up >= SECTOR * along) + usize::from(up >= along) + usize::from(SECTOR * up >= along);
    match (x < 0.0, y < 0.0) {
        (true, true) => from_axis,
        (false, true) => 7 - from_axis,
        (false, false) => 8 + from_axis,
        (true, false) => 15 - from_axis,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;
    use crate::sampling::uniform_sphere;

    fn pair(sampler: &mut Sampler) -> Vec2 {
        Vec2::new(sampler.random(), sampler.random())
    }

    /// Uniform samples of a function that is `f` towards +x and 1 elsewhere.
    fn learned(f: f32) -> Directions {
        let (mut sums, mut sampler) = (DirectionSums::default(), Sampler::new(1, 2, 3));
        for _ in 0..200_000 {
            let w = uniform_sphere(pair(&mut sampler));
            let value = if w.x > 0.0 { f } else { 1.0 };
            sums.add(w, 1.0 / (2.0 * TAU), Rgb::splat(value * 2.0 * TAU));
        }
        Directions::fit([(&sums, 1.0)]).expect("light")
    }

    #[test]
    fn the_density_follows_the_function() {
        let directions = learned(3.0);
        for (w, expected) in [(Vec3::new(0.8, 0.0, 0.6), 1.5), (Vec3::new(-0.8, 0.0, 0.6), 0.5)] {
            let ratio = directions.pdf(w) * 2.0 * TAU / expected;
            assert!((ratio - 1.0).abs() < 0.1, "{w}: {ratio}");
        }
        assert!(Directions::fit([(&DirectionSums::default(), 1.0)]).is_none());
    }

    #[test]
    fn sectors_are_equal_angles() {
        for i in 0..16_000 {
            let turn = (i as f32 + 0.5) / 16_000.0;
            let (sin, cos) = ((turn - 0.5) * TAU).sin_cos();
            assert_eq!(sector_of(cos, sin), (turn * SECTORS as f32) as usize, "{turn}");
        }
    }

    /// Chi-square of sampled bins, and the integral of the pdf by samples of itself: E[1 / pdf] is the sphere's area.
    #[test]
    fn samples_follow_the_pdf() {
        const COUNT: u32 = 200_000;
        let (directions, mut sampler) = (learned(20.0), Sampler::new(4, 5, 6));
        let (mut counts, mut area) = ([0.0; BINS], 0.0);
        for _ in 0..COUNT {
            let w = directions.sample(sampler.random(), pair(&mut sampler));
            assert!((w.length() - 1.0).abs() < 1e-6);
            counts[bin_of(w)] += 1.0;
            area += 1.0 / f64::from(directions.pdf(w));
        }
        let chi2: f64 = (0..BINS)
            .map(|bin| {
                let expected = f64::from(directions.probability(bin)) * f64::from(COUNT);
                (counts[bin] - expected) * (counts[bin] - expected) / expected
            })
            .sum();
        // Wilson and Hilferty 1931; 4.5 deviations.
        let (freedom, spread) = (BINS as f64 - 1.0, 2.0 / (9.0 * (BINS as f64 - 1.0)));
        let z = ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
        assert!(z < 4.5, "chi-square {chi2}, z {z}");
        let ratio = area / f64::from(COUNT) / (2.0 * std::f64::consts::TAU);
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    }
}
