//! Light that has refracted into a medium and not been scattered yet: by cells of the volume how much there is, and where
//! it comes from.
//!
//! Beams of light are marched through the cells before the first pass (as photon beams are, Jarosz et al. 2011). Collisions
//! draw directions from them to look for light; what the cells do not know is found by chance.

use super::vmf::{MAX_CONCENTRATION, Vmf};
use crate::math::mean;
use crate::medium::Medium;
use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec2, Vec3};
use rayon::prelude::*;

/// Light that entered at a boundary point.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Beam {
    /// Walk space.
    pub p: Vec3,
    /// Unit, against the light: from within towards `p`.
    pub towards: Vec3,
    /// To the boundary beyond.
    pub length: f32,
    /// Mean of the channels.
    pub power: f32,
}

/// Lobes of a cell, at most.
const LOBES: usize = 32;

/// Cells along the longest side: so many that about [`PER_CELL`] beams pass each that is passed at all.
const SIDE: std::ops::RangeInclusive<f32> = 4.0..=48.0;
const PER_CELL: f32 = 40.0;

/// A beam is followed while it carries this much.
const FAINT: f32 = 1e-3;

/// Squared radians between neighbours, of one more of them than there are: lone beams say little of their surroundings.
const LONE: f32 = 0.05;

/// Share of the directions that are drawn from lobes of a concentration of 1 / [`WIDER`]: beams are few, and light between them that
/// no look finds has chance's noise. Both are flat optima (docs/performance.md, "Smooth dielectrics").
const WIDE: f32 = 0.5;
const WIDER: f32 = 4.0;

/// A cell's light: its lobes are equally likely.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    first: u32,
    count: u32,
    /// Concentration of the narrow lobes.
    k: f32,
    /// Relative to what is usual in the body.
    pub fluence: f32,
    /// Mean direction towards the light, not unit.
    pub towards: Vec3,
}

/// The cells of one body, in its walk space.
#[derive(Debug)]
pub struct Beams {
    min: Vec3,
    size: f32,
    side: IVec3,
    /// By place; `u32::MAX`: no light known.
    index: Vec<u32>,
    cells: Vec<Cell>,
    lobes: Vec<Vec3>,
}

/// What a beam left in a cell.
struct Passed {
    place: u32,
    towards: Vec3,
    weight: f32,
}

impl Beams {
    /// `None` without light.
    pub fn build(beams: &[Beam], medium: &Medium) -> Option<Self> {
        let ends = beams.iter().flat_map(|beam| [beam.p, beam.p - beam.length * beam.towards]);
        let (min, max) = ends.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        let longest = (max - min).max_element();
        if !(longest > 0.0 && longest.is_finite()) {
            return None;
        }
        let side = (beams.len() as f32 / PER_CELL).sqrt().clamp(*SIDE.start(), *SIDE.end());
        let size = longest / side;
        let side = ((max - min) / size).floor().as_ivec3() + IVec3::ONE;
        let index = vec![u32::MAX; (side.x * side.y * side.z) as usize];
        let mut new = Self { min, size, side, index, cells: Vec::new(), lobes: Vec::new() };
        let mut passed: Vec<Passed> =
            beams.par_iter().enumerate().flat_map_iter(|(i, beam)| new.march(i, beam, medium)).collect();
        passed.par_sort_by_key(|passed| passed.place); // stable: a function of the beams alone
        let of_cells: Vec<&[Passed]> = passed.chunk_by(|a, b| a.place == b.place).collect();
        let made: Vec<(Cell, Vec<Vec3>)> = of_cells.par_iter().map(|passed| cell(passed)).collect();
        for (passed, (cell, lobes)) in of_cells.iter().zip(made) {
            new.index[passed[0].place as usize] = new.cells.len() as u32;
            new.cells.push(Cell { first: new.lobes.len() as u32, ..cell });
            new.lobes.extend(lobes);
        }
        new.relate();
        (!new.cells.is_empty()).then_some(new)
    }

