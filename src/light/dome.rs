//! Dome lights: a colour or a latlong map around everything, sampled with the help of portals where it has some.

use super::{
    emission::{Emission, magnitude},
    latlong::Map,
    portal::Portals,
    texels::Texels,
};
use crate::{
    math::{Affine, Frame, PI, Rgb},
    sampling::{UNIFORM_SPHERE_PDF, cosine_hemisphere, cosine_hemisphere_pdf, uniform_sphere},
};
use glam::{Vec2, Vec3};

#[derive(Debug, Clone)]
pub struct Dome {
    radiance: Rgb,
    map: Option<Map>,
    portals: Option<Box<Portals>>,
    /// Mean over the sphere of the radiance' magnitude.
    average: f32,
}

impl Dome {
    /// `pole_axis` is `Z`, or `Y` for anything else.
    pub fn new(emission: &Emission, texels: Option<Texels>, placement: &Affine, pole_axis: &str) -> Self {
        let radiance = emission.radiance;
        let Some(texels) = texels else {
            return Self { radiance, map: None, portals: None, average: magnitude(radiance) };
        };
        match Map::new(texels, placement, pole_axis) {
            Some(map) => Self { radiance, portals: None, average: magnitude(radiance) * map.average(), map: Some(map) },
            // A black map: no light.
            None => Self { radiance: Rgb::ZERO, map: None, portals: None, average: 0.0 },
        }
    }

    pub fn guided(self, portals: Option<Portals>) -> Self {
        Self { portals: portals.map(Box::new), ..self }
    }

    pub fn has_portals(&self) -> bool {
        self.portals.is_some()
    }

    pub fn shines(&self) -> bool {
        self.average > 0.0
    }

    /// Direction for the receiver at p and its solid-angle pdf: half of them through portals where p sees some. `None`: this
    /// sample contributes nothing.
    pub fn sample(&self, p: Vec3, n: Option<Vec3>, u: Vec2) -> Option<(Vec3, f32)> {
        let Some(portals) = self.portals.as_ref().and_then(|portals| portals.seen_from(p, n)) else {
            return Some(self.sample_all(n, u));
        };
        let doubled = 2.0 * u.x;
        let (wi, through) = match doubled < 1.0 {
            true => {
                let wi = self.sample_all(n, Vec2::new(doubled, u.y)).0;
                (wi, portals.pdf(wi))
            }
            false => portals.sample(Vec2::new(doubled - 1.0, u.y))?,
        };
        let pdf = 0.5 * (self.pdf_all(n, wi) + through);
        (pdf > 0.0 && pdf.is_finite()).then_some((wi, pdf))
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, p: Vec3, n: Option<Vec3>, wi: Vec3) -> f32 {
        let all = self.pdf_all(n, wi);
        let portals = self.portals.as_ref().and_then(|portals| portals.seen_from(p, n));
        portals.map_or(all, |portals| 0.5 * (all + portals.pdf(wi)))
    }

    /// Without portals: by the map's brightness, else by the receiver's cosine, else uniform.
    fn sample_all(&self, n: Option<Vec3>, u: Vec2) -> (Vec3, f32) {
        match (&self.map, n) {
            (Some(map), _) => map.sample(u),
            (None, Some(n)) => {
                let local = cosine_hemisphere(u);
                (Frame::from_normal(n).to_world(local), cosine_hemisphere_pdf(local.z))
            }
            (None, None) => (uniform_sphere(u), UNIFORM_SPHERE_PDF),
        }
    }

    /// Solid-angle pdf of [`Self::sample_all`].
    fn pdf_all(&self, n: Option<Vec3>, wi: Vec3) -> f32 {
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
