//! The boundary cache: what light reaches each cell of a medium's boundary.
//!
//! Filled from boundary points with an irradiance estimate each; means per cell. Section 2.2 of guiding.md.

use super::cells::Cells;
use super::fit::fit;
use super::vmf::{MAX_LOBES, VmfMixture};
use crate::light::Parts;
use crate::math::{Rgb, mean};
use bytemuck::{Pod, Zeroable};
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
    /// From lights.
    pub directions: Vec<Incident>,
    /// A direction by which light came from another surface.
    pub indirect: Option<Incident>,
}

/// Light from one direction.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Incident {
    pub wi: Vec3,
    pub irradiance: f32,
}

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
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
    /// Visible share of each part of the lights per cell, cell by cell; empty: not learned.
    pub visibility: Vec<f32>,
    /// Directions of incident light per cell, of BILL alone; `None` where no light was seen.
    pub incident: Vec<Option<VmfMixture>>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sums {
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

/// Prior of a part, in samples that see of it what is seen of the part around it; of lights, in samples that see them.
const VISIBILITY_PRIOR: f32 = 1.0;

impl Cache {
    /// From records in a fixed order. A cell is lit from `least_lit` records that saw light; of `parts` of the lights visible
    /// shares are learned, if there are any.
    pub fn build(size: f32, records: &[Record], least_lit: u32, parts: &Parts) -> Self {
        let mut cells = Cells::new(size);
        let mut sums: Vec<Sums> = Vec::new();
        let mut seen: Vec<Seen> = Vec::new();
        for record in records {
            let at = cells.find_or_insert(record.p, record.n) as usize;
            if at == sums.len() {
                sums.push(Sums::default());
                seen.resize(seen.len() + parts.len(), Seen::default());
            }
            sums[at].add(record);
            for light in record.lights.iter().filter(|_| !parts.is_empty()) {
                parts.holding(light.light).for_each(|part| seen[at * parts.len() + part].add(light));
            }
        }
        let mut visibility: Vec<f32> = Vec::with_capacity(seen.len());
        for (i, seen) in seen.iter().enumerate() {
            let first = i - i % parts.len();
            let around = parts.parents[i % parts.len()].map_or(1.0, |part| visibility[first + part as usize]);
            visibility.push(seen.share(around));
        }
        let means = sums.iter().map(|s| s.mean(least_lit)).collect();
        Self { visibility, means, cells, incident: Vec::new() }
    }

    /// Fits the directions of incident light in every cell.
    pub fn with_incident(mut self, records: &[Record]) -> Self {
        let mut directions = vec![Vec::new(); self.means.len()];
        for record in records {
            if let Some(cell) = self.cells.find(record.p, record.n) {
                let all = record.directions.iter().chain(&record.indirect);
                directions[cell as usize].extend(all.map(|from| (from.wi, from.irradiance * record.area)));
            }
        }
        self.incident = directions.par_iter().map(|directions| fit(directions, MAX_LOBES)).collect();
        self
    }

    /// Visible share of every part of the lights, at a cell.
    pub fn visibility(&self, cell: u32) -> &[f32] {
        let parts = self.visibility.len() / self.means.len().max(1);
        &self.visibility[cell as usize * parts..(cell as usize + 1) * parts]
    }

    pub fn memory(&self) -> usize {
        let cells = self.means.len() * size_of::<Cell>() + self.incident.len() * size_of::<Option<VmfMixture>>();
        self.cells.memory() + cells + self.visibility.len() * 4
    }
}

/// Of one part of the lights, as records of one cell have it.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    count: f32,
    visible: f32,
    unshadowed: f32,
}

impl Seen {
    fn add(&mut self, light: &LightRecord) {
        self.count += 1.0;
        self.visible += light.visible;
        self.unshadowed += light.unshadowed;
    }

    /// `around`: the share of the part around it.
    fn share(&self, around: f32) -> f32 {
        let share = if self.unshadowed > 0.0 { self.visible / self.unshadowed } else { around };
        let mean = (self.count * share + VISIBILITY_PRIOR * around) / (self.count + VISIBILITY_PRIOR);
        mean.clamp(LEAST_VISIBLE, 1.0)
    }
}

impl Sums {
    fn add(&mut self, record: &Record) {
        let area = f64::from(record.area);
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
        let cache = Cache::build(1.0, &records, 2, &Parts::single(2));
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
