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
