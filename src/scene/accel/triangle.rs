//! Watertight ray-triangle intersection, eight triangles at a time.
//!
//! Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection": translate by the origin, shear so that the
//! ray is the z axis, and test three 2D edge functions. The function of an edge depends on its two end points
//! only, and swapping them negates it exactly (no fused multiply-add), so two triangles that share an edge
//! cannot both reject a ray.

use super::Ray;
use super::lanes::Lanes;
use glam::Vec3;

/// Triangles of a leaf.
pub(super) const WIDTH: usize = 8;

/// Up to eight triangles. Unused lanes hold NaN, which no comparison accepts.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Leaf {
    /// Indexed by vertex, axis, lane.
    pub(super) p: [[[f32; 8]; 3]; 3],
    /// Index of the triangle in the input.
    pub id: [u32; 8],
}

impl Leaf {
    pub const EMPTY: Self = Self { p: [[[f32::NAN; 8]; 3]; 3], id: [u32::MAX; 8] };

    /// At most eight triangles, by their indices.
    pub fn of(ids: &[u32], corners: impl Fn(u32) -> [Vec3; 3]) -> Self {
        let mut leaf = Self::EMPTY;
        ids.iter().enumerate().for_each(|(lane, &id)| leaf.set(lane, id, corners(id)));
        leaf
    }

    pub fn set(&mut self, lane: usize, id: u32, p: [Vec3; 3]) {
        for (vertex, p) in p.iter().enumerate() {
            for axis in 0..3 {
                self.p[vertex][axis][lane] = p[axis];
            }
        }
        self.id[lane] = id;
    }

    pub fn corners(&self, lane: usize) -> [Vec3; 3] {
        self.p.map(|vertex| Vec3::new(vertex[0][lane], vertex[1][lane], vertex[2][lane]))
    }
}

/// Where a ray meets a triangle: the distance and the weights of the second and third vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    pub t: f32,
    pub u: f32,
    pub v: f32,
}

/// A ray's axis permutation and shear, section 3.1 of the paper.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shear {
    /// Axes; the last is the one along which |d| is largest.
    k: [usize; 3],
    /// Origin, in the order of `k`.
    o: [f32; 3],
    /// d_x / d_z, d_y / d_z, 1 / d_z.
    s: [f32; 3],
}

impl Shear {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let a = ray.d.abs();
        let z = if a.x > a.y && a.x > a.z {
            0
        } else if a.y > a.z {
            1
        } else {
            2
        };
        let k = [(z + 1) % 3, (z + 2) % 3, z];
        let [dx, dy, dz] = k.map(|axis| ray.d[axis]);
        Self { k, o: k.map(|axis| ray.o[axis]), s: [dx / dz, dy / dz, 1.0 / dz] }
    }

    /// Bit mask of the triangles that the line crosses, edges included, and the three edge functions.
    /// Zeros among them are still to be decided by [`Shear::crossing`].
    #[inline(always)]
    pub fn edges<L: Lanes>(&self, leaf: &Leaf) -> (u32, [L; 3]) {
        let a = self.vertices::<L>(&leaf.p[0]);
        let b = self.vertices::<L>(&leaf.p[1]);
        let c = self.vertices::<L>(&leaf.p[2]);
        let (zero, e) = (L::splat(0.0), [cross(c, b), cross(a, c), cross(b, a)]);
        let low = e[0].min(e[1]).min(e[2]);
        let high = e[0].max(e[1]).max(e[2]);
        (zero.le(low) | high.le(zero), e)
    }

    /// Sheared x and y of one vertex of eight triangles.
    #[inline(always)]
    fn vertices<L: Lanes>(&self, p: &[[f32; 8]; 3]) -> [L; 2] {
        let x = L::load(&p[self.k[0]]).sub(L::splat(self.o[0]));
        let y = L::load(&p[self.k[1]]).sub(L::splat(self.o[1]));
        let z = L::load(&p[self.k[2]]).sub(L::splat(self.o[2]));
        [x.sub(L::splat(self.s[0]).mul(z)), y.sub(L::splat(self.s[1]).mul(z))]
    }

    /// The crossing with the triangle in `lane`, whose edge functions in f32 are `e`.
    #[inline(always)]
    pub fn crossing(&self, leaf: &Leaf, lane: usize, e: [f32; 3]) -> Option<Crossing> {
        let w = if e[0] == 0.0 || e[1] == 0.0 || e[2] == 0.0 { self.weights_f64(leaf, lane)? } else { weights(e) };
        let (p, k) = (&leaf.p, self.k[2]);
        let z = [p[0][k][lane] - self.o[2], p[1][k][lane] - self.o[2], p[2][k][lane] - self.o[2]];
        // Exact where the triangle is perpendicular to the axis, unlike the sum of three weighted depths.
        let t = (z[0] + w[1] * (z[1] - z[0]) + w[2] * (z[2] - z[0])) * self.s[2];
        Some(Crossing { t, u: w[1], v: w[2] })
    }

    /// A zero edge function is decided in f64, where the product of two f32 is exact (section 3.2 of the paper).
    #[cold]
    fn weights_f64(&self, leaf: &Leaf, lane: usize) -> Option<[f32; 3]> {
        let [a, b, c] = [0, 1, 2].map(|vertex| self.vertex(&leaf.p[vertex], lane));
        let cross = |a: [f64; 2], b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
        let e = [cross(c, b), cross(a, c), cross(b, a)];
        let sum = e[0] + e[1] + e[2];
        let inside = e.iter().all(|&e| e >= 0.0) || e.iter().all(|&e| e <= 0.0);
        // A sum of zero is a triangle seen edge on or without area: nothing to hit.
        (inside && sum != 0.0).then(|| e.map(|e| (e / sum) as f32))
    }

    /// One lane of [`Shear::vertices`]: the same f32 operations, hence the same values.
    fn vertex(&self, p: &[[f32; 8]; 3], lane: usize) -> [f64; 2] {
        let [x, y, z] = [0, 1, 2].map(|i| p[self.k[i]][lane] - self.o[i]);
        [f64::from(x - self.s[0] * z), f64::from(y - self.s[1] * z)]
    }
}

/// Barycentric weights from non-zero edge functions of one sign. Divisions, not a reciprocal, which would
/// overflow for triangles below 1e-19.
#[inline(always)]
fn weights(e: [f32; 3]) -> [f32; 3] {
    let sum = e[0] + e[1] + e[2];
    [e[0] / sum, e[1] / sum, e[2] / sum]
}

/// cross(a, b) == -cross(b, a), exactly.
#[inline(always)]
fn cross<L: Lanes>(a: [L; 2], b: [L; 2]) -> L {
    a[0].mul(b[1]).sub(a[1].mul(b[0]))
}
