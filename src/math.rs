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

/// Adding it rounds a number below 2^22 to the nearest integer, whose bits are then the low ones of the mantissa.
const ROUND: f32 = 12_582_912.0; // 1.5 * 2^23

/// exp(x) for -87 < x < 88, relative error below 3e-7 max(1, |x|) (a test): plain arithmetic that vectorises. 2^(i + f) with the Taylor polynomial
/// of 2^f of degree 6 on [-1/2, 1/2].
#[inline(always)]
pub fn exp_in_lanes(x: f32) -> f32 {
    let y = x * std::f32::consts::LOG2_E;
    let rounded = y + ROUND;
    let f = y - (rounded - ROUND);
    let high = (1.540_353e-4 * f + 1.333_355_8e-3) * f + 9.618_129e-3;
    let poly = (((high * f + 5.550_411e-2) * f + 2.402_265e-1) * f + 6.931_472e-1) * f + 1.0;
    power_of_two(rounded) * poly
}

/// Of an integer that [`ROUND`] was added to, from -126 to 127.
#[inline(always)]
fn power_of_two(rounded: f32) -> f32 {
    f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000))
}

/// exp(x) - 1 for 0 <= x < 80, relative error below 3e-7 (a test), a minimax polynomial about the nearest power of 2.
#[inline]
pub fn exp_m1(x: f32) -> f32 {
    /// ln 2, of which the first part times a small integer is exact (Cody and Waite 1980).
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (x - k * LN_2[0]) - k * LN_2[1];
    let high = (1.388_239_6e-3 * r + 8.367_181e-3) * r + 4.166_722e-2;
    let m1 = ((high * r + 1.666_653_9e-1) * r + 5.0e-1) * (r * r) + r;
    let scale = power_of_two(rounded);
    scale * m1 + (scale - 1.0)
}

/// Sine and cosine of 2 pi `u` for u in [0, 1], absolute error below 1.2e-7 (a test): minimax polynomials about the nearest
/// quarter turn, which is chosen without a branch.
#[inline]
pub fn sin_cos_turns(u: f32) -> (f32, f32) {
    let rounded = 4.0 * u + ROUND;
    let quarter = rounded.to_bits();
    let r = 4.0 * u - (rounded - ROUND); // exact
    let z = r * r;
    let sin = (((-4.601_658e-3 * z + 7.968_003e-2) * z - 6.459_634_6e-1) * z + std::f32::consts::FRAC_PI_2) * r;
    let cos = (((9.040_217e-4 * z - 2.086_028_9e-2) * z + 2.536_692_4e-1) * z - 1.233_700_5) * z + 1.0;
    let swap = (sin.to_bits() ^ cos.to_bits()) & 0_u32.wrapping_sub(quarter & 1);
    let signs = [quarter & 2, (quarter + 1) & 2].map(|sign| sign << 30);
    (f32::from_bits(sin.to_bits() ^ swap ^ signs[0]), f32::from_bits(cos.to_bits() ^ swap ^ signs[1]))
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

    /// All numbers that a sampler gives for an angle, which have 24 bits.
    #[test]
    fn sine_and_cosine_of_turns() {
        let mut worst = 0.0_f64;
        for i in 0..=1_u32 << 24 {
            let u = i as f32 / (1 << 24) as f32;
            let (sin, cos) = sin_cos_turns(u);
            let (exact_sin, exact_cos) = (f64::from(u) * std::f64::consts::TAU).sin_cos();
            worst = worst.max((f64::from(sin) - exact_sin).abs()).max((f64::from(cos) - exact_cos).abs());
        }
        assert!(worst < 1.2e-7, "{worst}");
    }

    #[test]
    fn polynomials_of_exponentials() {
        let (mut of_m1, mut of_exp) = (0.0_f64, 0.0_f64);
        for i in 0..4_000_000 {
            let x = 80.0 * (i as f32 / 4e6).powi(3);
            let exact = f64::from(x).exp_m1();
            of_m1 = of_m1.max(if x > 0.0 { (f64::from(exp_m1(x)) / exact - 1.0).abs() } else { 0.0 });
            for x in [x, -x] {
                // The product with log2(e) is rounded to half an ulp of up to 115.
                let error = (f64::from(exp_in_lanes(x)) / f64::from(x).exp() - 1.0).abs();
                of_exp = of_exp.max(error / f64::from(x.abs().max(1.0)));
            }
        }
        assert!(of_m1 < 3e-7 && exp_m1(0.0) == 0.0, "{of_m1}");
        assert!(of_exp < 3e-7, "{of_exp}");
    }
}
