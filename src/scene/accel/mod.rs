//! Ray acceleration: which triangle does a ray meet first, and which objects may it meet at all.
//!
//! obvhs builds a binary tree (`build`), `collapse` makes it eight wide, `traverse` walks it. A [`Blas`]
//! holds the triangles of one mesh in object space, a [`MovingBlas`] those of one whose points move, a [`Tlas`] the boxes of placed objects.
//!
//! What the walk under the skin relies on:
//! - *No leaks.* The triangle test is watertight (Woop, Benthin and Wald 2013) and the box test never culls
//!   what that test would accept (Ize 2013; the padding is derived in [`aabb`] and `node`).
//! - *No smallest distance.* Hits lie in the open interval (0, t_max), however short it is.
//! - *One answer.* The hit is the smallest t, at equal t the lowest triangle index: a function of the mesh
//!   and the ray alone, not of the tree, the machine or the instruction set.

pub mod aabb;
mod blas;
mod build;
mod collapse;
mod cut;
mod guide;
mod lanes;
mod moving;
mod near;
mod nearest;
mod node;
mod pages;
mod tlas;
mod traverse;
mod triangle;

#[cfg(test)]
mod tests;

pub use aabb::Aabb;
pub use blas::{Blas, TriHit};
pub use moving::{MovingBlas, between};
pub use nearest::ClosestPoint;
pub use pages::give_back;
pub use tlas::Tlas;

use glam::Vec3;

/// The half line o + t d for t in (0, t_max), both ends exclusive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    pub o: Vec3,
    /// Any non-zero length; t counts in units of it. Components beyond 1e30 or all below 1e-30 hit nothing reliably.
    pub d: Vec3,
    pub t_max: f32,
}

impl Ray {
    pub fn new(o: Vec3, d: Vec3, t_max: f32) -> Self {
        Self { o, d, t_max }
    }

    pub fn at(&self, t: f32) -> Vec3 {
        self.o + self.d * t
    }

    fn is_finite(&self) -> bool {
        self.o.is_finite() && self.d.is_finite()
    }
}
