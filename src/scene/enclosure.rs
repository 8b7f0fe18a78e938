//! A mesh instance as the boundary of a medium, alone or in company: what a subsurface walk needs of a scene.

use super::accel::Ray;
use super::company::{Company, Objects};
use super::{Instance, Moment, Placed, SurfaceHit};
use crate::math::Affine;
use crate::subsurface::steps::Enclosure;
use glam::{DMat3, DVec3, Mat3, Vec3};

/// Walk space: render space relative to the instance's origin, so that positions are as small as the
/// object, however far it is from the camera. Lengths are stage units.
pub struct InstanceEnclosure<'a> {
    scene: Moment<'a>,
    instance: &'a Instance,
    index: u32,
    placed: Placed<'a>,
    company: Option<&'a Company>,
    /// Half size in walk space of the box that it is in all the time.
    extent: Vec3,
    error: f32,
}

/// A boundary point: triangle and barycentrics. The instance is that of the body or of its company.
#[derive(Debug, Clone, Copy)]
pub struct BoundaryHit {
    pub instance: u32,
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

impl BoundaryHit {
    pub fn of(hit: &SurfaceHit) -> Self {
        Self { instance: hit.instance, triangle: hit.triangle, u: hit.u, v: hit.v }
    }
}

/// A guest's surface this many position errors before the boundary is on it: what only touches is not seen.
const TIE: f32 = 4.0;

/// Surfaces that a ray through a set may cross.
const MOST_CROSSINGS: usize = 4096;

impl<'a> InstanceEnclosure<'a> {
    pub fn new(scene: Moment<'a>, index: u32) -> Self {
        let instance = &scene.scene.instances[index as usize];
        let (company, placed) = (scene.scene.company(index), scene.placed(index));
        let mut extent = extent(instance, &placed);
        if let Some(Company::Set(objects)) = company {
            let reach = |i: &u32| {
                let of = scene.placed(*i);
                (of.translation - placed.translation).abs() + self::extent(&scene.instances[*i as usize], &of)
            };
            extent = objects.instances.iter().map(reach).fold(extent, Vec3::max);
        }
        // A few ulps of the largest coordinate: barycentrics, the linear map and sums of segments.
        let error = 4.0 * f32::EPSILON * extent.max_element();
        Self { scene, instance, index, placed, company, extent, error }
    }

    /// Walk-space position of a boundary point, from its triangle (not from a rounded ray).
    pub fn point(&self, hit: &BoundaryHit) -> Vec3 {
        let [a, b, c] = self.corners(hit);
        let local = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        if hit.instance == self.index {
            return self.placed.linear * local;
        }
        let of = self.scene.placed(hit.instance);
        of.linear * local + self.shift(&of)
    }

    /// The same in the walk space of the instance that is hit.
    pub fn point_of_hit(&self, hit: &BoundaryHit) -> Vec3 {
        let p = self.point(hit);
        if hit.instance == self.index { p } else { p - self.shift(&self.scene.placed(hit.instance)) }
    }

    /// Unit normal of the triangle, by its winding.
    pub fn normal(&self, hit: &BoundaryHit) -> Vec3 {
        let [a, b, c] = self.corners(hit);
        self.scene.placed(hit.instance).normal((b - a).cross(c - a)).normalize_or(Vec3::Z)
    }

    /// Of the triangle, object space.
    fn corners(&self, hit: &BoundaryHit) -> [Vec3; 3] {
        self.scene.instances[hit.instance as usize].geometry.corners(hit.triangle, self.scene.time)
    }

    /// Origin of another instance in walk space.
    fn shift(&self, of: &Affine) -> Vec3 {
        of.translation - self.placed.translation
    }

    /// Whether there are lights in the medium.
    pub fn lights_within(&self) -> bool {
        matches!(self.company, Some(Company::Guests { lights: true, .. }))
    }

    /// The surface point closest to `p`, both in walk space, distances too; `None` without finite triangles.
    pub fn closest_point(&self, p: Vec3) -> Option<Vec3> {
        let (m, geometry, time) = (&*self.placed, &self.instance.geometry, self.scene.time);
        let found = if self.instance.translated {
            geometry.closest_point_under(&Mat3::IDENTITY, 1.0, p, time)
        } else {
            geometry.closest_point_under(&m.linear, least_stretch(&m.inverse), m.inverse * p, time)
        }?;
        Some(self.point(&BoundaryHit { instance: self.index, triangle: found.triangle, u: found.u, v: found.v }))
    }

