//! Directions in which walks go on where they come out: by the cosine, or to where indirect light came from.
//!
//! Light from lights is sampled there anyway; what surfaces send (a card, the other cheek) is found by chance alone
//! otherwise. The directions are those of the probes that filled the boundary cache.

use super::cache::{Cache, Record};
use super::fit::fit;
use super::vmf::VmfMixture;
use glam::{Vec2, Vec3};
use std::sync::OnceLock;

/// A fitted distribution of indirect light, mixed with what the boundary samples by itself.
#[derive(Debug, Clone)]
pub struct ExitGuide {
    directions: VmfMixture,
}

/// Lobes per cell: its records are few, more lobes were no better.
const LOBES: usize = 1;

/// Share of guided directions; the rest keeps the weight within 4/3 of that of plain sampling, also where the few
/// records mislead.
const GUIDED: f32 = 0.25;

impl ExitGuide {
    /// Solid-angle pdf of the mixture towards `wi` (render space), `plain` being that of plain sampling.
    pub fn pdf(&self, plain: f32, wi: Vec3) -> f32 {
        (1.0 - GUIDED) * plain + GUIDED * self.directions.pdf(wi)
    }

    /// A guided direction, or the choice remapped for plain sampling.
    pub fn sample(&self, u_choice: f32, u: Vec2) -> Result<Vec3, f32> {
        if u_choice < GUIDED {
            Ok(self.directions.sample(u_choice / GUIDED, u))
        } else {
            Err((u_choice - GUIDED) / (1.0 - GUIDED))
        }
    }
}

/// Guides of the cells of a cache, each fitted when a walk first comes out there.
#[derive(Debug)]
pub struct ExitGuides {
    /// Directions and weights of the indirect light of each cell's records.
    seen: Vec<Vec<(Vec3, f32)>>,
    fitted: Vec<OnceLock<Option<ExitGuide>>>,
}

impl ExitGuides {
    pub fn new(cache: &Cache, records: &[Record]) -> Self {
        let mut seen = vec![Vec::new(); cache.means.len()];
        for record in records {
            if let (Some(cell), Some(indirect)) = (cache.cells.find(record.p, record.n), record.indirect) {
                seen[cell as usize].push(indirect);
            }
        }
        Self { fitted: seen.iter().map(|_| OnceLock::new()).collect(), seen }
    }

    pub fn find(&self, cell: u32) -> Option<&ExitGuide> {
        let fitted = &self.fitted[cell as usize];
        fitted.get_or_init(|| Some(ExitGuide { directions: fit(&self.seen[cell as usize], LOBES)? })).as_ref()
    }

    pub fn memory(&self) -> usize {
        let of_cell = |seen: &Vec<(Vec3, f32)>| seen.len() * size_of::<(Vec3, f32)>() + size_of::<ExitGuide>();
        self.seen.iter().map(of_cell).sum()
    }
}
