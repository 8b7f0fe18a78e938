//! Spheres, ellipsoids once transformed: the visible cap, uniform per solid angle about p in local space.
//!
//! The affine map to the unit sphere keeps what is visible visible and takes directions to directions; it
//! stretches solid angles by |det A| / |A w|^3. A uniformly scaled sphere gets plain cone sampling.

use super::shape::{ShapeHit, ShapeSample};
use crate::math::{Affine, Frame, TAU};
use glam::{Mat3, Vec2, Vec3};
use std::f64::consts::PI;

#[derive(Debug, Clone)]
pub struct Ellipsoid {
    center: Vec3,
    /// Unit sphere to render space.
    linear: Mat3,
    inverse: Mat3,
    /// |det inverse|^(1/3): keeps the ratio below in range for any size.
    inverse_size: f32,
}

impl Ellipsoid {
    pub fn new(placement: &Affine, radius: f32) -> Option<Self> {
        let (linear, inverse) = (placement.linear * radius, placement.inverse * (1.0 / radius));
        let inverse_size = inverse.as_dmat3().determinant().abs().cbrt() as f32;
        let sound = linear.is_finite() && inverse.is_finite() && inverse_size.is_normal();
        sound.then_some(Self { center: placement.translation, linear, inverse, inverse_size })
    }

    /// Whether p is outside.
    pub fn faces(&self, p: Vec3) -> bool {
        self.to_unit(p).length_squared() > 1.0
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let o = self.to_unit(p);
        let cap = Cap::new(o)?;
        let local = cap.sample(u);
        let to = self.linear * (local - o);
        let t = to.length();
        let wi = to / t;
        Some(ShapeSample { wi, hit: ShapeHit::on_shape(t, local), pdf: cap.pdf() * self.stretch(wi) })
    }

    /// Solid-angle pdf of [`Self::sample`] for a `wi` that meets the ellipsoid.
    pub fn pdf(&self, p: Vec3, wi: Vec3) -> f32 {
        Cap::new(self.to_unit(p)).map_or(0.0, |cap| cap.pdf() * self.stretch(wi))
    }

    /// d omega_local / d omega = |det A| / |A wi|^3.
    fn stretch(&self, wi: Vec3) -> f32 {
        (self.inverse_size / (self.inverse * wi).length()).powi(3)
    }

    pub fn intersect(&self, o: Vec3, d: Vec3) -> Option<ShapeHit> {
        let (o, d) = (self.to_unit(o), self.inverse * d);
        let t = enter_unit_ball(o, d)?;
        Some(ShapeHit::on_shape(t, (o + d * t).normalize_or_zero()))
    }

    /// Outward, not unit.
    pub fn normal(&self, hit: &ShapeHit) -> Vec3 {
        self.inverse.transpose() * hit.local
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        let rows = self.linear.transpose();
        let half = Vec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length());
        (self.center - half, self.center + half)
    }

    pub fn radius(&self) -> f32 {
        largest_stretch(&self.linear)
    }

    /// Surface area, which UsdLux divides by: 4 pi times the mean over directions n of |cofactor(A) n|. The polar
    /// integral of sqrt(q + d u^2) is done by hand, the azimuth by midpoints (within 1e-4 even of a needle).
    pub fn area(&self) -> f64 {
        const MIDPOINTS: u32 = 64;
        let mut axes = semi_axes(&self.linear);
        axes.sort_by(f64::total_cmp);
        let [c, b, a] = axes;
        let polar = |k| {
            let (sin, cos) = ((f64::from(k) + 0.5) / f64::from(MIDPOINTS) * PI / 2.0).sin_cos();
            let equator = c * f64::hypot(b * cos, a * sin);
            mean_stretch(equator, a * b)
        };
        4.0 * PI * (0..MIDPOINTS).map(polar).sum::<f64>() / f64::from(MIDPOINTS)
    }

    fn to_unit(&self, p: Vec3) -> Vec3 {
        self.inverse * (p - self.center)
    }
}

/// Integral over u in [0, 1] of sqrt(equator^2 (1 - u^2) + pole^2 u^2), for 0 < equator <= pole.
fn mean_stretch(equator: f64, pole: f64) -> f64 {
    let x = ((pole / equator).powi(2) - 1.0).max(0.0).sqrt();
    // asinh(x) / x = 1 - x^2 / 6 + ...: to f64 precision 1 below.
    let ratio = if x < 1e-8 { 1.0 } else { x.asinh() / x };
    0.5 * (pole + equator * ratio)
}

