//! The walk through a tree of eight-wide nodes, nearest child first.

use super::Ray;
use super::aabb::Aabb;
use super::lanes::{Isa, Lanes, Portable};
use super::node::{BoxRay, LEAF, Node, WIDEN};

/// Nodes in depth-first order, the root first.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    /// The largest number of entries a walk can have on its stack (`collapse::stack_need`).
    pub stack: usize,
    pub bounds: Aabb,
    pub isa: Isa,
}

/// What a walk does at the leaves. Implementations are `#[inline(always)]`: they run inside the function that
/// may use the wide instructions.
pub(super) trait Visitor {
    /// End of the interval still of interest.
    fn t_max(&self) -> f32;
    /// True ends the walk.
    fn leaf<L: Lanes>(&mut self, leaf: u32) -> bool;
}

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    pub child: u32,
    /// Where the ray enters the child's box.
    pub near: f32,
}

impl Tree {
    pub fn memory(&self) -> usize {
        size_of_val(self.nodes.as_slice())
    }

    pub fn walk<V: Visitor>(&self, ray: &Ray, visitor: &mut V) {
        if !ray.is_finite() {
            return;
        }
        match self.isa {
            Isa::Portable => self.walk_lanes::<Portable, V>(ray, visitor),
            // SAFETY: `isa` is Avx2 only where the processor has it.
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => unsafe { self.walk_avx2(ray, visitor) },
        }
    }

    /// # Safety
    /// The processor must have AVX2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn walk_avx2<V: Visitor>(&self, ray: &Ray, visitor: &mut V) {
        self.walk_lanes::<super::lanes::Avx2, V>(ray, visitor);
    }

    /// Ordinary trees find room on the machine's stack; one degenerate enough to need more pays for the heap.
    #[inline(always)]
    fn walk_lanes<L: Lanes, V: Visitor>(&self, ray: &Ray, visitor: &mut V) {
        if self.stack <= 128 {
            self.walk_stack::<L, V>(ray, &mut [Entry::default(); 128], visitor);
        } else {
            self.walk_stack::<L, V>(ray, &mut vec![Entry::default(); self.stack], visitor);
        }
    }

    #[inline(always)]
    fn walk_stack<L: Lanes, V: Visitor>(&self, ray: &Ray, stack: &mut [Entry], visitor: &mut V) {
        let boxes = BoxRay::<L>::new(ray);
        let mut top = 1; // stack[0] is the root, entered at 0.
        while top > 0 {
            top -= 1;
            let Entry { child, near } = stack[top];
            if near > visitor.t_max() * WIDEN {
                continue;
            }
            if child & LEAF != 0 {
                if visitor.leaf::<L>(child & !LEAF) {
                    return;
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let (mut hits, near) = boxes.test(node, visitor.t_max());
            let first = top;
            while hits != 0 {
                let lane = hits.trailing_zeros() as usize;
                hits &= hits - 1;
                let entry = Entry { child: node.child[lane & 7], near: near[lane & 7] };
                insert(stack, first, top, entry);
                top += 1;
            }
        }
    }
}

/// Inserts into the descending run `stack[first..top]`; the nearest ends on top.
#[inline(always)]
pub(super) fn insert(stack: &mut [Entry], first: usize, top: usize, entry: Entry) {
    let mut at = top;
    while at > first && stack[at - 1].near < entry.near {
        stack[at] = stack[at - 1];
        at -= 1;
    }
    stack[at] = entry;
}
