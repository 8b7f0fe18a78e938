//! Cylinders without caps along X, elliptic once transformed: uniform in the angle their girth fills, and
//! equiangular along the axis (Kulla and Fajardo 2012, "Importance Sampling Techniques for Path Tracing in
//! Participating Media", section 4.1), where long tubes seen from near by would be noisy.

use super::{
    ellipsoid::largest_stretch,
    shape::{ShapeHit, ShapeSample},
};
use crate::math::Affine;
use glam::{Mat3, Vec2, Vec3, Vec3Swizzles};
use std::f64::consts::PI;

#[derive(Debug, Clone)]
pub struct Cylinder {
    center: Vec3,
    /// Unit cylinder (x in [-1, 1], y^2 + z^2 = 1) to render space.
    linear: Mat3,
    inverse: Mat3,
    /// |det linear|^(1/3)
    size: f32,
}

impl Cylinder {
    pub fn new(placement: &Affine, length: f32, radius: f32) -> Option<Self> {
        let scale = Vec3::new(0.5 * length, radius, radius);
        let linear = placement.linear * Mat3::from_diagonal(scale);
        let inverse = Mat3::from_diagonal(scale.recip()) * placement.inverse;
        let size = linear.as_dmat3().determinant().abs().cbrt() as f32;
        let sound = linear.is_finite() && inverse.is_finite() && size.is_normal();
        sound.then_some(Self { center: placement.translation, linear, inverse, size })
    }

    /// Whether p is outside the endless cylinder: within it only the dark inside is seen.
    pub fn faces(&self, p: Vec3) -> bool {
        let o = self.to_unit(p);
        o.y * o.y + o.z * o.z > 1.0
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let girth = Girth::new(self.to_unit(p))?;
        let axis = Equiangular::new(p, self.center, self.linear.x_axis);
        let local = girth.sample(u.y).extend(axis.sample(u.x)).zxy();
        let to = self.center + self.linear * local - p;
        let t = to.length();
        let hit = ShapeHit::on_shape(t, local);
        Some(ShapeSample { wi: to / t, hit, pdf: self.joint_pdf(&girth, &axis, &hit) })
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, p: Vec3, hit: &ShapeHit) -> f32 {
        let Some(girth) = Girth::new(self.to_unit(p)) else { return 0.0 };
        self.joint_pdf(&girth, &Equiangular::new(p, self.center, self.linear.x_axis), hit)
    }

    /// pdf(x) pdf(phi) t^2 / (area per dx dphi cos theta). With N the untransformed outward normal, the area is
    /// |det L| |N|, cos theta is h / (t |N|) and pdf(phi) is h / (2 beta s^2), where h is the height of p above
    /// the tangent in unit space: h and |N|, small or uncertain at the rim, cancel.
    fn joint_pdf(&self, girth: &Girth, axis: &Equiangular, hit: &ShapeHit) -> f32 {
        let s2 = girth.p.distance_squared(hit.local.yz());
        let t_relative = hit.t / self.size;
        axis.pdf(hit.local.x) * t_relative.powi(3) / (2.0 * girth.beta * s2)
    }

    /// Outward, not unit.
    pub fn normal(&self, hit: &ShapeHit) -> Vec3 {
        self.inverse.transpose() * Vec3::new(0.0, hit.local.y, hit.local.z)
    }

    /// Only the first crossing shows the outside; beyond the ends it is the inside that is met next.
    pub fn intersect(&self, o: Vec3, d: Vec3) -> Option<ShapeHit> {
        let (o, d) = (self.to_unit(o), self.inverse * d);
        let across = Vec3::new(0.0, 1.0, 1.0);
        let t = super::ellipsoid::enter_unit_ball(o * across, d * across)?;
        let q = o + d * t;
        (q.x.abs() <= 1.0).then(|| {
            let round = (q * across).normalize_or_zero();
            ShapeHit::on_shape(t, Vec3::new(q.x, round.y, round.z))
        })
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        let (y, z) = (self.linear.y_axis, self.linear.z_axis);
        let half = self.linear.x_axis.abs() + (y * y + z * z).map(f32::sqrt);
        (self.center - half, self.center + half)
    }

