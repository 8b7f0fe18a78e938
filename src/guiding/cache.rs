//! The boundary cache: what light reaches each cell of a medium's boundary.
//!
//! Filled from boundary points with an irradiance estimate each; means per cell. Section 2.2 of guiding.md.

use super::cells::Cells;
use super::fit::fit;
use super::vmf::{MAX_LOBES, VmfMixture};
use crate::math::{Rgb, mean};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A boundary point with an estimate of the light that reaches it.
#[derive(Debug, Clone)]
pub struct Record {
    /// Walk space.
    pub p: Vec3,
    /// Unit, outward.
    pub n: Vec3,
    /// Surface area that the point stands for.
    pub area: f32,
    /// Irradiance that enters, from lights and by way of other surfaces.
    pub irradiance: Rgb,
    /// Of the lights that were sampled.
    pub lights: Vec<LightRecord>,
    /// Directions to lights, with their irradiance.
    pub directions: Vec<(Vec3, f32)>,
    /// A direction by which light came from another surface, with its irradiance.
    pub indirect: Option<(Vec3, f32)>,
}

#[derive(Debug, Clone, Copy)]
pub struct LightRecord {
    pub light: u32,
    /// Irradiance (mean of the channels) with and without shadows.
    pub visible: f32,
    pub unshadowed: f32,
}

/// Means of a cell.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    pub point: Vec3,
    /// Unit, outward.
    pub normal: Vec3,
    pub area: f32,
    pub irradiance: Rgb,
    /// Whether it may serve as a source: lit, by enough samples, with a normal that means something.
    pub lit: bool,
}

#[derive(Debug, Clone, Default)]
pub struct Cache {
    pub cells: Cells,
    pub means: Vec<Cell>,
    /// Visible share of each light per cell, cell by cell.
    pub visibility: Vec<f32>,
    /// Directions of incident light per cell, of BILL alone; `None` where no light was seen.
    pub incident: Vec<Option<VmfMixture>>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: u32,
    /// Records that saw light.
    lit: u32,
    area: f64,
    p: DVec3,
    n: DVec3,
    irradiance: DVec3,
}

/// Below this length of the mean of unit normals a cell is folded, and its normal means nothing.
const FOLDED: f64 = 0.3;

/// Share of visibility that no light loses: what a few samples did not see may still be seen.
const LEAST_VISIBLE: f32 = 0.1;

/// Prior of an unseen light, in samples that see it.
const VISIBILITY_PRIOR: f32 = 1.0;

impl Cache {
    /// From records in a fixed order. A cell is lit from `least_lit` records that saw light; `lights` in all.
    pub fn build(size: f32, records: &[Record], least_lit: u32, lights: usize) -> Self {
        let mut cells = Cells::new(size);
        let mut sums: Vec<Sums> = Vec::new();
        let mut seen: Vec<[f32; 2]> = Vec::new();
        for record in records {
            let at = cells.find_or_insert(record.p, record.n) as usize;
            if at == sums.len() {
                sums.push(Sums::default());
                seen.resize(seen.len() + lights, [0.0; 2]);
            }
            sums[at].add(record);
            for light in &record.lights {
                let [visible, unshadowed] = &mut seen[at * lights + light.light as usize];
                *visible += light.visible;
                *unshadowed += light.unshadowed;
            }
        }
        let visibility = sums.iter().enumerate().flat_map(|(at, sums)| {
            let prior = VISIBILITY_PRIOR / sums.count as f32;
            seen[at * lights..(at + 1) * lights].iter().map(move |[visible, unshadowed]| {
                let share = if *unshadowed > 0.0 { visible / unshadowed } else { 1.0 };
                ((share + prior) / (1.0 + prior)).clamp(LEAST_VISIBLE, 1.0)
            })
        });
        let means = sums.iter().map(|s| s.mean(least_lit)).collect();
        Self { visibility: visibility.collect(), means, cells, incident: Vec::new() }
    }

    /// Fits the directions of incident light in every cell.
    pub fn with_incident(mut self, records: &[Record]) -> Self {
        let mut directions = vec![Vec::new(); self.means.len()];
        for record in records {
            if let Some(cell) = self.cells.find(record.p, record.n) {
                let all = record.directions.iter().chain(&record.indirect);
                directions[cell as usize].extend(all.map(|(d, e)| (*d, e * record.area)));
            }
        }
        self.incident = directions.par_iter().map(|directions| fit(directions, MAX_LOBES)).collect();
        self
    }

    /// Visible share of every light, at a cell.
    pub fn visibility(&self, cell: u32) -> &[f32] {
        let lights = self.visibility.len() / self.means.len().max(1);
        &self.visibility[cell as usize * lights..(cell as usize + 1) * lights]
    }

    pub fn memory(&self) -> usize {
        let cells = self.means.len() * size_of::<Cell>() + self.incident.len() * size_of::<Option<VmfMixture>>();
        self.cells.memory() + cells + self.visibility.len() * 4
    }
}

impl Sums {
    fn add(&mut self, record: &Record) {
        let area = f64::from(record.area);
        self.count += 1;
        self.lit += u32::from(mean(record.irradiance) > 0.0);
        self.area += area;
        self.p += record.p.as_dvec3() * area;
        self.n += record.n.as_dvec3() * area;
        self.irradiance += record.irradiance.as_dvec3() * area;
    }

    fn mean(&self, least_lit: u32) -> Cell {
        let normal = self.n / self.area;
        Cell {
            point: (self.p / self.area).as_vec3(),
            normal: normal.normalize_or(DVec3::Z).as_vec3(),
            area: self.area as f32,
            irradiance: (self.irradiance / self.area).as_vec3(),
            lit: self.lit >= least_lit && normal.length() > FOLDED,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(p: Vec3, n: Vec3, irradiance: f32) -> Record {
        let lights = vec![LightRecord { light: 1, visible: irradiance, unshadowed: 2.0 }];
        Record { p, n, area: 0.5, irradiance: Rgb::splat(irradiance), lights, directions: Vec::new(), indirect: None }
    }

    #[test]
    fn cells_hold_means() {
        let up = [0.2, 0.4].map(|x| record(Vec3::new(x, 0.1, 0.1), Vec3::Z, 1.0));
        let folded = [Vec3::X, Vec3::new(0.8, 0.0, 0.6)].map(|n| record(Vec3::splat(5.5), n, 0.0));
        let records: Vec<Record> = up.into_iter().chain(folded).collect();
        let cache = Cache::build(1.0, &records, 2, 2);
        assert_eq!(cache.means.len(), 2);
        let cell = cache.means[0];
        assert_eq!((cell.area, cell.irradiance, cell.lit, cell.normal), (1.0, Rgb::ONE, true, Vec3::Z));
        assert!((cell.point - Vec3::new(0.3, 0.1, 0.1)).length() < 1e-6);
        assert!(!cache.means[1].lit);
        // Light 1 half visible, pulled up by the prior of half a sample in two; light 0 was never asked.
        assert!((cache.visibility(0)[1] - 2.0 / 3.0).abs() < 1e-6 && cache.visibility(0)[0] == 1.0);
        assert!((cache.visibility(1)[1] - 1.0 / 3.0).abs() < 1e-6);
    }
}
