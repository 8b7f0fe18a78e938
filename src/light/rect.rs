//! Rectangles, by solid angle where they are rectangular: Urena, Fajardo and King 2013, "An Area-Preserving
//! Parametrization for Spherical Rectangles".

use super::{
    patch::Patch,
    shape::{ShapeHit, ShapeSample, solid_angle_pdf},
};
use crate::math::Affine;
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::TAU;

/// Below this solid angle the spherical excess, a difference of angles near 2 pi, has fewer than nine
/// digits, and sampling the area is as good.
const SMALL: f64 = 1e-5;

/// Cosine between the edges above which the shape is sampled as the parallelogram it is.
const SHEARED: f32 = 1e-5;

#[derive(Debug, Clone)]
pub struct Rect {
    pub patch: Patch,
    rectangular: bool,
}

impl Rect {
    pub fn new(placement: &Affine, width: f32, height: f32) -> Option<Self> {
        let patch = Patch::new(placement, 0.5 * width, 0.5 * height)?;
        let cos = patch.u.normalize_or_zero().dot(patch.v.normalize_or_zero());
        Some(Self { patch, rectangular: cos.abs() < SHEARED })
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        if !self.patch.faces(p) {
            return None;
        }
        let spherical = self.spherical(p);
        let (x, y) = match &spherical {
            Some(rect) => rect.sample(u),
            None => (2.0 * u.x - 1.0, 2.0 * u.y - 1.0),
        };
        let to = self.patch.point(x, y) - p;
        let t = to.length();
        let wi = to / t;
        let pdf = match &spherical {
            Some(rect) => (1.0 / rect.solid_angle) as f32,
            None => self.area_pdf(wi, t)?,
        };
        Some(ShapeSample { wi, hit: ShapeHit::on_shape(t, Vec3::new(x, y, 0.0)), pdf })
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, p: Vec3, wi: Vec3, t: f32) -> f32 {
        match self.spherical(p) {
            _ if !self.patch.faces(p) => 0.0,
            Some(rect) => (1.0 / rect.solid_angle) as f32,
            None => self.area_pdf(wi, t).unwrap_or(0.0),
        }
    }

    /// As seen from p, which it faces; an estimate where it is not sampled by solid angle.
    pub fn solid_angle(&self, p: Vec3) -> f64 {
        self.spherical(p).map_or_else(|| self.far_solid_angle(p), |rect| rect.solid_angle)
    }

    /// As if all of it were at its centre, at most a half sphere.
    fn far_solid_angle(&self, p: Vec3) -> f64 {
        let to = (self.patch.center - p).as_dvec3();
        let cos = -to.normalize().dot(self.patch.normal.as_dvec3());
        (self.area() * cos / to.length_squared()).min(TAU)
    }

    fn area_pdf(&self, wi: Vec3, t: f32) -> Option<f32> {
        solid_angle_pdf((1.0 / self.area()) as f32, t, -wi.dot(self.patch.normal))
    }

    /// The rectangle on the sphere about p, where sampling it pays.
    fn spherical(&self, p: Vec3) -> Option<SphericalRect> {
        let rect = self.rectangular.then(|| SphericalRect::new(&self.patch, p))?;
        (rect.solid_angle > SMALL).then_some(rect)
    }

    pub fn intersect(&self, o: Vec3, d: Vec3) -> Option<ShapeHit> {
        let (t, x, y) = self.patch.intersect(o, d)?;
        (x.abs() <= 1.0 && y.abs() <= 1.0).then(|| ShapeHit::on_shape(t, Vec3::new(x, y, 0.0)))
    }

    /// Texture coordinates (s, t), t downwards: the image's first pixel is at (+X, +Y) (UsdLuxRectLight), so
    /// that it stands upright for those it shines on.
    pub fn st(local: Vec3) -> (f32, f32) {
        (0.5 - 0.5 * local.x, 0.5 - 0.5 * local.y)
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        let half = self.patch.u.abs() + self.patch.v.abs();
        (self.patch.center - half, self.patch.center + half)
    }

    pub fn radius(&self) -> f32 {
        (self.patch.u + self.patch.v).length().max((self.patch.u - self.patch.v).length())
    }

    /// |U x V| of the full edges.
    pub fn area(&self) -> f64 {
        4.0 * self.patch.area
    }
}

/// Of numbers that were f32: their squares neither overflow nor vanish, which is what `f64::hypot` takes its time for.
fn norm(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// A rectangle projected on the unit sphere about a point, in f64; the paper's names.
struct SphericalRect {
    x0: f64,
    x1: f64,
    y0: f64,
    y1: f64,
    z0: f64,
    b0: f64,
    b1: f64,
    k: f64,
    solid_angle: f64,
}

impl SphericalRect {
    fn new(patch: &Patch, p: Vec3) -> Self {
        let (u, v) = (patch.u.as_dvec3(), patch.v.as_dvec3());
        let (ex, ey) = (u.normalize(), v.normalize());
        let d: DVec3 = patch.center.as_dvec3() - u - v - p.as_dvec3();
        let (x0, y0) = (d.dot(ex), d.dot(ey));
        let (x1, y1) = (x0 + 2.0 * u.length(), y0 + 2.0 * v.length());
        let z0 = -d.dot(patch.normal.as_dvec3()).abs();
        // z components of the inward normals of the four planes through p and an edge.
        let n = |a: f64| a / norm(a, z0);
        let (n0, n1, n2, n3) = (-n(y0), n(x1), n(y1), -n(x0));
        let angle = |a: f64, b: f64| (-a * b).clamp(-1.0, 1.0).acos();
        let (g0, g1, g2, g3) = (angle(n0, n1), angle(n1, n2), angle(n2, n3), angle(n3, n0));
        let k = TAU - g2 - g3;
        Self { x0, x1, y0, y1, z0, b0: n0, b1: n2, k, solid_angle: g0 + g1 - k }
    }

    /// Uniform per solid angle; the point as (x, y) in [-1, 1]^2 of the rectangle.
    fn sample(&self, u: Vec2) -> (f32, f32) {
        let au = f64::from(u.x) * self.solid_angle + self.k;
        let fu = (au.cos() * self.b0 - self.b1) / au.sin();
        // Rounding may leave [-1, 1] by an ulp: clamp before the root, and the point to the rectangle.
        let cu = (1.0 / norm(fu, self.b0)).copysign(fu).clamp(-1.0, 1.0);
        let xu = (-(cu * self.z0) / (1.0 - cu * cu).sqrt()).clamp(self.x0, self.x1);
        let d = norm(xu, self.z0);
        let (h0, h1) = (self.y0 / norm(d, self.y0), self.y1 / norm(d, self.y1));
        let hv = h0 + f64::from(u.y) * (h1 - h0);
        let yv = (hv * d / (1.0 - hv * hv).sqrt()).clamp(self.y0, self.y1);
        let unit = |a: f64, a0: f64, a1: f64| (2.0 * (a - a0) / (a1 - a0) - 1.0) as f32;
        (unit(xu, self.x0, self.x1), unit(yv, self.y0, self.y1))
    }
}
