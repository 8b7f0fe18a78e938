//! A plane piece spanned by two half edges: the frame of rectangles and disks, sheared or not.

use crate::math::Affine;
use glam::Vec3;

/// Points `center + x u + y v`, emitting along `normal`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    pub center: Vec3,
    pub u: Vec3,
    pub v: Vec3,
    /// Unit; the image of local -Z, also under mirroring.
    pub normal: Vec3,
    /// |u x v|: area per unit of dx dy.
    pub area: f64,
    /// Rows that give x and y back.
    dual_u: Vec3,
    dual_v: Vec3,
}

impl Patch {
    /// The XY plane of `placement`, with half edges `half_x`, `half_y` in its local units. `None` where no
    /// finite plane comes out.
    pub fn new(placement: &Affine, half_x: f32, half_y: f32) -> Option<Self> {
        let u = placement.vector(Vec3::X * half_x);
        let v = placement.vector(Vec3::Y * half_y);
        let normal = placement.normal(Vec3::NEG_Z).try_normalize()?;
        let (u64, v64) = (u.as_dvec3(), v.as_dvec3());
        let cross = u64.cross(v64);
        let area = cross.length();
        let dual_u = (v64.cross(cross) / area / area).as_vec3();
        let dual_v = (cross.cross(u64) / area / area).as_vec3();
        let sound = u.is_finite() && v.is_finite() && dual_u.is_finite() && dual_v.is_finite();
        sound.then_some(Self { center: placement.translation, u, v, normal, area, dual_u, dual_v })
    }

    pub fn point(&self, x: f32, y: f32) -> Vec3 {
        self.center + self.u * x + self.v * y
    }

    /// Whether p is on the emitting side.
    pub fn faces(&self, p: Vec3) -> bool {
        (p - self.center).dot(self.normal) > 0.0
    }

    /// Whether a part of the square x, y in [-1, 1] is above the horizon of p.
    pub fn rises(&self, p: Vec3, n: Vec3) -> bool {
        (self.center - p).dot(n) + self.u.dot(n).abs() + self.v.dot(n).abs() > 0.0
    }

    /// (t, x, y) where a ray meets the plane from the emitting side.
    pub fn intersect(&self, o: Vec3, d: Vec3) -> Option<(f32, f32, f32)> {
        let (height, descent) = ((o - self.center).dot(self.normal), -d.dot(self.normal));
        if height <= 0.0 || descent <= 0.0 {
            return None;
        }
        let t = height / descent;
        let q = o - self.center + d * t;
        Some((t, q.dot(self.dual_u), q.dot(self.dual_v)))
    }
}
