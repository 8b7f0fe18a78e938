//! Small shared mathematics: colours, local frames, affine placements.

use glam::{DMat4, Mat3, Vec3};

/// Linear RGB triple; also per-channel coefficients (sigma, albedo).
pub type Rgb = Vec3;

pub use std::f32::consts::{FRAC_1_PI, PI, TAU};

/// Rec.709 luminance.
pub fn luminance(c: Rgb) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Mean of the three channels.
pub fn mean(c: Rgb) -> f32 {
    (c.x + c.y + c.z) * (1.0 / 3.0)
}

/// Below it exp rounds to 0 in f32, which half of the smallest positive number, e^-103.97, does.
const VANISHES: f32 = -104.0;

/// As the library's, which takes three times as long to say that nothing is left: in dense media most often.
pub fn exp1(x: f32) -> f32 {
    if x < VANISHES { 0.0 } else { x.exp() }
}

/// Per component; of a grey one, once.
pub fn exp(v: Vec3) -> Vec3 {
    if v.x == v.y && v.y == v.z {
        return Vec3::splat(exp1(v.x));
    }
    Vec3::new(exp1(v.x), exp1(v.y), exp1(v.z))
}

/// Orthonormal right-handed frame; local z is `n`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    pub t: Vec3,
    pub b: Vec3,
    pub n: Vec3,
}

impl Frame {
    /// From a unit normal; Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
    pub fn from_normal(n: Vec3) -> Self {
        let sign = 1.0_f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            t: Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            b: Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        }
    }

    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.t), v.dot(self.b), v.dot(self.n))
    }

    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.t * v.x + self.b * v.y + self.n * v.z
    }
}

/// An affine map x -> linear * x + translation, with the inverse of its linear part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    pub linear: Mat3,
    pub inverse: Mat3,
    pub translation: Vec3,
}

impl Affine {
    /// From a USD row-vector matrix, followed by a translation by `-origin`, preceded by one by `centre`;
    /// composed in f64. `None` where the linear part has no usable inverse.
    pub fn from_usd(m: &crate::flat::Matrix4d, centre: glam::DVec3, origin: glam::DVec3) -> Option<Self> {
        // Row-vector matrices are the transpose of glam's column-vector ones: rows become columns.
        let m = DMat4::from_cols_array_2d(m);
        let linear64 = glam::DMat3::from_mat4(m);
        let inverse64 = linear64.inverse();
        let translation = (m.transform_point3(centre) - origin).as_vec3();
        let (linear, inverse) = (linear64.as_mat3(), inverse64.as_mat3());
        let usable = linear.is_finite() && inverse.is_finite() && translation.is_finite();
        (usable && linear64.determinant() != 0.0).then_some(Self { linear, inverse, translation })
    }

    /// The matrix that is the share `f` of the way from `a` to `b`, number by number; parts that stay, stay exactly.
    pub fn between(a: &Self, b: &Self, f: f32) -> Self {
        let translation = a.translation + (b.translation - a.translation) * f;
        if a.linear == b.linear {
            return Self { translation, ..*a };
        }
        let linear = a.linear + (b.linear - a.linear) * f;
        // In f64, as that of a placement that stays.
        Self { linear, inverse: linear.as_dmat3().inverse().as_mat3(), translation }
    }

    pub fn point(&self, p: Vec3) -> Vec3 {
        self.linear * p + self.translation
    }

    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.linear * v
    }

    /// Normals go by the inverse transpose, which keeps outward outward under mirroring. Not unit.
    pub fn normal(&self, n: Vec3) -> Vec3 {
        self.inverse.transpose() * n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_that_of_the_library() {
        for i in 0..60_000 {
            let x = 100.0 - 0.01 * i as f32;
            assert_eq!(exp1(x).to_bits(), x.exp().to_bits(), "{x}");
        }
        assert!(exp1(f32::NAN).is_nan() && exp1(f32::NEG_INFINITY) == 0.0);
    }
}
