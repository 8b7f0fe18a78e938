//! A point on a surface, as the integrator sees it.

use crate::bsdf::Side;
use crate::math::{Frame, Rgb};
use glam::{Vec2, Vec3};

/// A surface point in render space.
#[derive(Debug, Clone, Copy)]
pub struct Interaction {
    pub p: Vec3,
    /// Bound of the absolute rounding error of `p`.
    pub error: f32,
    /// Unit geometric normal, pointing to the outside: towards `wo` unless the path is inside the object.
    pub ng: Vec3,
    /// Shading frame, its z on the same side as `ng`.
    pub frame: Frame,
    /// Unit, towards where the path came from.
    pub wo: Vec3,
    pub side: Side,
    /// On a strand of hair: light comes from all around.
    pub strand: bool,
    pub instance: u32,
    pub triangle: u32,
    /// Barycentrics on it: (1 - x - y, x, y).
    pub barycentric: Vec2,
    /// Index of the surface in `Scene::surfaces`.
    pub surface: u32,
    /// Whether `wo` is on the side that the mesh's winding and orientation call front.
    pub front: bool,
    /// Colour of `displayColor` here, where it varies over the mesh.
    pub display_color: Option<Rgb>,
}

impl Interaction {
    /// Origin of a ray leaving along `w`, moved off the surface by the error bound.
    pub fn origin(&self, w: Vec3) -> Vec3 {
        let side = if w.dot(self.ng) >= 0.0 { self.error } else { -self.error };
        self.p + self.ng * side
    }

    /// Normal of the half space that light comes from; `None`: from everywhere.
    pub fn horizon(&self) -> Option<Vec3> {
        (!self.strand).then_some(self.ng)
    }

    pub fn local(&self, w: Vec3) -> Vec3 {
        self.frame.to_local(w)
    }
}

/// Shading normal on the side of `ng`, bent just enough that `wo`, which is on the outside, is above it:
/// interpolated normals at a silhouette may point away from the eye, where a BSDF is not defined.
pub fn shading_normal(ns: Vec3, ng: Vec3, wo: Vec3) -> Vec3 {
    let ns = ns.normalize_or(ng);
    let ns = if ns.dot(ng) < 0.0 { -ns } else { ns };
    let cos = ns.dot(wo);
    // A hundredth above grazing keeps GGX terms finite without a visible change of slope.
    if cos >= 0.01 { ns } else { (ns + (0.01 - cos) * wo).normalize_or(ng) }
}
