//! The point of a mesh that is closest to a given one: boxes nearest first, pruned by the distance found.

use super::blas::Blas;
use super::node::LEAF;
use super::traverse::Tree;
use super::triangle::Leaf;
use glam::{DMat3, DVec3, Mat3, Vec3};
use std::borrow::Borrow;

/// The nearest point (1 - u - v) a + u b + v c of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Index into the triangles the [`Blas`] was built from.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    pub point: Vec3,
    /// In the space in which distances are measured.
    pub distance_squared: f32,
}

/// Lower bounds of squared distances shrink by this factor: a box's carries 4 roundings, the scale that of its
/// computation and square, together below 16 unit roundoffs.
const SHRINK: f32 = 1.0 - 8.0 * f32::EPSILON;

impl Blas {
    /// The nearest point of all triangles, those without area included; at equal distance of the lowest index.
    /// `None` without finite triangles.
    pub fn closest_point(&self, p: Vec3) -> Option<ClosestPoint> {
        self.closest_point_under(&Mat3::IDENTITY, 1.0, p)
    }

    /// As [`Blas::closest_point`], with distances measured after the linear map `metric`, which shortens no vector
    /// by more than the factor `least_stretch`.
    pub fn closest_point_under(&self, metric: &Mat3, least_stretch: f32, p: Vec3) -> Option<ClosestPoint> {
        closest_point_under(&self.tree, |i| &self.leaves[i as usize], metric, least_stretch, p)
    }
}

/// Of the triangles in the leaves that `leaf` finds.
pub(super) fn closest_point_under<T: Borrow<Leaf>>(
    tree: &Tree,
    leaf: impl Fn(u32) -> T,
    metric: &Mat3,
    least_stretch: f32,
    p: Vec3,
) -> Option<ClosestPoint> {
    let scale = least_stretch * least_stretch * SHRINK;
    let mut query = Query { metric: metric.as_dmat3(), p, scale, best: None, bound: f64::INFINITY };
    tree.nearest(p, scale, |i| query.leaf(leaf(i).borrow()));
    query.best
}

struct Query {
    metric: DMat3,
    p: Vec3,
    /// Of squared distances to boxes, for a lower bound of those measured.
    scale: f32,
    best: Option<ClosestPoint>,
    /// Squared distance of `best`.
    bound: f64,
}

impl Query {
    /// Looks at a leaf's triangles; returns a squared distance that nothing farther can beat.
    fn leaf(&mut self, leaf: &Leaf) -> f32 {
        let (p, near) = (self.p.as_dvec3(), leaf.distances_squared(self.p));
        for (lane, near) in near.into_iter().enumerate() {
            if near * self.scale > rounded_up(self.bound) {
                continue;
            }
            let corners = leaf.corners(lane).map(|q| q.as_dvec3());
            let [u, v, distance] = closest_on_triangle(corners.map(|q| self.metric * (q - p)));
            let lower = self.best.is_none_or(|best| leaf.id[lane] < best.triangle);
            // False with NaN: unused lanes and triangles with non-finite vertices.
            if distance < self.bound || (distance == self.bound && lower && distance < f64::INFINITY) {
                let [a, b, c] = corners;
                let point = (a + u * (b - a) + v * (c - a)).as_vec3();
                let (u, v, distance_squared) = (u as f32, v as f32, distance as f32);
                self.best = Some(ClosestPoint { triangle: leaf.id[lane], u, v, point, distance_squared });
                self.bound = distance;
            }
        }
        rounded_up(self.bound)
    }
}

fn rounded_up(x: f64) -> f32 {
    x as f32 * (1.0 + f32::EPSILON) // to nearest is half an epsilon off; exact where it overflows
}

/// u, v and squared distance of the point of triangle `abc` closest to the origin: the best of the feet on its three
/// edges and its plane. Each is a point of the triangle however thin it is, so distances are never too short.
fn closest_on_triangle([a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let foot = |from: DVec3, along: DVec3| {
        let length = along.length_squared();
        if length > 0.0 { (-from.dot(along) / length).clamp(0.0, 1.0) } else { 0.0 }
    };
    let on_bc = foot(b, bc);
    let mut feet = [[foot(a, ab), 0.0], [0.0, foot(a, ac)], [1.0 - on_bc, on_bc], [0.0, 0.0]];
    // By cross products: the determinant of scalar products would square the condition of a sliver.
    let n = ab.cross(ac);
    let area = n.length_squared();
    let [u, v] = [n.dot(ac.cross(a)) / area, n.dot(a.cross(ab)) / area];
    if area > 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
        feet[3] = [u, v];
    }
    let measured = feet.map(|[u, v]| [u, v, (a + u * ab + v * ac).length_squared()]);
    measured.into_iter().reduce(|best, foot| if foot[2] < best[2] { foot } else { best }).unwrap_or([f64::NAN; 3])
}

/// Squared distances from `p` to eight boxes, as [`Node::planes`] has them. Infinite for empty ones.
fn distances_squared(planes: &[[[f32; 8]; 2]; 3], p: Vec3) -> [f32; 8] {
    let mut sum = [0.0; 8];
    for axis in 0..3 {
        for (i, sum) in sum.iter_mut().enumerate() {
            let outside = larger(larger(planes[axis][0][i] - p[axis], p[axis] - planes[axis][1][i]), 0.0);
            *sum += outside * outside;
        }
    }
    sum
}

/// Unlike f32's min and max one instruction, with whatever NaN gives.
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl Leaf {
    /// Squared distances from `p` to the boxes of the triangles.
    fn distances_squared(&self, p: Vec3) -> [f32; 8] {
        let [a, b, c] = &self.p;
        let extreme = |pick: fn(f32, f32) -> f32, axis: usize| {
            std::array::from_fn(|i| pick(pick(a[axis][i], b[axis][i]), c[axis][i]))
        };
        distances_squared(&[0, 1, 2].map(|axis| [extreme(smaller, axis), extreme(larger, axis)]), p)
    }
}

/// A child and the squared distance to its box.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    child: u32,
    near: f32,
}

/// Inserts into the descending run `stack[first..top]`; the nearest ends on top.
fn insert(stack: &mut [Entry], first: usize, top: usize, entry: Entry) {
    let at = first + stack[first..top].partition_point(|e| e.near >= entry.near);
    stack.copy_within(at..top, at + 1);
    stack[at] = entry;
}

impl Tree {
    /// Calls `leaf` for leaves about nearest first; it returns the squared distance below which leaves are still of
    /// interest. Squared distances to boxes times `scale` are a lower bound of those.
    fn nearest(&self, p: Vec3, scale: f32, mut leaf: impl FnMut(u32) -> f32) {
        if !p.is_finite() {
            return;
        }
        let (mut fixed, mut heap); // as in `Tree::walk_lanes`
        let stack: &mut [Entry] = if self.stack <= 128 {
            fixed = [Entry::default(); 128];
            &mut fixed
        } else {
            heap = vec![Entry::default(); self.stack];
            &mut heap
        };
        let (mut top, mut bound) = (1, f32::INFINITY);
        while top > 0 {
            top -= 1;
            let Entry { child, near } = stack[top];
            if near > bound {
                continue;
            }
            if child & LEAF != 0 {
                bound = leaf(child & !LEAF);
                continue;
            }
            let node = &self.nodes[child as usize];
            let (distances, first) = (distances_squared(&node.planes, p), top);
            for (&child, distance) in node.child.iter().zip(distances).take(node.count()) {
                let near = distance * scale;
                if near <= bound {
                    insert(stack, first, top, Entry { child, near });
                    top += 1;
                }
            }
        }
    }
}
