//! A node of eight child boxes, and the slab test of a ray against all of them.

use super::Ray;
use super::aabb::Aabb;
use super::lanes::Lanes;
use glam::Vec3;

/// Marks a [`Node::child`] as a leaf; the other bits are its index.
pub(super) const LEAF: u32 = 1 << 31;

/// A slot without a child.
const UNUSED: u32 = u32::MAX;

/// Far distances grow by this factor. Near and far distances carry 3 roundings each, far ones two more of the factor itself (Ize 2013, "Robust BVH Ray
/// Traversal", section 3), the triangle test may move its hit by up to 12 of the distance (see `aabb::PAD`);
/// together below 32 unit roundoffs. Wider than Ize's 2 ulps because his exact intersections do not move.
pub(super) const WIDEN: f32 = 1.0 + 16.0 * f32::EPSILON;

#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// By axis, then minimum and maximum, one lane per child. Unused lanes hold the empty box.
    pub(super) planes: [[[f32; 8]; 2]; 3],
    pub child: [u32; 8],
}

impl Node {
    pub const EMPTY: Self = Self { planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3], child: [UNUSED; 8] };

    /// Slots in use: the children fill them from the first on.
    pub fn count(&self) -> usize {
        self.child.iter().position(|&c| c == UNUSED).unwrap_or(8)
    }

    /// The child in `slot` and its box.
    pub fn get(&self, slot: usize) -> (Aabb, u32) {
        let corner = |side: usize| Vec3::from_array([0, 1, 2].map(|axis: usize| self.planes[axis][side][slot]));
        (Aabb { min: corner(0), max: corner(1) }, self.child[slot])
    }

    /// Asks for what will be looked at soon, before it is.
    #[inline(always)]
    pub fn prefetch(&self) {
        #[cfg(target_arch = "x86_64")]
        for line in 0..size_of::<Self>() / 64 {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let at = std::ptr::from_ref(self).cast::<i8>().wrapping_add(64 * line);
            // SAFETY: every such processor has the instruction, which reads nothing.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(at) };
        }
    }

    pub fn set(&mut self, slot: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.planes[axis][0][slot] = bounds.min[axis];
            self.planes[axis][1][slot] = bounds.max[axis];
        }
        self.child[slot] = child;
    }
}

/// What the slab test needs of a ray, spread over the lanes.
pub(super) struct BoxRay<L> {
    o: [L; 3],
    inv_d: [L; 3],
    /// `inv_d` times [`WIDEN`].
    inv_d_far: [L; 3],
    /// Whether the ray meets the minimum (0) or the maximum (1) of an axis first.
    near: [usize; 3],
}

impl<L: Lanes> BoxRay<L> {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        // The sign bit, not d < 0: -0.0 gives an inverse of -inf and needs the order that goes with it.
        let near = |axis: usize| usize::from(ray.d[axis].is_sign_negative());
        let inv_d = [1.0 / ray.d.x, 1.0 / ray.d.y, 1.0 / ray.d.z];
        Self {
            o: [L::splat(ray.o.x), L::splat(ray.o.y), L::splat(ray.o.z)],
            inv_d: [L::splat(inv_d[0]), L::splat(inv_d[1]), L::splat(inv_d[2])],
            inv_d_far: [L::splat(inv_d[0] * WIDEN), L::splat(inv_d[1] * WIDEN), L::splat(inv_d[2] * WIDEN)],
            near: [near(0), near(1), near(2)],
        }
    }

    /// Bit mask of the children the ray may meet in (0, t_max], and the distances at which it enters and leaves them.
    ///
    /// 0 * inf (an origin on a slab's plane, a direction along it) is NaN; as first operand of `min` and `max`
    /// it drops out, which leaves the box to the other axes: never culled by it.
    #[inline(always)]
    pub fn test(&self, node: &Node, t_max: f32) -> (u32, L, L) {
        let (mut near, mut far) = (L::splat(0.0), L::splat(t_max * WIDEN));
        for axis in 0..3 {
            let side = self.near[axis] & 1;
            near = self.slab(node, axis, side).mul(self.inv_d[axis]).max(near);
            far = self.slab(node, axis, side ^ 1).mul(self.inv_d_far[axis]).min(far);
        }
        (near.le(far), near, far)
    }

    /// From the origin to one plane of each child.
    #[inline(always)]
    fn slab(&self, node: &Node, axis: usize, side: usize) -> L {
        L::load(&node.planes[axis][side]).sub(self.o[axis])
    }
}
