//! What refracts to collisions: lights that look small, and those of a single direction.

use super::{Light, Lights, LightsAt, motion::to_time};
use crate::math::Rgb;
use glam::{Vec2, Vec3};

/// A light of a single direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Single {
    pub light: u32,
    /// Unit, towards the light.
    pub wi: Vec3,
    /// Of a surface that faces it, times the number of lights it is drawn from.
    pub irradiance: Rgb,
}

impl LightsAt<'_> {
    /// One of the lights of a single direction, as likely as any other.
    pub fn sample_single(&self, u: f32) -> Option<Single> {
        let count = self.all.single.len();
        let light = *self.all.single.get(((u * count as f32) as usize).min(count.checked_sub(1)?))?;
        let (Light::Distant(distant), pose) = self.light(light) else { return None };
        let (wi, _) = distant.sample(Vec2::ZERO);
        let irradiance = distant.sampled_radiance(wi) * count as f32;
        Some(Single { light, wi: to_time(pose.as_ref(), wi), irradiance })
    }

    /// Whether the same random numbers sample the same direction wherever it is asked for.
    pub fn is_same_everywhere(&self, light: u32) -> bool {
        match self.light(light).0 {
            Light::Area(_) => false,
            Light::Distant(_) => true,
            Light::Dome(dome) => !dome.has_portals(),
        }
    }
}

impl Lights {
    pub fn is_single(&self, light: u32) -> bool {
        self.single.contains(&light)
    }

    /// Whether some light comes from a single direction.
    pub fn has_single(&self) -> bool {
        !self.single.is_empty()
    }

    /// Whether looks for refracted light can meet a light: it has a size, and is no mesh, which is among the surfaces.
    pub fn is_met(&self, light: u32) -> bool {
        !self.is_single(light) && !self.is_mesh(light)
    }

    /// How many lights looks can meet.
    pub fn count_met(&self) -> usize {
        (0..self.lights.len() as u32).filter(|&light| self.is_met(light)).count()
    }

    /// Whether refracted light of some light is looked or searched for: of all but meshes.
    pub fn has_sought(&self) -> bool {
        (0..self.lights.len() as u32).any(|light| !self.is_mesh(light))
    }

    /// Whether one of those is small as seen from anywhere: it has a shape, an angle, or no size at all.
    pub fn has_small(&self) -> bool {
        (0..).zip(&self.lights).any(|(index, light)| match light {
            Light::Area(_) => !self.is_mesh(index),
            Light::Distant(_) => true,
            Light::Dome(dome) => dome.has_suns(),
        })
    }
}
