//! What refracts to collisions: lights that look small, and those of a single direction.

use super::{Light, Lights, LightsAt};

impl LightsAt<'_> {
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

    /// Whether a light may be no larger than a sun: it comes from few directions, or from one.
    pub fn has_suns(&self) -> bool {
        self.lights.iter().any(|light| match light {
            Light::Area(_) => false,
            Light::Distant(distant) => distant.is_narrow(),
            Light::Dome(dome) => dome.has_suns() && !dome.has_portals(),
        })
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