    #[inline(always)] // every step of a walk
    fn cast_alone(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<BoundaryHit>) -> Option<(f32, BoundaryHit)> {
        let ray = self.instance.local_ray(&self.placed, p, d, t_max);
        let hit = self.instance.geometry.closest(&ray, skipped(from, self.index), self.scene.time)?;
        Some((hit.t, BoundaryHit { instance: self.index, triangle: hit.triangle, u: hit.u, v: hit.v }))
    }

    /// The first surface of `objects`, and which of them it is.
    fn nearest(
        &self,
        objects: &Objects,
        p: Vec3,
        d: Vec3,
        t_max: f32,
        from: Option<BoundaryHit>,
    ) -> Option<(f32, BoundaryHit, usize)> {
        let mut found = None;
        objects.tlas.traverse(&mut Ray { o: self.to_render(p), d, t_max }, |i, ray| {
            let instance = objects.instances[i as usize];
            let of = &self.scene.instances[instance as usize];
            let placed = of.placed(self.scene.time);
            let local = of.local_ray(&placed, p - self.shift(&placed), d, ray.t_max);
            if let Some(hit) = of.geometry.closest(&local, skipped(from, instance), self.scene.time) {
                ray.t_max = hit.t;
                let at = BoundaryHit { instance, triangle: hit.triangle, u: hit.u, v: hit.v };
                found = Some((hit.t, at, i as usize));
            }
            false
        });
        found
    }

    /// Where the ray leaves the union of `objects`: outward, with none of the others around.
    fn cast_union(
        &self,
        objects: &Objects,
        p: Vec3,
        d: Vec3,
        t_max: f32,
        mut from: Option<BoundaryHit>,
    ) -> Option<(f32, BoundaryHit)> {
        let mut passed = 0.0;
        for _ in 0..MOST_CROSSINGS {
            let (t, hit, at) = self.nearest(objects, p + passed * d, d, t_max - passed, from)?;
            passed += t;
            from = Some(hit);
            let out = objects.outward[at] * self.normal(&hit).dot(d) > 0.0;
            if out && self.winding(objects, p + passed * d, d, hit) == 0 {
                return Some((passed, hit));
            }
        }
        None
    }

    /// How many of `objects` are around the point just beyond `from` along `d`: surfaces left less those entered on the
    /// way out of everything.
    fn winding(&self, objects: &Objects, p: Vec3, d: Vec3, from: BoundaryHit) -> i32 {
        let (mut p, mut from, mut winding) = (p, from, 0);
        for _ in 0..MOST_CROSSINGS {
            // A crossing on an edge counts once: the next begins a rounding error later.
            p += self.error * d;
            let Some((t, hit, at)) = self.nearest(objects, p, d, f32::INFINITY, Some(from)) else { break };
            winding += if objects.outward[at] * self.normal(&hit).dot(d) > 0.0 { 1 } else { -1 };
            (p, from) = (p + t * d, hit);
        }
        winding
    }

    pub fn to_render(&self, p: Vec3) -> Vec3 {
        p + self.placed.translation
    }

    pub fn to_walk(&self, p: Vec3) -> Vec3 {
        p - self.placed.translation
    }

    pub fn surface_hit(&self, hit: &BoundaryHit) -> SurfaceHit {
        SurfaceHit { t: 0.0, instance: hit.instance, triangle: hit.triangle, u: hit.u, v: hit.v }
    }
}

/// The triangle of `instance` that a ray from there leaves out.
fn skipped(from: Option<BoundaryHit>, instance: u32) -> u32 {
    from.filter(|from| from.instance == instance).map_or(u32::MAX, |from| from.triangle)
}

/// Half size of a box about the origin of an instance that holds it.
fn extent(instance: &Instance, placed: &Affine) -> Vec3 {
    let bounds = instance.geometry.bounds();
    placed.linear.abs() * bounds.min.abs().max(bounds.max.abs())
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
        match self.company {
            None => self.cast_alone(p, d, t_max, from),
            Some(Company::Set(objects)) => self.cast_union(objects, p, d, t_max, from),
            Some(Company::Guests { objects, .. }) => {
                let own = self.cast_alone(p, d, t_max, from);
                let limit = own.map_or(t_max, |(t, _)| t - TIE * self.error);
                let guest = self.nearest(objects, p, d, limit, from);
                guest.map(|(t, hit, _)| (t, hit)).or(own)
            }
        }
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
