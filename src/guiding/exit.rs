//! Directions in which walks go on where they come out of a diffuse boundary: by the cosine, or to where light was seen.
//!
//! Lights are sampled there anyway; what surfaces send (a card, the other cheek) is found by chance alone otherwise. The
//! same for the directions in which walks start was tried: the walk's own randomness hides what they are worth, and the
//! picture got noisier.

use super::cache::{Cache, Incident, Record};
use super::cells::Cells;
use super::directions::{DirectionSums, Directions};
use crate::math::{PI, Rgb};
use crate::sampling::cosine_hemisphere_pdf;
use crate::saved::{Loader, Saver, damaged};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::io;

/// Largest share of learned directions; the rest keeps the weight within 1 / (1 - this) of that of plain sampling, also
/// where what was learned misleads.
const GUIDED: f64 = 0.5;

/// Telling samples for which a cell is believed half, against the coarser cell around it, or against the cosine.
const PRIOR: f64 = 32.0;

/// Edge of the coarser cells over that of the cells.
const COARSER: f32 = 4.0;

/// A learned density, mixed with what the boundary samples by itself.
#[derive(Debug, Clone)]
pub struct Exit {
    directions: Directions,
    /// Share of learned directions.
    guided: f32,
}

impl Exit {
    fn fit(own: Option<&DirectionSums>, around: &DirectionSums) -> Option<Self> {
        let trust = |sums: &DirectionSums| sums.telling() / (sums.telling() + PRIOR);
        let own_share = own.map_or(0.0, trust);
        let sums = own.map(|own| (own, own_share)).into_iter().chain([(around, 1.0 - own_share)]);
        Some(Self { directions: Directions::fit(sums)?, guided: (GUIDED * trust(around)) as f32 })
    }

    /// Solid-angle pdf of the mixture towards `wi` (render space), `plain` being that of plain sampling.
    pub fn pdf(&self, plain: f32, wi: Vec3) -> f32 {
        (1.0 - self.guided) * plain + self.guided * self.directions.pdf(wi)
    }

    /// A learned direction, or the choice remapped for plain sampling.
    pub fn sample(&self, u_choice: f32, u: Vec2) -> Result<Vec3, f32> {
        if u_choice < self.guided {
            Ok(self.directions.sample(u_choice / self.guided, u))
        } else {
            Err((u_choice - self.guided) / (1.0 - self.guided))
        }
    }
}

/// Exits of a boundary, by cell.
#[derive(Debug)]
pub struct Exits {
    cells: Cells,
    learned: Vec<Option<Exit>>,
    /// Of each cell where light came out.
    sums: Vec<Option<Box<DirectionSums>>>,
    /// The coarser cell that each lies in.
    around: Vec<u32>,
    coarse: Vec<DirectionSums>,
}

impl Exits {
    /// For the cells of `cache`, with the indirect light that the probes which filled it have seen.
    pub fn new(cache: &Cache, records: &[Record]) -> Self {
        let count = cache.means.len();
        let mut coarser = Cells::new(COARSER * cache.cells.size);
        let around = cache.means.iter().map(|cell| coarser.find_or_insert(cell.point, cell.normal)).collect();
        let mut new = Self {
            cells: cache.cells.clone(),
            learned: vec![None; count],
            sums: vec![None; count],
            around,
            coarse: vec![DirectionSums::default(); coarser.len()],
        };
        for record in records {
            if let (Some(cell), Some(Incident { wi, irradiance })) = (new.find(record.p, record.n), record.indirect) {
                // Out of a diffuse boundary f / p is the radiance, here irradiance / pi by one cosine sample.
                let pdf = cosine_hemisphere_pdf(wi.dot(record.n));
                let around = new.around[cell as usize] as usize;
                new.coarse[around].add(wi, pdf, Rgb::splat(irradiance / PI));
            }
        }
        new.fit();
        new
    }

    /// The cell of a boundary point.
    pub fn find(&self, p: Vec3, n: Vec3) -> Option<u32> {
        self.cells.find(p, n)
    }

    pub fn at(&self, cell: u32) -> Option<&Exit> {
        self.learned[cell as usize].as_ref()
    }

    /// Takes in what was seen at `cell`; [`Self::fit`] makes use of it.
    pub fn add(&mut self, cell: u32, seen: &DirectionSums) {
        self.sums[cell as usize].get_or_insert_default().merge(seen);
        self.coarse[self.around[cell as usize] as usize].merge(seen);
    }

    pub fn fit(&mut self) {
        let fit = |cell: usize| Exit::fit(self.sums[cell].as_deref(), &self.coarse[self.around[cell] as usize]);
        self.learned = (0..self.sums.len()).into_par_iter().map(fit).collect();
    }

