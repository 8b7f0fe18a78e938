//! The triangles of one mesh, in its own space.

use super::Ray;
use super::aabb::Aabb;
use super::build::binary_tree;
use super::collapse::{collapse, node_bounds};
use super::lanes::Lanes;
use super::pages;
use super::traverse::{Tree, Visitor};
use super::triangle::{Crossing, Leaf, Shear, WIDTH};
use crate::math::Affine;
use glam::Vec3;
use rayon::prelude::*;
use std::borrow::Borrow;

/// A ray's meeting with a triangle: the point is (1 - u - v) a + u b + v c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriHit {
    /// In units of the ray's d.
    pub t: f32,
    /// Index into the triangles the [`Blas`] was built from.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

/// Bottom-level acceleration structure.
#[derive(Debug, Clone)]
pub struct Blas {
    pub(super) tree: Tree,
    pub(super) leaves: Vec<Leaf>,
    one_sided: bool,
}

/// No triangle has this index.
const NONE: u32 = u32::MAX;

/// Triangles for which it pays to ask another thread.
const MANY: usize = 1 << 12;

impl Blas {
    /// Triangles index `points`, both sides are hit. Those without area, with non-finite vertices or with indices out of
    /// range are never hit. At most 2^31 triangles.
    pub fn build(points: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let corner = |i: u32| points.get(i as usize).copied().unwrap_or(Vec3::NAN);
        let of_triangle = |t: &[u32; 3]| Aabb::of_triangle(t.map(corner));
        let boxes: Vec<Aabb> = triangles.par_iter().with_min_len(MANY).map(of_triangle).collect();
        let binary = binary_tree(&boxes, WIDTH);
        let bounds = node_bounds(&binary, &boxes);
        drop(boxes);
        let mut kept = Vec::new();
        let tree = collapse(&binary, bounds, |ids| {
            kept.push(ids);
            kept.len() as u32 - 1
        });
        let mut leaves = pages::with_capacity(kept.len());
        let leaf = |ids: &&[u32]| Leaf::of(ids, |id| triangles[id as usize].map(corner));
        kept.par_iter().with_min_len(MANY / WIDTH).map(leaf).collect_into_vec(&mut leaves);
        Self { tree, leaves, one_sided: false }
    }

    /// Hit from the side from which a, b, c go round counterclockwise only.
    pub fn one_sided(self) -> Self {
        Self { one_sided: true, ..self }
    }

    /// The hit with the smallest t in (0, t_max); at equal t the lowest triangle index.
    pub fn closest(&self, ray: &Ray) -> Option<TriHit> {
        self.closest_skip(ray, NONE)
    }

    /// As [`Blas::closest`], without triangle `skip`: a ray that starts on a triangle cannot meet its plane again.
    pub fn closest_skip(&self, ray: &Ray, skip: u32) -> Option<TriHit> {
        let leaves = self.leaves.as_slice();
        if self.one_sided {
            return closest(&self.tree, leaves, Front(ray.d), ray, skip);
        }
        closest(&self.tree, leaves, Both, ray, skip)
    }

    /// Whether anything is hit in (0, t_max).
    pub fn any(&self, ray: &Ray) -> bool {
        self.any_skip(ray, NONE)
    }

    /// As [`Blas::any`], without triangle `skip`.
    pub fn any_skip(&self, ray: &Ray, skip: u32) -> bool {
        let leaves = self.leaves.as_slice();
        if self.one_sided {
            return any(&self.tree, leaves, Front(ray.d), ray, skip);
        }
        any(&self.tree, leaves, Both, ray, skip)
    }

    /// A box around the image of all triangles: that of the images of boxes `levels` below the root, which are turned one by
    /// one, not as what is around them all.
    pub fn bounds_under(&self, m: &Affine, levels: u32) -> Aabb {
        let mut all = Aabb::EMPTY;
        self.tree.boxes(levels, &mut |part| all = all.union(&part.transform(m)));
        all
    }

    /// Object-space bounds, empty without triangles; at most a few roundings larger than the points'.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds
    }

    /// Bytes.
    pub fn memory(&self) -> usize {
        self.tree.memory() + size_of_val(self.leaves.as_slice())
    }
}

