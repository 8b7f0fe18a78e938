//! A mesh instance as the boundary of a medium: what a subsurface walk needs of a scene.

use super::{Instance, Scene, SurfaceHit};
use crate::subsurface::steps::Enclosure;
use glam::{DMat3, DVec3, Mat3, Vec3};

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

impl BoundaryHit {
    /// Without its instance, whose boundary it is on.
    pub fn of(hit: &SurfaceHit) -> Self {
        Self { triangle: hit.triangle, u: hit.u, v: hit.v }
    }
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

    /// The surface point closest to `p`, both in walk space, distances too; `None` without finite triangles.
    pub fn closest_point(&self, p: Vec3) -> Option<Vec3> {
        let (m, blas) = (&self.instance.to_render, &self.instance.geometry.blas);
        let found = if self.instance.translated {
            blas.closest_point(p)
        } else {
            blas.closest_point_under(&m.linear, least_stretch(&m.inverse), m.inverse * p)
        }?;
        Some(self.point(&BoundaryHit { triangle: found.triangle, u: found.u, v: found.v }))
    }

    pub fn to_render(&self, p: Vec3) -> Vec3 {
        p + self.instance.to_render.translation
    }

    pub fn surface_hit(&self, hit: &BoundaryHit) -> SurfaceHit {
        SurfaceHit { t: 0.0, instance: self.index, triangle: hit.triangle, u: hit.u, v: hit.v }
    }
}

/// Lower bound of |M v| / |v|, from the inverse of M: exact for similarities, never below 0.86 of the least singular
/// value. The largest eigenvalue of a symmetric 3 x 3 matrix is mean + 2 deviation cos(..) (Smith 1961).
fn least_stretch(inverse: &Mat3) -> f32 {
    let a = inverse.as_dmat3();
    let a = a.transpose() * a;
    let mean = (a.x_axis.x + a.y_axis.y + a.z_axis.z) / 3.0;
    let off = a - DMat3::from_diagonal(DVec3::splat(mean));
    let squares = off.x_axis.length_squared() + off.y_axis.length_squared() + off.z_axis.length_squared();
    (1.0 / (mean + 2.0 * (squares / 6.0).sqrt()).sqrt()) as f32
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_stretch_is_a_close_lower_bound() {
        let turn = [Mat3::from_rotation_x(0.7), Mat3::from_rotation_y(-1.1) * Mat3::from_rotation_z(0.4)];
        for (diagonal, exact) in [([2.0, -2.0, 2.0], true), ([3.0, 0.2, 1.0], false), ([0.01, 100.0, 100.0], false)] {
            let m = turn[0] * Mat3::from_diagonal(Vec3::from(diagonal)) * turn[1];
            let bound = least_stretch(&m.inverse());
            let least = diagonal.iter().fold(f32::INFINITY, |a, b| a.min(b.abs()));
            assert!(bound <= least * (1.0 + 1e-6) && bound > least * if exact { 1.0 - 1e-6 } else { 0.86 }, "{bound}");
        }
    }
}
