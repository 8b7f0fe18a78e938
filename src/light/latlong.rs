//! Latlong maps, sampled as they are looked up.
//!
//! OpenEXR's convention, which UsdLux takes over: latitude 0, longitude 0 is +Z, longitude pi/2 is +X, the
//! image's first pixel has latitude pi/2 and longitude pi. With poleAxis Z the whole is turned so that the
//! pole is +Z and (0, 0) is -Y. A pixel covers its share of the sphere, the first beginning at longitude pi.
//!
//! Looked up bilinearly, the map is smooth between four pixel centres: these cells are drawn by their mean brightness and
//! solid angle, and the point in them by the bilinear brightness of its corners. It is linear in latitude's cosine there where
//! the lookup is in latitude, which the pdf knows and small pixels do not notice.

use super::texels::Texels;
use crate::{
    math::{Affine, PI, Rgb, TAU},
    sampling::distribution::{BLOCK, Block, Distribution2D},
};
use glam::{Mat3, Vec2, Vec3};
use std::{f64, ops::Range};

/// Pixels this much brighter than the mean of the sphere are suns: together they fill a 25th of it at most.
const SUN: f64 = 25.0;

/// The image and how brightness is distributed over the cells between its pixel centres.
#[derive(Debug, Clone)]
pub struct Map {
    texels: Texels,
    /// Of cells: column x lies between the centres of pixel columns x and x + 1, row y between those of rows y - 1 and y, the
    /// first and the last between a centre and a pole.
    choice: Distribution2D,
    /// cos of the polar angle at the edges of the rows of cells, `height + 2` values from 1 to -1.
    bands: Vec<f64>,
    /// Render space to the map's frame (pole +Y, longitude 0 at +Z), and back.
    to_map: Mat3,
    from_map: Mat3,
    /// |det to_map|^(1/3)
    size: f32,
}

impl Map {
    /// `None` where the image is black.
    pub fn new(texels: Texels, placement: &Affine, pole_axis: &str) -> Option<Self> {
        let (w, h) = (texels.width(), texels.height());
        let centre = |y: usize| f64::consts::PI * (y as f64 + 0.5) / h as f64;
        let centres = (0..h).map(|y| centre(y).cos());
        let bands: Vec<f64> = std::iter::once(1.0).chain(centres).chain([-1.0]).collect();
        let choice = Distribution2D::new(w, h + 1, |columns, row| weights(&texels, &bands, columns, row))?;
        let turn = match pole_axis {
            // +Y to +Z, +Z to -Y.
            "Z" => Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y),
            _ => Mat3::IDENTITY,
        };
        let to_map = turn.transpose() * placement.inverse;
        let size = to_map.as_dmat3().determinant().abs().cbrt() as f32;
        Some(Self { texels, choice, bands, to_map, from_map: placement.linear * turn, size })
    }

    /// Mean magnitude over the sphere: the weights carry 2 of height for each of `width` columns.
    pub fn average(&self) -> f32 {
        (self.choice.sum() / (2.0 * self.texels.width() as f64)) as f32
    }

    /// Share of the light that comes from pixels [`SUN`] times as bright as the mean or more.
    pub fn share_of_suns(&self) -> f64 {
        let (w, h) = (self.texels.width(), self.texels.height());
        let (mean, edge) = (f64::from(self.average()), |y: usize| (f64::consts::PI * y as f64 / h as f64).cos());
        let row = |y: usize| {
            let of_sphere = 0.5 * (edge(y) - edge(y + 1)) / w as f64;
            let brightness = (0..w as i64).map(move |x| f64::from(self.texels.magnitude(x, y as i64)) / mean);
            brightness.filter(|b| *b >= SUN).sum::<f64>() * of_sphere
        };
        (0..h).map(row).sum()
    }

    /// Direction and its solid-angle pdf: by brightness.
    pub fn sample(&self, u: Vec2) -> (Vec3, f32) {
        let (column, row, u) = self.choice.sample(u, |columns, row| weights(&self.texels, &self.bands, columns, row));
        let corners = Corners::new(&self.texels, column, row);
        let [x, y] = corners.sample(u);
        // Uniform per solid angle is uniform in height and longitude.
        let cos = self.bands[row] + y * (self.bands[row + 1] - self.bands[row]);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let longitude = f64::consts::PI * (1.0 - 2.0 * (column as f64 + 0.5 + x) / self.texels.width() as f64);
        let local = glam::DVec3::new(sin * longitude.sin(), cos, sin * longitude.cos()).as_vec3();
        let wi = (self.from_map * local).normalize();
        (wi, self.density(&corners, x, y) * self.stretch(wi))
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, wi: Vec3) -> f32 {
        let (s, t) = self.st(wi);
        let (width, height) = (self.texels.width(), self.texels.height());
        let x = (s * width as f32 - 0.5).rem_euclid(width as f32);
        let (column, x) = ((x as usize).min(width - 1), f64::from(x.fract()));
        let row = ((t * height as f32 + 0.5) as usize).min(height);
        let (above, below) = (self.bands[row], self.bands[row + 1]);
        // Rounding may put a direction at a cell's edge outside it.
        let y = ((above - (f64::consts::PI * f64::from(t)).cos()) / (above - below)).clamp(0.0, 1.0);
        self.density(&Corners::new(&self.texels, column, row), x, y) * self.stretch(wi)
    }

    pub fn lookup(&self, wi: Vec3) -> Rgb {
        let (s, t) = self.st(wi);
        self.texels.lookup(s, t)
    }

    /// Per solid angle of the map's frame: brightness over its integral, the mean of which over a cell is that of its corners.
    fn density(&self, corners: &Corners, x: f64, y: f64) -> f32 {
        let columns = self.texels.width() as f64 / f64::consts::TAU;
        (corners.at(x, y) * columns / self.choice.sum()) as f32
    }

    /// d omega_map / d omega; 1 for rotations and uniform scales.
    fn stretch(&self, wi: Vec3) -> f32 {
        (self.size / (self.to_map * wi).length()).powi(3)
    }

    /// Image coordinates of a direction, t downwards.
    fn st(&self, wi: Vec3) -> (f32, f32) {
        let d = self.to_map * wi;
        let polar = d.x.hypot(d.z).atan2(d.y);
        (0.5 - d.x.atan2(d.z) / TAU, polar / PI)
    }
}

