//! Slabs as enclosures, estimates with their errors, and the adding-doubling tables to compare with.

use dermis::math::Rgb;
use dermis::sampling::{cosine_hemisphere, sampler::Sampler};
use dermis::subsurface::steps::Enclosure;
use glam::Vec3;
use std::path::Path;

/// 0 < z < thickness, infinite in x and y. `true` is the face at z = 0.
pub struct Slab {
    pub thickness: f32,
}

impl Enclosure for Slab {
    type Hit = bool;

    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<bool>) -> Option<(f32, bool)> {
        let top = d.z < 0.0;
        let t = if top { -p.z / d.z } else { (self.thickness - p.z) / d.z };
        (from != Some(top) && t < t_max).then_some((t.max(0.0), top))
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        (-1e-3..=self.thickness * 1.001 + 1e-3).contains(&p.z)
    }

    fn position_error(&self) -> f32 {
        1e-6
    }
}

/// Mean and standard error of the mean, per channel.
#[derive(Default, Clone, Copy)]
pub struct Estimate {
    pub sum: glam::DVec3,
    pub squares: glam::DVec3,
    pub n: f64,
}

impl Estimate {
    pub fn add(&mut self, x: Rgb) {
        let x = x.as_dvec3();
        self.sum += x;
        self.squares += x * x;
        self.n += 1.0;
    }

    pub fn mean(&self) -> glam::DVec3 {
        self.sum / self.n
    }

    /// Of the first channel, with [`Self::z_of`].
    pub fn z(&self, expected: f64) -> f64 {
        self.z_of(0, expected, 1.0)
    }

    /// Deviation of a channel's mean in standard errors. Variance at least that of an analog walk whose weights are 0
    /// or `weight`: rare events may not have been met at all.
    pub fn z_of(&self, channel: usize, expected: f64, weight: f64) -> f64 {
        let mean = self.mean()[channel];
        let analog = (expected * (weight - expected)).max(0.0);
        let variance = (self.squares[channel] / self.n - mean * mean).max(analog);
        // The tables are good to 2e-4 of R where it is smallest, and to 4e-5 of T; weights are f32.
        let rounding = 1e-5 * expected + 1e-8 * weight;
        (mean - expected) / (variance / self.n + rounding * rounding).sqrt()
    }
}

pub struct SlabFluxes {
    pub reflected: Estimate,
    pub transmitted: Estimate,
}

/// How the slab is lit: by a Lambertian sky or a beam of the given cosine.
#[derive(Clone, Copy)]
pub enum Beam {
    Diffuse,
    Cosine(f32),
}

impl Beam {
    /// Direction of incidence, z into the slab.
    pub fn direction(self, sampler: &mut Sampler) -> Vec3 {
        match self {
            Beam::Diffuse => cosine_hemisphere(sampler.next_2d()),
            Beam::Cosine(mu) => Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu),
        }
    }
}

/// One row of a table of slabs.
#[derive(Clone, Copy)]
pub struct Row {
    pub g: f32,
    pub eta: f32,
    pub alpha: f32,
    pub tau: f32,
    pub beam: Beam,
    pub r: f64,
    pub t: f64,
}

impl Row {
    pub fn label(&self) -> String {
        let beam = if matches!(self.beam, Beam::Diffuse) { "diffuse" } else { "normal" };
        format!("g {} eta {} alpha {} tau {} {beam}", self.g, self.eta, self.alpha, self.tau)
    }
}

/// `None`, with a word on stderr, where ../shared is absent.
pub fn reference_rows() -> Option<Vec<Row>> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/reference_slab.csv");
    let Ok(text) = std::fs::read_to_string(&file) else {
        eprintln!("skipped: {} is absent", file.display());
        return None;
    };
    Some(parse(&text, [7, 8]))
}

/// The table that guided walks are compared with, tests/reference/slab.csv.
pub fn guided_rows() -> Vec<Row> {
    parse(include_str!("../reference/slab.csv"), [5, 6])
}

/// The table of the stability rows, tests/stability/reference.csv.
pub fn stability_rows() -> Vec<Row> {
    parse(include_str!("../stability/reference.csv"), [5, 6])
}

/// Rows of a table with R and T in the given columns.
fn parse(text: &str, [r, t]: [usize; 2]) -> Vec<Row> {
    let row = |line: &str| {
        let cell: Vec<&str> = line.split(',').collect();
        let number = |i: usize| cell[i].parse::<f64>().expect("a number in the reference table");
        Row {
            g: number(0) as f32,
            eta: number(1) as f32,
            alpha: number(2) as f32,
            tau: number(3) as f32,
            beam: if cell[4] == "diffuse" { Beam::Diffuse } else { Beam::Cosine(1.0) },
            r: number(r),
            t: number(t),
        }
    };
    text.lines().filter(|l| l.starts_with(['0', '-'])).map(row).collect()
}

/// |z| that one of `tests` independent tests exceeds with probability 1e-3 (Bonferroni, normal tail bound).
pub fn z_limit(tests: usize) -> f64 {
    (2.0 * (2.0 * tests as f64 / 1e-3).ln()).sqrt()
}

/// Those of many z-tests together that fail, each with what it tests.
pub fn failures(tests: &[(String, f64)]) -> Vec<String> {
    let limit = z_limit(tests.len());
    let failed = tests.iter().filter(|(_, z)| z.is_nan() || z.abs() >= limit);
    failed.map(|(what, z)| format!("{what}: z {z:.1}")).collect()
}

/// The verdict over many z-tests together: says the worst, and panics with all that fail.
pub fn judge(name: &str, tests: Vec<(String, f64)>) {
    let limit = z_limit(tests.len());
    let worst = tests.iter().map(|(_, z)| z.abs()).fold(0.0, f64::max);
    eprintln!("{name}: worst |z| {worst:.2} of {} (limit {limit:.2})", tests.len());
    let failed = failures(&tests);
    assert!(failed.is_empty(), "{name}, {} of {}:\n{}", failed.len(), tests.len(), failed.join("\n"));
}
