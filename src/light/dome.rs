//! Dome lights: a colour or a latlong map around everything.

use super::{
    emission::{Emission, magnitude},
    latlong::Map,
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
