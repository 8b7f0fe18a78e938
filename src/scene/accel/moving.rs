//! The triangles of a mesh whose points move: a tree over where they are within a stretch of time, vertices
//! interpolated for each ray.
//!
//! Triangles that share an edge interpolate its ends by the same operations, so the test stays watertight.

use super::Ray;
use super::aabb::Aabb;
use super::blas::{Both, Front, Leaves, TriHit, any, closest};
use super::build::binary_tree;
use super::collapse::{collapse, node_bounds};
use super::nearest::{ClosestPoint, closest_point_under};
use super::traverse::Tree;
use super::triangle::{Leaf, WIDTH};
use glam::{Mat3, Vec3};

/// What `between` rounds by, in units of the larger coordinate: a difference, a product and a sum, each within half of
/// an epsilon of at most twice that.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

/// Linear from `a` to `b`; exactly `a` where they are one.
#[inline(always)]
pub fn between(a: Vec3, b: Vec3, f: f32) -> Vec3 {
    a + (b - a) * f
}

/// Bottom-level acceleration structure of points that go straight from one place to another.
#[derive(Debug, Clone)]
pub struct MovingBlas {
    tree: Tree,
    /// At the start and at the end.
    leaves: Vec<[Leaf; 2]>,
    one_sided: bool,
}

impl MovingBlas {
    /// As `Blas::build`, for points at the start and at the end, as many of both.
    pub fn build(points: [&[Vec3]; 2], triangles: &[[u32; 3]]) -> Self {
        let corner = |k: usize, i: u32| points[k].get(i as usize).copied().unwrap_or(Vec3::NAN);
        let boxes: Vec<Aabb> = triangles.iter().map(|t| swept([0, 1].map(|k| t.map(|i| corner(k, i))))).collect();
        let binary = binary_tree(&boxes, WIDTH);
        let mut leaves = Vec::new();
        let tree = collapse(&binary, node_bounds(&binary, &boxes), |ids| {
            leaves.push([0, 1].map(|k| Leaf::of(ids, |id| triangles[id as usize].map(|i| corner(k, i)))));
            leaves.len() as u32 - 1
        });
        Self { tree, leaves, one_sided: false }
    }

    /// As `Blas::one_sided`.
    pub fn one_sided(self, one_sided: bool) -> Self {
        Self { one_sided, ..self }
    }

    /// As `Blas::closest_skip`, where the points are the share `f` of their way.
    pub fn closest_skip(&self, ray: &Ray, skip: u32, f: f32) -> Option<TriHit> {
        if self.one_sided {
            return closest(&self.tree, self.at(f), Front(ray.d), ray, skip);
        }
        closest(&self.tree, self.at(f), Both, ray, skip)
    }

    /// As `Blas::any_skip`.
    pub fn any_skip(&self, ray: &Ray, skip: u32, f: f32) -> bool {
        if self.one_sided {
            return any(&self.tree, self.at(f), Front(ray.d), ray, skip);
        }
        any(&self.tree, self.at(f), Both, ray, skip)
    }

    /// As `Blas::closest_point_under`.
    pub fn closest_point_under(&self, metric: &Mat3, least_stretch: f32, p: Vec3, f: f32) -> Option<ClosestPoint> {
        closest_point_under(&self.tree, |i| self.at(f).leaf(i), metric, least_stretch, p)
    }

    /// Of all the time; object space.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds
    }

    /// Bytes.
    pub fn memory(&self) -> usize {
        self.tree.memory() + size_of_val(self.leaves.as_slice())
    }

    fn at(&self, f: f32) -> Underway<'_> {
        Underway { leaves: &self.leaves, f }
    }
}

/// A box around a triangle on its way. Its interpolated sides are no longer than those at the ends.
fn swept([a, b]: [[Vec3; 3]; 2]) -> Aabb {
    let size = |v: [Vec3; 3]| v[0].abs().max(v[1].abs()).max(v[2].abs());
    Aabb::of_triangle(a).union(&Aabb::of_triangle(b)).pad(size(a).max(size(b)) * ROUNDING)
}

/// Leaves where they are for a ray.
#[derive(Clone, Copy)]
struct Underway<'a> {
    leaves: &'a [[Leaf; 2]],
    f: f32,
}

impl Leaves for Underway<'_> {
    type Leaf = Leaf;

    #[inline(always)]
    fn leaf(&self, i: u32) -> Leaf {
        let [a, b] = &self.leaves[i as usize];
        let mut leaf = *a;
        for vertex in 0..3 {
            for axis in 0..3 {
                for lane in 0..8 {
                    let (from, to) = (a.p[vertex][axis][lane], b.p[vertex][axis][lane]);
                    leaf.p[vertex][axis][lane] = from + (to - from) * self.f;
                }
            }
        }
        leaf
    }
}
