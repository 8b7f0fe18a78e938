//! Curves in a hair material: where a hit lies on its strand.

use super::attribute::{Attribute, Values};
use crate::math::{Affine, Frame};
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

/// Primvars that the bridge adds to curves in a hair material; a tube has the second, a ribbon the third.
const TANGENT: &str = "dermis:tangent";
const OFFSET: &str = "dermis:tubeOffset";
const RIBBON_OFFSET: &str = "dermis:ribbonOffset";

/// Object space, by point of the tessellated curves.
#[derive(Debug, Clone, PartialEq)]
pub struct Strands {
    /// Towards the tip.
    tangents: Attribute<Vec3>,
    /// From the axis to the surface, over the radius.
    offsets: Attribute<Vec3>,
    /// Flat, seen from both sides; else closed, seen from outside alone: light that goes through has left already.
    pub ribbons: bool,
}

impl Strands {
    /// Takes what is theirs out of `primvars`.
    pub fn take(primvars: &mut BTreeMap<String, Values>) -> Option<Self> {
        let mut vectors = |name| match primvars.remove(name) {
            Some(Values::Three(values)) => Some(values),
            _ => None,
        };
        let (tangents, tube, ribbon) = (vectors(TANGENT), vectors(OFFSET), vectors(RIBBON_OFFSET));
        let ribbons = ribbon.is_some();
        Some(Self { tangents: tangents?, offsets: tube.or(ribbon)?, ribbons })
    }

    /// x along the strand, z the normal of the cylinder that the strand is: under the angle to `wo` whose sine is the
    /// offset across the width, so that facets and ribbons scatter as round strands. Render space.
    pub fn frame(&self, to_render: &Affine, triangle: usize, corners: [u32; 3], at: Vec2, wo: Vec3) -> Frame {
        let t = to_render.vector(self.tangents.at(triangle, corners, at.x, at.y)).normalize_or(Vec3::X);
        let across = |local: Vec3| {
            let v = to_render.vector(local);
            (v - t * v.dot(t)).normalize_or_zero() * local.length()
        };
        let offset = across(self.offsets.at(triangle, corners, at.x, at.y));
        // Seen along the strand: any azimuth.
        let d = (wo - t * wo.dot(t)).try_normalize().unwrap_or_else(|| t.any_orthonormal_vector());
        let e = t.cross(d);
        let h = if self.ribbons {
            offset.length().copysign(-offset.dot(e))
        } else {
            let [a, b, _] = self.offsets.corners(triangle, corners).map(across);
            -offset.dot(e) / half_width(a, b, e)
        };
        let h = h.clamp(-1.0, 1.0);
        let n = d * (1.0 - h * h).sqrt() - e * h;
        Frame { t, b: n.cross(t), n }
    }

    /// Bytes beside the value itself.
    pub fn memory(&self) -> usize {
        self.tangents.memory() + self.offsets.memory()
    }
}

/// Half the width along the unit vector `e` of the regular polygon, of an even number of sides, with the corners `a` and
/// `b` about its centre: its silhouette has strands of the whole width then, from everywhere.
fn half_width(a: Vec3, b: Vec3, e: Vec3) -> f32 {
    // 1e-3: thousands of sides, or none.
    let side = a.angle_between(b).max(1e-3);
    let turn = a.angle_between(e);
    a.length() * (turn - side * (turn / side).round()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Mat3;

    fn strands(offset: Vec3, ribbons: bool) -> Strands {
        Strands { tangents: Attribute::Constant(Vec3::Y), offsets: Attribute::Constant(offset), ribbons }
    }

    fn seen(strands: &Strands, wo: Vec3) -> Frame {
        let turn = Mat3::from_rotation_z(0.0);
        let still = Affine { linear: turn, inverse: turn.inverse(), translation: Vec3::ZERO };
        strands.frame(&still, 0, [0; 3], Vec2::ZERO, wo)
    }

    /// The normal of a round strand is its own, whoever looks; the frame is right-handed.
    #[test]
    fn a_tube_has_the_normal_of_its_cylinder() {
        for wo in [Vec3::Z, Vec3::new(0.3, 0.8, 0.5).normalize(), Vec3::new(0.9, -0.1, 0.2).normalize()] {
            let n = Vec3::new(0.6, 0.0, 0.8);
            // One corner is as many sides as can be.
            let frame = seen(&strands(n, false), wo);
            assert!((frame.n - n).length() < 1e-6 && (frame.t - Vec3::Y).length() < 1e-6, "{frame:?}");
            assert!((frame.t.cross(frame.b) - frame.n).length() < 1e-6);
        }
    }

    #[test]
    fn polygons_are_as_wide_as_their_widest_corner() {
        for sides in [6, 12, 24] {
            let corner = |k: i32| {
                let (sin, cos) = (std::f32::consts::TAU * k as f32 / sides as f32).sin_cos();
                1.05 * Vec3::new(sin, 0.0, cos)
            };
            for angle in [0.0, 0.1, 0.9, 2.0, -1.3] {
                let e = Vec3::new(f32::sin(angle), 0.0, f32::cos(angle));
                let widest = (0..sides).map(|k| corner(k).dot(e)).fold(0.0, f32::max);
                for k in 0..sides {
                    let found = half_width(corner(k), corner(k + 1), e);
                    assert!((found - widest).abs() < 1e-4, "{sides} {angle} {k}: {found} {widest}");
                }
            }
        }
    }

    /// Across a ribbon the offset is its own, however it is turned away.
    #[test]
    fn a_ribbon_is_as_wide_as_its_strand_from_everywhere() {
        for wo in [Vec3::Z, Vec3::new(0.8, 0.0, 0.6), Vec3::new(-0.8, 0.3, -0.2).normalize()] {
            let frame = seen(&strands(Vec3::X * 0.5, true), wo);
            let across = Vec3::Y.cross(wo).normalize();
            assert!((frame.n.dot(across).abs() - 0.5).abs() < 1e-6, "{frame:?}");
            assert!(frame.n.dot(across) * across.x > 0.0 && frame.n.dot(wo) > 0.0);
        }
    }
}
