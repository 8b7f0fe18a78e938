//! `UsdLuxShapingAPI`: a cone and a focus about the light's -Z axis.

use crate::{flat, math::Rgb};
use glam::Vec3;
use std::f32::consts::PI;

/// Factor on the emission by its angle off the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Shaping {
    focus: f32,
    focus_tint: Rgb,
    /// Off-axis angle where the cone begins to soften, radians.
    start: f32,
    /// Off-axis angle beyond which nothing is emitted, radians.
    cutoff: f32,
}

impl Shaping {
    pub fn new(shaping: &flat::Shaping) -> Self {
        let cutoff = shaping.cone_angle.to_radians();
        // The schema ignores a negative focus and clamps the softness.
        let start = cutoff * (1.0 - shaping.cone_softness.clamp(0.0, 1.0));
        Self { focus: shaping.focus.max(0.0), focus_tint: shaping.focus_tint.into(), start, cutoff }
    }

    /// Off-axis angle beyond which nothing is emitted, radians.
    pub fn cutoff(&self) -> f32 {
        self.cutoff
    }

    /// Factor in the direction `theta` radians off the axis.
    pub fn factor(&self, theta: f32) -> Rgb {
        self.cone(theta) * self.tint(theta.cos().abs())
    }

    /// Estimate of the factor over off-axis angles `lo..=hi`: its best cone times its best focus, hence
    /// positive wherever the factor is positive in that range.
    pub fn bound(&self, lo: f32, hi: f32) -> Rgb {
        // Focus sees the axis without sign: either end of the range may be the nearer one.
        let best = lo.min(PI - hi).max(0.0);
        self.cone(lo) * self.tint(best.cos().abs())
    }

    /// 1 - smoothstep(theta, start, cutoff), zero beyond the cutoff.
    fn cone(&self, theta: f32) -> f32 {
        if theta > self.cutoff {
            return 0.0;
        }
        if theta <= self.start {
            return 1.0;
        }
        let x = (theta - self.start) / (self.cutoff - self.start);
        1.0 - x * x * (3.0 - 2.0 * x)
    }

    /// lerp(|cos|^focus, focusTint, white); focus 0 is white whatever the tint.
    fn tint(&self, abs_cos: f32) -> Rgb {
        if self.focus == 0.0 {
            return Rgb::ONE;
        }
        self.focus_tint.lerp(Rgb::ONE, abs_cos.powf(self.focus))
    }
}

/// Angle between unit vectors, accurate at both ends, where acos of the dot product loses half its digits
/// (Kahan 2006, "How Futile are Mindless Assessments of Roundoff", section 12).
pub fn angle_between(a: Vec3, b: Vec3) -> f32 {
    2.0 * (a - b).length().atan2((a + b).length())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shaping(focus: f32, cone_angle: f32, cone_softness: f32) -> Shaping {
        let focus_tint = [0.0, 0.5, 1.0];
        Shaping::new(&flat::Shaping { focus, focus_tint, cone_angle, cone_softness, ies: None })
    }

    #[test]
    fn a_hard_cone_ends_at_its_angle() {
        let s = shaping(0.0, 30.0, 0.0);
        assert_eq!(s.factor(29.9_f32.to_radians()), Rgb::ONE);
        assert_eq!(s.factor(30.1_f32.to_radians()), Rgb::ZERO);
    }

    #[test]
    fn a_soft_cone_is_half_midway() {
        // Softness 0.5 of 40 degrees: from 20 to 40, half at 30 degrees.
        let s = shaping(0.0, 40.0, 0.5);
        assert!((s.factor(30.0_f32.to_radians()).x - 0.5).abs() < 1e-5);
        assert_eq!(s.factor(19.0_f32.to_radians()), Rgb::ONE);
        assert!((shaping(0.0, 40.0, 7.0).factor(20.0_f32.to_radians()).x - 0.5).abs() < 1e-5);
    }

    #[test]
    fn focus_tints_off_axis_on_both_sides() {
        let s = shaping(2.0, 180.0, 0.0);
        let expected = Vec3::new(0.25, 0.625, 1.0);
        assert!(s.factor(60.0_f32.to_radians()).abs_diff_eq(expected, 1e-5));
        assert!(s.factor(120.0_f32.to_radians()).abs_diff_eq(expected, 1e-5));
        assert_eq!(shaping(-3.0, 180.0, 0.0).factor(1.0), Rgb::ONE);
    }

    #[test]
    fn the_bound_bounds() {
        for s in [shaping(3.0, 70.0, 0.4), shaping(40.0, 180.0, 0.0), shaping(1.0, 120.0, 1.0)] {
            for i in 0..60 {
                for j in i..60 {
                    let (lo, hi) = (i as f32 / 59.0 * PI, j as f32 / 59.0 * PI);
                    let middle = s.factor(0.3 * lo + 0.7 * hi).x;
                    assert!(s.bound(lo, hi).x >= middle - 1e-5, "{lo} {hi}");
                }
            }
        }
    }
}