    pub fn radius(&self) -> f32 {
        let round = Mat3::from_cols(Vec3::ZERO, self.linear.y_axis, self.linear.z_axis);
        self.linear.x_axis.length() + largest_stretch(&round)
    }

    /// Ramanujan's first formula for the girth across the axis, times the length, as OpenUSD counts it.
    pub fn area(&self) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|i| self.linear.col(i).as_dvec3());
        let (y, z) = (y.reject_from(x), z.reject_from(x));
        // Semi-axes of the ellipse y cos + z sin: |y| and |z| unless sheared.
        let (sum, cross) = (y.length_squared() + z.length_squared(), 2.0 * y.cross(z).length());
        let (plus, minus) = ((sum + cross).sqrt(), (sum - cross).max(0.0).sqrt());
        let (a, b) = (0.5 * (plus + minus), 0.5 * (plus - minus));
        2.0 * x.length() * PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt())
    }

    fn to_unit(&self, p: Vec3) -> Vec3 {
        self.inverse * (p - self.center)
    }
}

/// The unit circle seen from p: uniform in the angle at p (in unit space), hence nothing of its far side.
struct Girth {
    p: Vec2,
    /// Half of the angle it fills: sin beta = 1 / |p|.
    beta: f32,
}

impl Girth {
    /// `None` inside.
    fn new(o: Vec3) -> Option<Self> {
        let p = o.yz();
        let rho2 = p.length_squared();
        (rho2 > 1.0).then(|| Self { p, beta: 1.0_f32.atan2((rho2 - 1.0).sqrt()) })
    }

    /// A point of the circle.
    fn sample(&self, u: f32) -> Vec2 {
        let rho = self.p.length();
        let (sin, cos) = ((2.0 * u - 1.0) * self.beta).sin_cos();
        // Sine and cosine of the angle at the centre; the root is 0 at the rim but for rounding.
        let root = (1.0 - (rho * sin).powi(2)).max(0.0).sqrt();
        let alpha = Vec2::new(rho * sin * sin + cos * root, sin * (rho * cos - root));
        alpha.rotate(self.p / rho).normalize()
    }
}

/// Points on the segment center + x half (x in [-1, 1]), uniform in the angle they make at p.
struct Equiangular {
    /// Distance of p from the axis, in units of |half|.
    d: f32,
    /// Position of the end x = -1 along the axis, from the foot of p.
    a: f32,
    /// Angle between the ends.
    angle: f32,
}

impl Equiangular {
    fn new(p: Vec3, center: Vec3, half: Vec3) -> Self {
        let scale2 = half.length_squared();
        let foot = (p - center).dot(half) / scale2;
        // p is outside the cylinder, so only rounding could bring it onto the axis.
        let d = ((p - center - half * foot).length() / scale2.sqrt()).max(f32::MIN_POSITIVE.sqrt());
        let (a, b) = (-1.0 - foot, 1.0 - foot);
        Self { d, a, angle: (2.0 * d).atan2(d * d + a * b) }
    }

    fn sample(&self, u: f32) -> f32 {
        // tan(alpha + u angle) - tan(alpha) by the addition theorem, so that far away, where both tangents
        // agree to many digits, the difference keeps its own.
        let (ta, t) = (self.a / self.d, (u * self.angle).tan());
        let step = self.d * t * (1.0 + ta * ta) / (1.0 - ta * t);
        (step - 1.0).clamp(-1.0, 1.0)
    }

    /// Per unit of x.
    fn pdf(&self, x: f32) -> f32 {
        let s = self.a + 1.0 + x;
        self.d / (self.angle * (self.d * self.d + s * s))
    }
}
