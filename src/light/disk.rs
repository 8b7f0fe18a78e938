//! Disks, ellipses once transformed: uniform in area.

use super::{
    patch::Patch,
    shape::{ShapeHit, ShapeSample, solid_angle_pdf},
};
use crate::{math::Affine, sampling::concentric_disk};
use glam::{Vec2, Vec3};
use std::f64::consts::PI;

#[derive(Debug, Clone)]
pub struct Disk {
    pub patch: Patch,
}

impl Disk {
    pub fn new(placement: &Affine, radius: f32) -> Option<Self> {
        Some(Self { patch: Patch::new(placement, radius, radius)? })
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        if !self.patch.faces(p) {
            return None;
        }
        // An affine map keeps a uniform density uniform.
        let q = concentric_disk(u);
        let to = self.patch.point(q.x, q.y) - p;
        let t = to.length();
        let wi = to / t;
        Some(ShapeSample { wi, hit: ShapeHit::on_shape(t, q.extend(0.0)), pdf: self.area_pdf(wi, t)? })
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, p: Vec3, wi: Vec3, t: f32) -> f32 {
        if self.patch.faces(p) { self.area_pdf(wi, t).unwrap_or(0.0) } else { 0.0 }
    }

    fn area_pdf(&self, wi: Vec3, t: f32) -> Option<f32> {
        solid_angle_pdf((1.0 / self.area()) as f32, t, -wi.dot(self.patch.normal))
    }

    pub fn intersect(&self, o: Vec3, d: Vec3) -> Option<ShapeHit> {
        let (t, x, y) = self.patch.intersect(o, d)?;
        (x * x + y * y <= 1.0).then(|| ShapeHit::on_shape(t, Vec3::new(x, y, 0.0)))
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        let half = (self.patch.u * self.patch.u + self.patch.v * self.patch.v).map(f32::sqrt);
        (self.patch.center - half, self.patch.center + half)
    }

    pub fn radius(&self) -> f32 {
        (self.patch.u.length_squared() + self.patch.v.length_squared()).sqrt()
    }

    /// pi a b without shear, and the true area with it.
    pub fn area(&self) -> f64 {
        PI * self.patch.area
    }
}
