//! The walk through a tree of eight-wide nodes, nearest child first.

use super::Ray;
use super::aabb::Aabb;
use super::lanes::{Isa, Lanes, Portable};
use super::node::{BoxRay, LEAF, Node, WIDEN};
use std::mem::{MaybeUninit, replace};

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
            self.walk_stack::<L, V>(ray, &mut [const { MaybeUninit::uninit() }; 128], visitor);
        } else {
            self.walk_stack::<L, V>(ray, &mut vec![MaybeUninit::uninit(); self.stack], visitor);
        }
    }

    /// Goes on to the nearest child at once; only the others wait on the stack.
    #[inline(always)]
    fn walk_stack<L: Lanes, V: Visitor>(&self, ray: &Ray, stack: &mut [MaybeUninit<Entry>], visitor: &mut V) {
        let boxes = BoxRay::<L>::new(ray);
        let (mut top, mut child) = (0, 0); // the root
        loop {
            if child & LEAF == 0 {
                let node = &self.nodes[child as usize];
                let (mut hits, near) = boxes.test(node, visitor.t_max());
                if hits != 0 {
                    let mut nearest = take(node, &near, &mut hits);
                    let first = top;
                    while hits != 0 {
                        let entry = take(node, &near, &mut hits);
                        let farther = if entry.near < nearest.near { replace(&mut nearest, entry) } else { entry };
                        insert(stack, first, top, farther);
                        top += 1;
                    }
                    child = nearest.child;
                    continue;
                }
            } else if visitor.leaf::<L>(child & !LEAF) {
                return;
            }
            loop {
                if top == 0 {
                    return;
                }
                top -= 1;
                // SAFETY: every entry below `top` was written by `insert`.
                let entry = unsafe { stack[top].assume_init() };
                if entry.near <= visitor.t_max() * WIDEN {
                    child = entry.child;
                    break;
                }
            }
        }
    }
}

/// The child in the lowest lane of `hits`, which loses it.
#[inline(always)]
fn take(node: &Node, near: &[f32; 8], hits: &mut u32) -> Entry {
    let lane = hits.trailing_zeros() as usize & 7;
    *hits &= *hits - 1;
    Entry { child: node.child[lane], near: near[lane] }
}

/// Inserts into the descending run `stack[first..top]`; the nearest ends on top.
#[inline(always)]
fn insert(stack: &mut [MaybeUninit<Entry>], first: usize, top: usize, entry: Entry) {
    let mut at = top;
    // SAFETY: the run was written entry by entry.
    while at > first && unsafe { stack[at - 1].assume_init() }.near < entry.near {
        stack[at] = stack[at - 1];
        at -= 1;
    }
    stack[at] = MaybeUninit::new(entry);
}
