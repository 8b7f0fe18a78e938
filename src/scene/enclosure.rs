//! A mesh instance as the boundary of a medium: what a subsurface walk needs of a scene.

use super::{Instance, Scene, SurfaceHit};
use crate::subsurface::walk::Enclosure;
use glam::Vec3;

/// Walk space: render space relative to the instance's origin, so that positions are as small as the
/// object, however far it is from the camera. Lengths are stage units.
pub struct InstanceEnclosure<'a> {
    instance: &'a Instance,
    index: u32,
    /// Half size of the bounding box in walk space.
    extent: Vec3,
    error: f32,
}

/// A boundary point: triangle and barycentrics.
#[derive(Debug, Clone, Copy)]
pub struct BoundaryHit {
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

impl<'a> InstanceEnclosure<'a> {
    pub fn new(scene: &'a Scene, index: u32) -> Self {
        let instance = &scene.instances[index as usize];
        let bounds = instance.geometry.blas.bounds();
        let extent = instance.to_render.linear.abs() * bounds.min.abs().max(bounds.max.abs());
        // A few ulps of the largest coordinate: barycentrics, the linear map and sums of segments.
        Self { instance, index, extent, error: 4.0 * f32::EPSILON * extent.max_element() }
    }

    /// Walk-space position of a boundary point, from its triangle (not from a rounded ray).
    pub fn point(&self, hit: &BoundaryHit) -> Vec3 {
        let [a, b, c] = self.instance.geometry.corners(hit.triangle);
        self.instance.to_render.linear * (a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v)
    }

    pub fn to_render(&self, p: Vec3) -> Vec3 {
        p + self.instance.to_render.translation
    }

    pub fn surface_hit(&self, hit: &BoundaryHit) -> SurfaceHit {
        SurfaceHit { t: 0.0, instance: self.index, triangle: hit.triangle, u: hit.u, v: hit.v }
    }
}

impl Enclosure for InstanceEnclosure<'_> {
    type Hit = BoundaryHit;

    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<BoundaryHit>) -> Option<(f32, BoundaryHit)> {
        let ray = self.instance.local_ray(p, d, t_max);
        let skip = from.map_or(u32::MAX, |hit| hit.triangle);
        let hit = self.instance.geometry.blas.closest_skip(&ray, skip)?;
        Some((hit.t, BoundaryHit { triangle: hit.triangle, u: hit.u, v: hit.v }))
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        p.abs().cmple(self.extent + 64.0 * self.error).all()
    }

    fn position_error(&self) -> f32 {
        self.error
    }
}