/// Which sides of a triangle count.
pub(super) trait Sides {
    fn see(&self, leaf: &Leaf, lane: usize) -> bool;
}

pub(super) struct Both;

/// Only the front, for a ray along this.
pub(super) struct Front(pub Vec3);

impl Sides for Both {
    #[inline(always)]
    fn see(&self, _: &Leaf, _: usize) -> bool {
        true
    }
}

impl Sides for Front {
    #[inline(always)]
    fn see(&self, leaf: &Leaf, lane: usize) -> bool {
        let [a, b, c] = leaf.corners(lane);
        (b - a).cross(c - a).dot(self.0) < 0.0
    }
}

/// Calls `hit` with each crossing of the line with the leaf's triangles, until it returns true.
#[inline(always)]
pub(super) fn crossings<L: Lanes>(
    leaf: &Leaf,
    shear: &Shear,
    sides: &impl Sides,
    mut hit: impl FnMut(u32, Crossing) -> bool,
) -> bool {
    let (mut inside, e) = shear.edges::<L>(leaf);
    if inside == 0 {
        return false;
    }
    let e = [e[0].store(), e[1].store(), e[2].store()];
    while inside != 0 {
        let lane = inside.trailing_zeros() as usize & 7;
        inside &= inside - 1;
        let crossing = shear.crossing(leaf, lane, [e[0][lane], e[1][lane], e[2][lane]]);
        if crossing.is_some_and(|c| sides.see(leaf, lane) && hit(leaf.id[lane], c)) {
            return true;
        }
    }
    false
}

/// Where a walk finds its leaves.
pub(super) trait Leaves {
    type Leaf: Borrow<Leaf>;
    fn leaf(&self, i: u32) -> Self::Leaf;
}

impl<'a> Leaves for &'a [Leaf] {
    type Leaf = &'a Leaf;
    #[inline(always)]
    fn leaf(&self, i: u32) -> &'a Leaf {
        &self[i as usize]
    }
}

/// The closest of the triangles in `leaves`, by way of their tree.
#[inline(always)]
pub(super) fn closest(tree: &Tree, leaves: impl Leaves, sides: impl Sides, ray: &Ray, skip: u32) -> Option<TriHit> {
    // Triangle 0 as "none yet" makes t_max exclusive: no index is below it at equal t.
    let best = TriHit { t: ray.t_max, triangle: 0, u: 0.0, v: 0.0 };
    let visitor = tree.walk(ray, Closest { leaves, sides, skip, best, found: false });
    visitor.found.then_some(visitor.best)
}

/// Whether one of them is met.
#[inline(always)]
pub(super) fn any(tree: &Tree, leaves: impl Leaves, sides: impl Sides, ray: &Ray, skip: u32) -> bool {
    tree.walk(ray, Any { leaves, sides, skip, t_max: ray.t_max, found: false }).found
}

struct Closest<P, S> {
    leaves: P,
    sides: S,
    skip: u32,
    best: TriHit,
    found: bool,
}

impl<P: Leaves, S: Sides> Visitor for Closest<P, S> {
    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.best.t
    }

    #[inline(always)]
    fn leaf<L: Lanes>(&mut self, leaf: u32, shear: &Shear) -> bool {
        let Self { leaves, sides, skip, best, found } = self;
        crossings::<L>(leaves.leaf(leaf).borrow(), shear, sides, |triangle, Crossing { t, u, v }| {
            let nearer = t < best.t || (t == best.t && triangle < best.triangle);
            if t > 0.0 && nearer && triangle != *skip {
                *best = TriHit { t, triangle, u, v };
                *found = true;
            }
            false
        })
    }
}

struct Any<P, S> {
    leaves: P,
    sides: S,
    skip: u32,
    t_max: f32,
    found: bool,
}

impl<P: Leaves, S: Sides> Visitor for Any<P, S> {
    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }

    #[inline(always)]
    fn leaf<L: Lanes>(&mut self, leaf: u32, shear: &Shear) -> bool {
        let met = self.leaves.leaf(leaf);
        self.found = crossings::<L>(met.borrow(), shear, &self.sides, |triangle, Crossing { t, .. }| {
            t > 0.0 && t < self.t_max && triangle != self.skip
        });
        self.found
    }
}
