//! The walk through a tree of eight-wide nodes, nearest child first.

use super::Ray;
use super::aabb::Aabb;
use super::lanes::{Isa, Lanes, Portable};
use super::node::{BoxRay, LEAF, Node, WIDEN};
use super::triangle::Shear;
use std::mem::MaybeUninit;

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
    fn leaf<L: Lanes>(&mut self, leaf: u32, shear: &Shear) -> bool;
}

/// A child and where the ray enters its box, ordered by that: distances from 0 on order as their bits do, and whole
/// numbers have a smaller and a larger one without a branch, which nobody could predict here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Entry(u64);

impl Entry {
    #[inline(always)]
    fn new(child: u32, near: f32) -> Self {
        Self(u64::from(near.to_bits()) << 32 | u64::from(child))
    }

    #[inline(always)]
    fn child(self) -> u32 {
        self.0 as u32
    }

    #[inline(always)]
    fn near(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// Children that wait, the nearest of each node on top.
struct Stack<'a> {
    entries: &'a mut [MaybeUninit<Entry>],
    top: usize,
}

impl Stack<'_> {
    #[inline(always)]
    fn push(&mut self, entry: Entry) {
        self.entries[self.top] = MaybeUninit::new(entry);
        self.top += 1;
    }

    /// Pushes into the descending run that begins at `first`.
    #[inline(always)]
    fn insert(&mut self, first: usize, entry: Entry) {
        let mut at = self.top;
        // SAFETY: every entry below `top` was written.
        while at > first && unsafe { self.entries[at - 1].assume_init() } < entry {
            self.entries[at] = self.entries[at - 1];
            at -= 1;
        }
        self.entries[at] = MaybeUninit::new(entry);
        self.top += 1;
    }

    /// The next child that is entered before `t`.
    #[inline(always)]
    fn pop(&mut self, t: f32) -> Option<u32> {
        while self.top > 0 {
            self.top -= 1;
            // SAFETY: every entry below `top` was written.
            let entry = unsafe { self.entries[self.top].assume_init() };
            if entry.near() <= t {
                return Some(entry.child());
            }
        }
        None
    }
}

impl Tree {
    pub fn memory(&self) -> usize {
        size_of_val(self.nodes.as_slice())
    }

    /// The boxes `levels` below the root, or of leaves above: together they hold everything.
    pub fn boxes(&self, levels: u32, visit: &mut impl FnMut(Aabb)) {
        self.boxes_below(0, levels, visit);
    }

    fn boxes_below(&self, node: u32, levels: u32, visit: &mut impl FnMut(Aabb)) {
        let Some(node) = self.nodes.get(node as usize) else { return };
        for (bounds, child) in (0..node.count()).map(|slot| node.get(slot)) {
            if levels <= 1 || child & LEAF != 0 {
                visit(bounds);
            } else {
                self.boxes_below(child, levels - 1, visit);
            }
        }
    }

    /// The visitor comes back as the walk leaves it; by value, so that its fields can be registers.
    #[inline(always)]
    pub fn walk<V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        if !ray.is_finite() {
            return visitor;
        }
        match self.isa {
            Isa::Portable => self.walk_lanes::<Portable, V>(ray, visitor),
            // SAFETY: `isa` is Avx2 only where the processor has them.
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => unsafe { self.walk_avx2(ray, visitor) },
        }
    }

    /// # Safety
    /// The processor must have AVX2, BMI1 and BMI2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2")]
    unsafe fn walk_avx2<V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        self.walk_lanes::<super::lanes::Avx2, V>(ray, visitor)
    }

    /// Ordinary trees find room on the machine's stack; one degenerate enough to need more pays for the heap.
    #[inline(always)]
    fn walk_lanes<L: Lanes, V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        if self.stack <= 128 {
            self.walk_stack::<L, V>(ray, &mut [const { MaybeUninit::uninit() }; 128], visitor)
        } else {
            self.walk_stack::<L, V>(ray, &mut vec![MaybeUninit::uninit(); self.stack], visitor)
        }
    }

    /// Goes on to the nearest child at once; only the others wait on the stack.
    #[inline(always)]
    fn walk_stack<L: Lanes, V: Visitor>(&self, ray: &Ray, entries: &mut [MaybeUninit<Entry>], mut visitor: V) -> V {
        let boxes = BoxRay::<L>::new(ray);
        let mut shear = None; // many a short segment meets no leaf
        let mut stack = Stack { entries, top: 0 };
        let mut child = 0; // the root
        loop {
            if child & LEAF == 0 {
                // SAFETY: `collapse` makes every reference, to nodes that are there.
                let node = unsafe { self.nodes.get_unchecked(child as usize) };
                let (hits, near) = boxes.test(node, visitor.t_max());
                if hits != 0 {
                    child = nearest(node, &near, hits, &mut stack);
                    continue;
                }
            } else if visitor.leaf::<L>(child & !LEAF, made(&mut shear, ray)) {
                return visitor;
            }
            match stack.pop(visitor.t_max() * WIDEN) {
                Some(next) => child = next,
                None => return visitor,
            }
        }
    }
}

/// The nearest of the children in `hits`, at least one; the others go onto the stack. Most often they are one to three.
#[inline(always)]
fn nearest(node: &Node, near: &[f32; 8], mut hits: u32, stack: &mut Stack) -> u32 {
    let a = take(node, near, &mut hits);
    if hits == 0 {
        return a.child();
    }
    let b = take(node, near, &mut hits);
    let (a, b) = (a.min(b), a.max(b));
    if hits == 0 {
        stack.push(b);
        return a.child();
    }
    let c = take(node, near, &mut hits);
    let (b, c) = (b.min(c), b.max(c));
    let (mut a, b) = (a.min(b), a.max(b));
    let first = stack.top;
    stack.push(c);
    stack.push(b);
    while hits != 0 {
        let d = take(node, near, &mut hits);
        stack.insert(first, a.max(d));
        a = a.min(d);
    }
    a.child()
}

/// The child in the lowest lane of `hits`, which loses it.
#[inline(always)]
fn take(node: &Node, near: &[f32; 8], hits: &mut u32) -> Entry {
    let lane = hits.trailing_zeros() as usize & 7;
    *hits &= *hits - 1;
    Entry::new(node.child[lane], near[lane])
}

/// A method of `Option` would take a closure, which need not be inlined (see `lanes`).
#[inline(always)]
fn made<'a>(shear: &'a mut Option<Shear>, ray: &Ray) -> &'a Shear {
    if shear.is_none() {
        *shear = Some(Shear::new(ray));
    }
    shear.as_ref().expect("made above")
}