/// Mean brightness of cells times their height; all columns are as wide.
fn weights(texels: &Texels, bands: &[f64], columns: Range<usize>, row: usize) -> Block {
    let quarter = 0.25 * (bands[row] - bands[row + 1]);
    let at = |x: usize, y: i64| f64::from(texels.magnitude(x as i64, y));
    let edge = |x: usize| at(x, row as i64 - 1) + at(x, row as i64);
    let (mut block, mut left) = ([0.0; BLOCK], edge(columns.start));
    for (weight, column) in block.iter_mut().zip(columns) {
        let right = edge(column + 1);
        *weight = quarter * (left + right);
        left = right;
    }
    block
}

/// Brightness at the corners of a cell: left and right, above and below.
struct Corners {
    above: [f64; 2],
    below: [f64; 2],
}

impl Corners {
    fn new(texels: &Texels, column: usize, row: usize) -> Self {
        let at = |x: usize, y: i64| f64::from(texels.magnitude(x as i64, y));
        let line = |y: i64| [at(column, y), at(column + 1, y)];
        Self { above: line(row as i64 - 1), below: line(row as i64) }
    }

    /// Bilinear at (x, y) in [0, 1]^2.
    fn at(&self, x: f64, y: f64) -> f64 {
        let [left, right] = self.line(y);
        left + x * (right - left)
    }

    fn line(&self, y: f64) -> [f64; 2] {
        [0, 1].map(|i| self.above[i] + y * (self.below[i] - self.above[i]))
    }

    /// A point in proportion to [`Self::at`]: first y, by the sums of the rows.
    fn sample(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let y = sample_linear(self.above[0] + self.above[1], self.below[0] + self.below[1], v);
        let [left, right] = self.line(y);
        [sample_linear(left, right, u), y]
    }
}

/// x in [0, 1] with a density that goes from `a` to `b`, not both 0 (Pharr et al. 2023, section 2.3.2).
fn sample_linear(a: f64, b: f64, u: f64) -> f64 {
    let root = (a * a + u * (b * b - a * a)).max(0.0).sqrt();
    if a + root > 0.0 { (u * (a + b) / (a + root)).min(1.0) } else { u }
}
