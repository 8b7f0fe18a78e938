//! Dome lights: a latlong map around everything.
//!
//! OpenEXR's convention, which UsdLux takes over: latitude 0, longitude 0 is +Z, longitude pi/2 is +X, the
//! image's first pixel has latitude pi/2 and longitude pi. With poleAxis Z the whole is turned so that the
//! pole is +Z and (0, 0) is -Y. A pixel covers its share of the sphere, the first beginning at longitude pi.

use super::{
    emission::{Emission, magnitude},
    texels::Texels,
};
use crate::{
    math::{Affine, Frame, PI, Rgb, TAU},
    sampling::{
        UNIFORM_SPHERE_PDF, cosine_hemisphere, cosine_hemisphere_pdf, distribution::Distribution2D, uniform_sphere,
    },
};
use glam::{Mat3, Vec2, Vec3};
use std::f64;

/// Pixels this much brighter than the mean of the sphere are suns: together they fill a 25th of it at most.
const SUN: f64 = 25.0;

#[derive(Debug, Clone)]
pub struct Dome {
    radiance: Rgb,
    map: Option<Map>,
    /// Mean over the sphere of the radiance' magnitude.
    average: f32,
}

impl Dome {
    /// `pole_axis` is `Z`, or `Y` for anything else.
    pub fn new(emission: &Emission, texels: Option<Texels>, placement: &Affine, pole_axis: &str) -> Self {
        let radiance = emission.radiance;
        let Some(texels) = texels else { return Self { radiance, map: None, average: magnitude(radiance) } };
        match Map::new(texels, placement, pole_axis) {
            Some(map) => Self { radiance, average: magnitude(radiance) * map.average(), map: Some(map) },
            // A black map: no light.
            None => Self { radiance: Rgb::ZERO, map: None, average: 0.0 },
        }
    }

    pub fn shines(&self) -> bool {
        self.average > 0.0
    }

    /// Direction and its solid-angle pdf: by the map's brightness, else by the receiver's cosine, else uniform.
    pub fn sample(&self, n: Option<Vec3>, u: Vec2) -> (Vec3, f32) {
        match (&self.map, n) {
            (Some(map), _) => map.sample(u),
            (None, Some(n)) => {
                let local = cosine_hemisphere(u);
                (Frame::from_normal(n).to_world(local), cosine_hemisphere_pdf(local.z))
            }
            (None, None) => (uniform_sphere(u), UNIFORM_SPHERE_PDF),
        }
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, n: Option<Vec3>, wi: Vec3) -> f32 {
        match (&self.map, n) {
            (Some(map), _) => map.pdf(wi),
            (None, Some(n)) => cosine_hemisphere_pdf(n.dot(wi)),
            (None, None) => UNIFORM_SPHERE_PDF,
        }
    }

    /// Radiance from direction `wi`.
    pub fn radiance(&self, wi: Vec3) -> Rgb {
        self.radiance * self.map.as_ref().map_or(Rgb::ONE, |map| map.lookup(wi))
    }

    /// Whether half of its light or more comes from small suns. Looks at every pixel.
    pub fn has_suns(&self) -> bool {
        self.map.as_ref().is_some_and(|map| map.share_of_suns() >= 0.5)
    }

    /// Irradiance if the average came from everywhere.
    pub fn importance(&self) -> f32 {
        PI * self.average
    }
}

/// The image and how brightness is distributed over its pixels.
#[derive(Debug, Clone)]
struct Map {
    texels: Texels,
    choice: Distribution2D,
    /// cos of the polar angle at the edges of the rows, `height + 1` values from 1 to -1.
    bands: Vec<f64>,
    /// Render space to the map's frame (pole +Y, longitude 0 at +Z), and back.
    to_map: Mat3,
    from_map: Mat3,
    /// |det to_map|^(1/3)
    size: f32,
}

impl Map {
    /// `None` where the image is black.
    fn new(texels: Texels, placement: &Affine, pole_axis: &str) -> Option<Self> {
        let (w, h) = (texels.width(), texels.height());
        let bands: Vec<f64> = (0..=h).map(|y| (f64::consts::PI * y as f64 / h as f64).cos()).collect();
        let choice = Distribution2D::new(w, h, |x, y| texels.mean_magnitude(x, y) * (bands[y] - bands[y + 1]))?;
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
    fn average(&self) -> f32 {
        (self.choice.sum() / (2.0 * self.texels.width() as f64)) as f32
    }

    /// Share of the light that comes from pixels [`SUN`] times as bright as the mean or more.
    fn share_of_suns(&self) -> f64 {
        let (w, h) = (self.texels.width(), self.texels.height());
        let row = |y: usize| {
            let of_sphere = 0.5 * (self.bands[y] - self.bands[y + 1]) / w as f64;
            let shares = (0..w).map(move |x| self.choice.probability(x, y));
            shares.filter(move |share| *share >= SUN * of_sphere).sum::<f64>()
        };
        (0..h).map(row).sum()
    }

    fn sample(&self, u: Vec2) -> (Vec3, f32) {
        let (column, row, [x, y]) = self.choice.sample(u);
        // Uniform per solid angle inside the pixel: in height and longitude.
        let cos = self.bands[row] + y * (self.bands[row + 1] - self.bands[row]);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let longitude = f64::consts::PI * (1.0 - 2.0 * (column as f64 + x) / self.texels.width() as f64);
        let local = glam::DVec3::new(sin * longitude.sin(), cos, sin * longitude.cos()).as_vec3();
        let wi = (self.from_map * local).normalize();
        (wi, self.cell_pdf(column, row) * self.stretch(wi))
    }

    /// Solid-angle pdf of [`Self::sample`].
    fn pdf(&self, wi: Vec3) -> f32 {
        let (s, t) = self.st(wi);
        let cell = |a: f32, n: usize| ((a * n as f32) as usize).min(n - 1);
        self.cell_pdf(cell(s, self.texels.width()), cell(t, self.texels.height())) * self.stretch(wi)
    }

    fn lookup(&self, wi: Vec3) -> Rgb {
        let (s, t) = self.st(wi);
        self.texels.lookup(s, t)
    }

    /// Per solid angle of the map's frame.
    fn cell_pdf(&self, column: usize, row: usize) -> f32 {
        let solid_angle = f64::consts::TAU / self.texels.width() as f64 * (self.bands[row] - self.bands[row + 1]);
        (self.choice.probability(column, row) / solid_angle) as f32
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
