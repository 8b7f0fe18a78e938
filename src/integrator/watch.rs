//! What AOVs show of the first walk behind a camera ray: noted when it is over, if one is asked for.

use super::Path;
use crate::film::FirstWalk;
use crate::math::Rgb;
use crate::scene::BoundaryHit;
use crate::subsurface::steps::Start;
use glam::Vec3;

impl Path<'_> {
    /// Notes a walk of `segments` from `start` into `instance` that `followed` a slab normal, or none;
    /// `shares` of classical walks, the point of entry, other normals.
    pub(super) fn watch(
        &mut self,
        instance: u32,
        start: &Start<BoundaryHit>,
        segments: u64,
        followed: Option<Vec3>,
        shares: [f32; 3],
    ) {
        let guide = self.guide;
        let Some(log) = self.log.as_mut().filter(|log| log.first.is_none()) else { return };
        let region = guide.numbered(instance, start.p, start.normal);
        log.first = Some(FirstWalk {
            normal: followed,
            entry: start.normal,
            segments,
            region: region.map(|(number, _)| number),
            irradiance: region.map_or(Rgb::ZERO, |(_, irradiance)| irradiance),
            shares,
        });
    }
}

/// Shares of a conditional walk, which has none until it has drawn: all is what it drew.
pub(super) fn drawn(followed: Option<Vec3>, entry: Vec3) -> [f32; 3] {
    match followed {
        None => [1.0, 0.0, 0.0],
        Some(normal) if normal == entry => [0.0, 1.0, 0.0],
        Some(_) => [0.0, 0.0, 1.0],
    }
}