    /// A point in each cell's length of the beam.
    fn march(&self, i: usize, beam: &Beam, medium: &Medium) -> Vec<Passed> {
        let first = (i as f32 * 0.618_034).fract(); // golden ratio: beams are out of step with one another
        let mut passed = Vec::new();
        for step in 0.. {
            let t = (step as f32 + first) * self.size;
            let weight = beam.power * mean(medium.transmittance(t));
            if t >= beam.length || weight < FAINT * beam.power {
                break;
            }
            if let (Some(place), true) = (self.place(beam.p - t * beam.towards), weight > 0.0) {
                passed.push(Passed { place: place as u32, towards: beam.towards, weight });
            }
        }
        passed
    }

    fn place(&self, p: Vec3) -> Option<usize> {
        let at = (p - self.min) / self.size;
        // Truncated, which from 0 on is the floor: that is a call without SSE 4.1.
        let (above, at) = (at.cmpge(Vec3::ZERO).all(), at.as_ivec3());
        let inside = above && at.cmplt(self.side).all();
        inside.then(|| ((at.z * self.side.y + at.y) * self.side.x + at.x) as usize)
    }

    /// Fluence relative to the mean that a ray of light sees.
    fn relate(&mut self) {
        let sum: f32 = self.cells.iter().map(|cell| cell.fluence).sum();
        let squares: f32 = self.cells.iter().map(|cell| cell.fluence * cell.fluence).sum();
        self.cells.iter_mut().for_each(|cell| cell.fluence *= sum / squares);
    }

    /// The cell at `p`, walk space.
    pub fn find(&self, p: Vec3) -> Option<u32> {
        self.index.get(self.place(p)?).copied().filter(|cell| *cell != u32::MAX)
    }

    pub fn cell(&self, cell: u32) -> &Cell {
        &self.cells[cell as usize]
    }

    fn lobes_of(&self, cell: &Cell) -> &[Vec3] {
        &self.lobes[cell.first as usize..(cell.first + cell.count) as usize]
    }

    /// Direction towards light, with density [`Self::pdf`].
    pub fn sample(&self, cell: u32, u_choice: f32, u: Vec2) -> Vec3 {
        let cell = self.cell(cell);
        let lobes = self.lobes_of(cell);
        let choice = u_choice * lobes.len() as f32;
        let mean = lobes[(choice as usize).min(lobes.len() - 1)];
        let k = if choice.fract() < WIDE { cell.k / WIDER } else { cell.k };
        Vmf { mean, k }.sample(u)
    }

    /// Solid-angle pdf.
    pub fn pdf(&self, cell: u32, w: Vec3) -> f32 {
        let cell = self.cell(cell);
        let lobes = self.lobes_of(cell);
        let of = |share: f32, k: f32| {
            let sum: f32 = lobes.iter().map(|&mean| Vmf { mean, k }.falloff(w)).sum();
            share * Vmf { mean: w, k }.peak() * sum
        };
        (of(1.0 - WIDE, cell.k) + of(WIDE, cell.k / WIDER)) / lobes.len() as f32
    }

    /// Bytes, about.
    pub fn memory(&self) -> usize {
        4 * self.index.len() + size_of::<Cell>() * self.cells.len() + size_of::<Vec3>() * self.lobes.len()
    }
}

/// What passed it as a cell with its lobes, which are drawn by weight, in strata.
fn cell(passed: &[Passed]) -> (Cell, Vec<Vec3>) {
    let fluence: f32 = passed.iter().map(|passed| passed.weight).sum();
    let sum: Vec3 = passed.iter().map(|passed| passed.weight * passed.towards).sum();
    let count = passed.len().min(LOBES);
    let (mut below, mut next, mut lobes) = (0.0, 0, Vec::with_capacity(count));
    for passed in passed {
        below += passed.weight;
        while next < count && (next as f32 + 0.5) * fluence <= below * count as f32 {
            lobes.push(passed.towards);
            next += 1;
        }
    }
    let (k, towards) = (concentration(&lobes), sum / fluence);
    (Cell { first: 0, count: lobes.len() as u32, k, fluence, towards }, lobes)
}

