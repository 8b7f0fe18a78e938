//! Warps from the unit square, and weights that combine samplers.

pub mod distribution;
pub mod sampler;

use crate::math::{FRAC_1_PI, Frame, PI, sin_cos_turns};
use glam::{Vec2, Vec3};

/// Uniform disk, concentric (Shirley and Chiu 1997); pdf 1/pi per area.
pub fn concentric_disk(u: Vec2) -> Vec2 {
    let v = u * 2.0 - 1.0;
    if v == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (r, theta) =
        if v.x.abs() > v.y.abs() { (v.x, PI / 4.0 * (v.y / v.x)) } else { (v.y, PI / 2.0 - PI / 4.0 * (v.x / v.y)) };
    let (sin, cos) = theta.sin_cos();
    r * Vec2::new(cos, sin)
}

/// Cosine-weighted hemisphere about +z.
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = concentric_disk(u);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Solid-angle pdf of [`cosine_hemisphere`].
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Uniform sphere; solid-angle pdf 1/(4 pi).
pub fn uniform_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = sin_cos_turns(u.y);
    Vec3::new(r * cos, r * sin, z)
}

/// The unit direction at 1 - cos = `one_minus_cos` (0..=2) from unit `axis`, azimuth 2 pi `u`; by the complement, since
/// a cosine in f32 resolves no angle below 3e-4.
pub fn direction_about(axis: Vec3, one_minus_cos: f32, u: f32) -> Vec3 {
    direction_in(&Frame::from_normal(axis), one_minus_cos, u)
}

/// [`direction_about`] the normal of a frame.
#[inline]
pub fn direction_in(frame: &Frame, one_minus_cos: f32, u: f32) -> Vec3 {
    let sin_theta = (one_minus_cos * (2.0 - one_minus_cos)).max(0.0).sqrt();
    let (sin, cos) = sin_cos_turns(u);
    frame.to_world(Vec3::new(sin_theta * cos, sin_theta * sin, 1.0 - one_minus_cos))
}

pub const UNIFORM_SPHERE_PDF: f32 = 0.25 * FRAC_1_PI;

/// Power heuristic with exponent 2 (Veach 1997, eq. 9.13) for one sample of each of two samplers;
/// written with the ratio so that huge pdfs do not overflow.
pub fn power_heuristic(pdf_a: f32, pdf_b: f32) -> f32 {
    if pdf_a <= 0.0 {
        return 0.0;
    }
    let r = pdf_b / pdf_a;
    1.0 / (1.0 + r * r)
}