    /// What was learned; densities follow from it by [`Self::fit`].
    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.array(&self.coarse)?;
        let seen = self.sums.iter().enumerate().filter_map(|(cell, sums)| Some((cell as u32, sums.as_ref()?)));
        to.count(seen.clone().count())?;
        for (cell, sums) in seen {
            to.value(&cell)?;
            to.value(sums.as_ref())?;
        }
        Ok(())
    }

    pub(crate) fn load(&mut self, from: &mut Loader) -> io::Result<()> {
        from.array(&mut self.coarse)?;
        for _ in 0..from.count()? {
            let cell: u32 = from.value()?;
            *self.sums.get_mut(cell as usize).ok_or_else(|| damaged("an exit"))? = Some(Box::new(from.value()?));
        }
        self.fit();
        Ok(())
    }

    pub fn memory(&self) -> usize {
        let sums = (self.sums.iter().flatten().count() + self.coarse.len()) * size_of::<DirectionSums>();
        let slots = size_of::<Option<Exit>>() + size_of::<Option<Box<DirectionSums>>>() + size_of::<u32>();
        self.cells.memory() + self.learned.len() * slots + sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Frame, TAU};
    use crate::sampling::sampler::Sampler;
    use crate::sampling::{cosine_hemisphere, uniform_sphere};

    /// Learned in light that comes from beside a surface of normal `n`, in part from below its horizon.
    fn learned(n: Vec3) -> Exit {
        let (mut sums, mut sampler) = (DirectionSums::default(), Sampler::new(1, 2, 3));
        let beside = n.any_orthonormal_vector();
        for _ in 0..50_000 {
            let w = uniform_sphere(Vec2::new(sampler.random(), sampler.random()));
            let light = (w.dot(beside) - 0.5).max(0.0);
            sums.add(w, 1.0 / (2.0 * TAU), Rgb::splat(light));
        }
        Exit::fit(None, &sums).expect("light")
    }

    const BANDS: usize = 16;
    const SECTORS: usize = 32;

    /// Of equal area, several to each of those that densities are learned in.
    fn bin_of(w: Vec3) -> usize {
        let band = ((w.z + 1.0) * 0.5 * BANDS as f32) as usize;
        let sector = ((w.y.atan2(w.x) / TAU + 0.5) * SECTORS as f32) as usize;
        band.min(BANDS - 1) * SECTORS + sector.min(SECTORS - 1)
    }

    /// Probabilities of the bins by the midpoint rule.
    fn probabilities(pdf: impl Fn(Vec3) -> f32) -> Vec<f64> {
        const FINE: usize = 24;
        let area = 2.0 * std::f64::consts::TAU / (BANDS * SECTORS * FINE * FINE) as f64;
        let mut sums = vec![0.0; BANDS * SECTORS];
        for i in 0..BANDS * FINE {
            let z = (i as f32 + 0.5) * 2.0 / (BANDS * FINE) as f32 - 1.0;
            for j in 0..SECTORS * FINE {
                let (sin, cos) = (((j as f32 + 0.5) / (SECTORS * FINE) as f32 - 0.5) * TAU).sin_cos();
                let r = (1.0 - z * z).sqrt();
                sums[i / FINE * SECTORS + j / FINE] += area * f64::from(pdf(Vec3::new(r * cos, r * sin, z)));
            }
        }
        sums
    }

    /// Chi-square as z (Wilson and Hilferty 1931) over bins where something is expected.
    fn chi_square(counts: &[f64], probabilities: &[f64]) -> f64 {
        let n: f64 = counts.iter().sum();
        let cells = counts.iter().zip(probabilities).map(|(count, p)| (count, p * n)).filter(|(_, e)| *e > 5.0);
        let chi2: f64 = cells.clone().map(|(count, e)| (count - e) * (count - e) / e).sum();
        let (freedom, spread) = (cells.clone().count() as f64, 2.0 / (9.0 * cells.count() as f64));
        ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
    }

    /// What is drawn, learned or by the cosine, has the density of the mixture.
    #[test]
    fn exits_follow_the_pdf_of_the_mixture() {
        const COUNT: u32 = 400_000;
        for n in [Vec3::Z, Vec3::new(0.48, -0.6, 0.64)] {
            let (exit, frame, mut sampler) = (learned(n), Frame::from_normal(n), Sampler::new(4, 5, 6));
            assert!(exit.guided > 0.45, "{}", exit.guided);
            let (mut counts, mut choices) = (vec![0.0; BANDS * SECTORS], vec![0.0; 32]);
            for _ in 0..COUNT {
                let (u_choice, u) = (sampler.random(), Vec2::new(sampler.random(), sampler.random()));
                let w = exit.sample(u_choice, u).unwrap_or_else(|left| {
                    choices[(left * 32.0) as usize] += 1.0;
                    frame.to_world(cosine_hemisphere(u))
                });
                counts[bin_of(w)] += 1.0;
            }
            let plain = |w: Vec3| cosine_hemisphere_pdf(w.dot(n));
            let right = probabilities(|w| exit.pdf(plain(w), w));
            assert!((right.iter().sum::<f64>() - 1.0).abs() < 1e-3, "{}", right.iter().sum::<f64>());
            let z = chi_square(&counts, &right);
            assert!(z < 4.5, "{n}: z {z}");
            // Of plain sampling, what is left of the choice is as good as new.
            let z = chi_square(&choices, &[1.0 / 32.0; 32]);
            assert!(z < 4.5, "{n}: choices, z {z}");
            // A share that is off by 4 % does not pass.
            let off = Exit { guided: 0.96 * exit.guided, ..exit };
            let z = chi_square(&counts, &probabilities(|w| off.pdf(plain(w), w)));
            assert!(z > 4.5, "{n}: wrong share, z {z}");
        }
    }
}
