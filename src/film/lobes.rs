//! Layers by the lobe of the first surface, and AOVs that are sums of others.

use super::{Film, Plane};
use crate::flat::{LOBE_AOVS, parts_of};
use crate::math::Rgb;

/// How the first surface turned the light that the camera sees; sums are kept as [`LOBE_AOVS`] has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lobe {
    Diffuse,
    /// Glossy, mirrors, hair.
    Specular,
    /// Into what does not scatter; what enters a medium is layer `subsurface`.
    Transmission,
}

impl Lobe {
    /// Adds light that came from its source straight to the first surface, or not.
    pub fn add(self, sums: &mut [Rgb], straight: bool, light: Rgb) {
        sums[2 * self as usize + usize::from(!straight)] += light;
    }
}

/// A pixel's sums, in the order of [`LOBE_AOVS`].
pub(super) type LobeSums = [Rgb; LOBE_AOVS.len()];

impl Film {
    pub(super) fn lobe_planes(&self) -> Vec<Plane> {
        let plane = |(lobe, name): (usize, &&'static str)| {
            self.plane(*name, 3, |tile, i| {
                let mean = tile.lobes[i][lobe] / tile.samples[i].max(1) as f32;
                (mean * self.exposure).extend(0.0).to_array()
            })
        };
        LOBE_AOVS.iter().enumerate().map(plane).collect()
    }

    /// The AOVs asked for that are sums of `planes`.
    pub(super) fn sums(&self, planes: &[Plane]) -> Vec<Plane> {
        let of = |name: &str| planes.iter().find(|plane| plane.name == name);
        let sum = |aov: &String| {
            let parts = parts_of(aov).filter(|parts| parts != &[aov.as_str()])?;
            let mut parts = parts.into_iter().filter_map(of);
            let mut sum = parts.next()?.clone();
            for part in parts {
                sum.values.iter_mut().zip(&part.values).for_each(|(sum, value)| *sum += value);
            }
            sum.name = aov.clone().into();
            Some(sum)
        };
        self.aovs.iter().filter_map(sum).collect()
    }
}