/// The part of the unit sphere visible from `o`, as a cone of directions.
struct Cap {
    o: Vec3,
    sin2_max: f32,
    /// 1 - cos of the half angle, without cancellation.
    one_minus_cos: f32,
}

impl Cap {
    /// `None` inside the sphere.
    fn new(o: Vec3) -> Option<Self> {
        let d2 = o.length_squared();
        let sin2_max = 1.0 / d2;
        let one_minus_cos = sin2_max / (1.0 + (1.0 - sin2_max).max(0.0).sqrt());
        // Beyond 1e18 radii the cone has no width in f32.
        (d2 > 1.0 && one_minus_cos.is_normal()).then_some(Self { o, sin2_max, one_minus_cos })
    }

    /// The point of the unit sphere in a uniformly chosen direction (Pharr et al. 2023, section 6.2.4).
    fn sample(&self, u: Vec2) -> Vec3 {
        let x = u.x * self.one_minus_cos;
        // sin^2 = (1 - cos)(1 + cos); rounding may exceed the rim by an ulp.
        let sin2 = (x * (2.0 - x)).min(self.sin2_max);
        let cos = 1.0 - x;
        // Angle at the centre between the nearest point and the one hit.
        let cos_alpha = sin2 / self.sin2_max.sqrt() + cos * (1.0 - sin2 / self.sin2_max).max(0.0).sqrt();
        let sin_alpha = (1.0 - cos_alpha * cos_alpha).max(0.0).sqrt();
        let (sin_phi, cos_phi) = (TAU * u.y).sin_cos();
        let frame = Frame::from_normal(self.o.normalize());
        frame.to_world(Vec3::new(sin_alpha * cos_phi, sin_alpha * sin_phi, cos_alpha))
    }

    /// Per local solid angle.
    fn pdf(&self) -> f32 {
        1.0 / (TAU * self.one_minus_cos)
    }
}

/// Distance, in lengths of `d`, at which a ray from outside enters the unit ball; written with the nearest
/// point to the centre, which keeps its digits for distant balls (Haines et al. 2019, Ray Tracing Gems 7).
pub fn enter_unit_ball(o: Vec3, d: Vec3) -> Option<f32> {
    let d2 = d.length_squared();
    let b = -o.dot(d) / d2;
    let discriminant = 1.0 - (o + d * b).length_squared();
    let outside = o.length_squared() > 1.0;
    (outside && b > 0.0 && discriminant >= 0.0).then(|| b - (discriminant / d2).sqrt())
}

/// An upper bound of the largest singular value, exact where the columns are orthogonal: the square root of
/// the largest row sum of |M^T M|.
pub fn largest_stretch(m: &Mat3) -> f32 {
    let gram = m.transpose() * *m;
    let sum = |c: Vec3| c.abs().element_sum();
    sum(gram.x_axis).max(sum(gram.y_axis)).max(sum(gram.z_axis)).sqrt()
}

/// Semi-axes of the image of the unit sphere: the lengths of the columns, as OpenUSD has it, unless these
/// are sheared; then the roots of the eigenvalues of M^T M (Smith 1961, "Eigenvalues of a symmetric 3 x 3
/// matrix").
fn semi_axes(m: &Mat3) -> [f64; 3] {
    let m = m.as_dmat3();
    let gram = m.transpose() * m;
    let (x, y, z) = (gram.x_axis, gram.y_axis, gram.z_axis);
    let off = x.y * x.y + x.z * x.z + y.z * y.z;
    let mean = (x.x + y.y + z.z) / 3.0;
    // f32 placements leave relative errors of 1e-7 off the diagonal.
    if off.sqrt() <= 1e-6 * mean {
        return [x.x.sqrt(), y.y.sqrt(), z.z.sqrt()];
    }
    let spread = ((x.x - mean).powi(2) + (y.y - mean).powi(2) + (z.z - mean).powi(2) + 2.0 * off) / 6.0;
    let p = spread.sqrt();
    let shifted = (gram - glam::DMat3::IDENTITY * mean) * (1.0 / p);
    let phi = (0.5 * shifted.determinant()).clamp(-1.0, 1.0).acos() / 3.0;
    [0.0, 1.0, 2.0].map(|k| (mean + 2.0 * p * (phi + k * 2.0 * PI / 3.0).cos()).max(0.0).sqrt())
}
