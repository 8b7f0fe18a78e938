//! Axis-aligned boxes, and how far they must be padded to stay conservative.

use crate::math::Affine;
use glam::Vec3;

/// Padding of a triangle's box in units of its largest extent, 16 unit roundoffs.
///
/// The watertight test works on vertices relative to the origin and sheared. Each such coordinate is off by at most
/// 4 roundoffs of its size, which is the distance to the hit plus the extent of the triangle; the depth of the
/// hit, an interpolation of three of them, by at most 8. The share of the distance is relative in t and covered
/// by `node::WIDEN`, that of the extent is absolute and covered here.
const PAD: f32 = 8.0 * f32::EPSILON;

/// Points p with min <= p <= max. Empty where a min exceeds its max.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Aabb {
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    pub fn from_points(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| b.union(&Self { min: p, max: p }))
    }

    /// Smallest box around both. NaN coordinates do not count.
    pub fn union(&self, other: &Self) -> Self {
        Self { min: map2(self.min, other.min, f32::min), max: map2(self.max, other.max, f32::max) }
    }

    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    pub fn centre(&self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }

    /// Edge lengths.
    pub fn extent(&self) -> Vec3 {
        self.max - self.min
    }

    /// Half the surface area; 0 of an empty box.
    pub fn half_area(&self) -> f32 {
        let e = self.extent();
        if self.is_empty() { 0.0 } else { e.x * e.y + e.y * e.z + e.z * e.x }
    }

    pub fn contains(&self, p: Vec3) -> bool {
        self.min.cmple(p).all() && p.cmple(self.max).all()
    }

    /// Grown by at least `by` on every side, rounded outward.
    pub fn pad(&self, by: Vec3) -> Self {
        // The second subtraction takes at least one ulp; where it underflows, the first was exact.
        let down = |x: f32, by: f32| if by > 0.0 { (x - by) - (x - by).abs() * f32::EPSILON } else { x };
        Self { min: map2(self.min, by, down), max: -map2(-self.max, by, down) }
    }

    /// The box of a triangle, padded by the error of its intersection test.
    pub(super) fn of_triangle(p: [Vec3; 3]) -> Self {
        let tight = Self::from_points(p);
        tight.pad(Vec3::splat(tight.extent().max_element() * PAD))
    }

    /// A box around the image of this one: centre and |M| times half extent (Arvo 1990), padded by the
    /// rounding of that and of the images of its points.
    pub fn transform(&self, m: &Affine) -> Self {
        if self.is_empty() {
            return Self::EMPTY;
        }
        let linear = glam::Mat3::from_cols(m.linear.x_axis.abs(), m.linear.y_axis.abs(), m.linear.z_axis.abs());
        let (centre, half) = (m.point(self.centre()), linear * (self.extent() * 0.5));
        let size = linear * map2(self.min.abs(), self.max.abs(), f32::max) + m.translation.abs();
        let image = Self { min: centre - half, max: centre + half }.pad(size * PAD);
        // Infinite input gives NaN (inf - inf) where nothing is known: everything may be inside.
        let or = |x: f32, bound: f32| if x.is_nan() { bound } else { x };
        Self { min: map2(image.min, Vec3::NEG_INFINITY, or), max: map2(image.max, Vec3::INFINITY, or) }
    }
}

fn map2(a: Vec3, b: Vec3, f: impl Fn(f32, f32) -> f32) -> Vec3 {
    Vec3::new(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z))
}