/// Of kernels as wide as the lobes are apart.
fn concentration(lobes: &[Vec3]) -> f32 {
    let nearest = |i: usize| {
        let others = lobes.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, w)| (*w - lobes[i]).length_squared()).fold(LONE, f32::min)
    };
    let sum: f32 = (0..lobes.len()).map(nearest).sum();
    ((lobes.len() + 1) as f32 / (sum + LONE)).min(MAX_CONCENTRATION)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;
    use crate::sampling::sampler::Sampler;
    use crate::sampling::{direction_about, uniform_sphere};

    const CLEAR: Medium = Medium { sigma_t: Rgb::ZERO, albedo: Rgb::ZERO, g: 0.0 };

    /// Through the origin from around +z, and one elsewhere.
    fn beams() -> Beams {
        let mut sampler = Sampler::new(1, 2, 3);
        let mut beam = |_| {
            let towards = (0.7 * uniform_sphere(Vec2::new(sampler.random(), sampler.random())) + Vec3::Z).normalize();
            Beam { p: towards, towards, length: 1.0 + sampler.random(), power: 0.5 + sampler.random() }
        };
        let mut beams: Vec<Beam> = (0..40).map(&mut beam).collect();
        beams.push(Beam { p: Vec3::new(5.0, 5.0, 5.0), towards: Vec3::X, length: 4.0, power: 1.0 });
        Beams::build(&beams, &CLEAR).expect("light")
    }

    /// Chi-square over bins of equal solid angle against the integral of the pdf.
    #[test]
    fn directions_have_their_pdf() {
        const BINS: [usize; 2] = [12, 8];
        const STEPS: usize = 40;
        const COUNT: usize = 200_000;
        let beams = beams();
        let cell = beams.find(Vec3::splat(1e-3)).expect("beams pass");
        assert!(beams.lobes_of(beams.cell(cell)).len() > 4);
        let mut expected = vec![0.0; BINS[0] * BINS[1]];
        for (bin, share) in expected.iter_mut().enumerate() {
            for k in 0..STEPS * STEPS {
                let x = |i: usize, step: usize, n: usize| (i as f64 + (step as f64 + 0.5) / STEPS as f64) / n as f64;
                let (u, v) = (x(bin / BINS[1], k / STEPS, BINS[0]), x(bin % BINS[1], k % STEPS, BINS[1]));
                *share += f64::from(beams.pdf(cell, direction_about(Vec3::Z, 2.0 - 2.0 * u as f32, v as f32)));
            }
            *share *= 4.0 * std::f64::consts::PI / (STEPS * STEPS * BINS[0] * BINS[1]) as f64;
        }
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 1e-3, "{total}");
        let (mut sampler, mut counts) = (Sampler::new(3, 1, 4), vec![0.0; expected.len()]);
        let frame = crate::math::Frame::from_normal(Vec3::Z);
        for _ in 0..COUNT {
            let u = Vec2::new(sampler.random(), sampler.random());
            let w = frame.to_local(beams.sample(cell, sampler.random(), u));
            let v = (w.y.atan2(w.x) / std::f32::consts::TAU).rem_euclid(1.0);
            let index = |u: f32, n: usize| ((u * n as f32) as usize).min(n - 1);
            counts[index(0.5 * (w.z + 1.0), BINS[0]) * BINS[1] + index(v, BINS[1])] += 1.0;
        }
        let likely = |share: f64| share * COUNT as f64 > 5.0;
        let terms = counts.iter().zip(&expected).filter(|(_, share)| likely(**share));
        let chi2: f64 = terms.map(|(n, share)| (n - share * COUNT as f64).powi(2) / (share * COUNT as f64)).sum();
        // Chi-square with 95 degrees of freedom exceeds 152 with probability 2e-4.
        assert!(chi2 < 152.0, "{chi2}");
    }

    #[test]
    fn cells_know_what_passed() {
        let beams = beams();
        let at = |p: Vec3| beams.find(p).map(|cell| *beams.cell(cell));
        let side = at(Vec3::new(3.0, 5.0, 5.0)).expect("a beam passes");
        assert!(side.towards.dot(Vec3::X) > 0.999);
        let middle = at(Vec3::splat(1e-3)).expect("beams pass");
        assert!(middle.towards.z > 0.5 && middle.fluence > side.fluence);
        assert!(at(Vec3::new(4.0, 0.0, 4.0)).is_none() && at(Vec3::splat(100.0)).is_none());
        assert!(Beams::build(&[], &CLEAR).is_none());
    }
}
