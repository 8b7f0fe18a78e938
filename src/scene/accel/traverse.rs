//! The walk through a tree of eight-wide nodes: nearest child first, or first that in which most of the ray is.

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

/// Which of the children that a ray meets a walk goes to first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// A hit there spares what is behind it.
    Nearest,
    /// The longest way inside: any hit will do, and boxes of objects are the fuller the longer it is.
    Longest,
}

/// What a walk does at the leaves. Implementations are `#[inline(always)]`: they run inside the function that
/// may use the wide instructions.
pub(super) trait Visitor {
    const ORDER: Order = Order::Nearest;

    /// End of the interval still of interest.
    fn t_max(&self) -> f32;
    /// True ends the walk.
    fn leaf<L: Lanes>(&mut self, leaf: u32, shear: &Shear) -> bool;
}

/// A tree of more nodes than these, 256 KB, does not stay in the second cache beside its leaves and what else is used.
const LARGE: usize = 1 << 10;

/// A child and a distance, most often where the ray enters its box, ordered by that: distances from 0 on order as their bits do, and whole
/// numbers have a smaller and a larger one without a branch, which nobody could predict here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Entry(u64);

impl Entry {
    #[inline(always)]
    fn new(child: u32, distance: f32) -> Self {
        Self(u64::from(distance.to_bits()) << 32 | u64::from(child))
    }

    #[inline(always)]
    fn child(self) -> u32 {
        self.0 as u32
    }

    #[inline(always)]
    fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// Children that wait; where they are in order, the nearest of each node on top. `ASKS` for them as they come.
struct Stack<'a, const ASKS: bool> {
    nodes: &'a [Node],
    entries: &'a mut [MaybeUninit<Entry>],
    top: usize,
}

impl<const ASKS: bool> Stack<'_, ASKS> {
    #[inline(always)]
    fn push(&mut self, entry: Entry) {
        self.ask(entry);
        self.entries[self.top] = MaybeUninit::new(entry);
        self.top += 1;
    }

    /// While the walk goes on elsewhere.
    #[inline(always)]
    fn ask(&self, entry: Entry) {
        let child = entry.child();
        if ASKS && child & LEAF == 0 {
            // SAFETY: as in `walk_stack`.
            unsafe { self.nodes.get_unchecked(child as usize) }.prefetch();
        }
    }

    /// Pushes into the descending run that begins at `first`.
    #[inline(always)]
    fn insert(&mut self, first: usize, entry: Entry) {
        self.ask(entry);
        let mut at = self.top;
        // SAFETY: every entry below `top` was written.
        while at > first && unsafe { self.entries[at - 1].assume_init() } < entry {
            self.entries[at] = self.entries[at - 1];
            at -= 1;
        }
        self.entries[at] = MaybeUninit::new(entry);
        self.top += 1;
    }

    /// The next child whose distance is not beyond `t`.
    #[inline(always)]
    fn pop(&mut self, t: f32) -> Option<u32> {
        while self.top > 0 {
            self.top -= 1;
            // SAFETY: every entry below `top` was written.
            let entry = unsafe { self.entries[self.top].assume_init() };
            if entry.distance() <= t {
                return Some(entry.child());
            }
        }
        None
    }

    /// The next child.
    #[inline(always)]
    fn pop_any(&mut self) -> Option<u32> {
        self.top = self.top.checked_sub(1)?;
        // SAFETY: every entry below `top` was written.
        Some(unsafe { self.entries[self.top].assume_init() }.child())
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
            // SAFETY: `isa` is Avx512 only where the processor has them.
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => unsafe { self.walk_avx512(ray, visitor) },
        }
    }

    /// # Safety
    /// The processor must have AVX2, BMI1 and BMI2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2")]
    unsafe fn walk_avx2<V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        self.walk_lanes::<super::lanes::Avx2, V>(ray, visitor)
    }

    /// # Safety
    /// The processor must have AVX-512 with VL, BW and DQ, BMI1 and BMI2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,bmi1,bmi2")]
    unsafe fn walk_avx512<V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        self.walk_lanes::<super::lanes::Avx2, V>(ray, visitor)
    }

    /// Ordinary trees find room on the machine's stack; one degenerate enough to need more pays for the heap.
    #[inline(always)]
    fn walk_lanes<L: Lanes, V: Visitor>(&self, ray: &Ray, visitor: V) -> V {
        if self.stack > 128 {
            self.walk_stack::<L, V, true>(ray, &mut vec![MaybeUninit::uninit(); self.stack], visitor)
        } else if self.nodes.len() > LARGE {
            self.walk_stack::<L, V, true>(ray, &mut [const { MaybeUninit::uninit() }; 128], visitor)
        } else {
            self.walk_stack::<L, V, false>(ray, &mut [const { MaybeUninit::uninit() }; 128], visitor)
        }
    }

    /// Goes on to the first child at once; only the others wait on the stack.
    #[inline(always)]
    fn walk_stack<L: Lanes, V: Visitor, const ASKS: bool>(
        &self,
        ray: &Ray,
        entries: &mut [MaybeUninit<Entry>],
        mut visitor: V,
    ) -> V {
        let boxes = BoxRay::<L>::new(ray);
        let mut shear = None; // many a short segment meets no leaf
        let mut stack = Stack::<ASKS> { nodes: &self.nodes, entries, top: 0 };
        let mut child = 0; // the root
        loop {
            if child & LEAF == 0 {
                // SAFETY: `collapse` makes every reference, to nodes that are there.
                let node = unsafe { self.nodes.get_unchecked(child as usize) };
                let (hits, near, far) = boxes.test(node, visitor.t_max());
                if hits != 0 {
                    child = match V::ORDER {
                        Order::Nearest => nearest(node, &near.store(), hits, &mut stack),
                        Order::Longest => longest(node, &far.sub(near).store(), hits, &mut stack),
                    };
                    continue;
                }
            } else if visitor.leaf::<L>(child & !LEAF, made(&mut shear, ray)) {
                return visitor;
            }
            let next = match V::ORDER {
                Order::Nearest => stack.pop(visitor.t_max() * WIDEN),
                Order::Longest => stack.pop_any(),
            };
            match next {
                Some(next) => child = next,
                None => return visitor,
            }
        }
    }
}

/// The nearest of the children in `hits`, at least one; the others go onto the stack. Most often they are one to three.
#[inline(always)]
fn nearest<const ASKS: bool>(node: &Node, near: &[f32; 8], mut hits: u32, stack: &mut Stack<ASKS>) -> u32 {
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

/// The child with the longest way inside; the others go onto the stack as they come.
#[inline(always)]
fn longest<const ASKS: bool>(node: &Node, inside: &[f32; 8], mut hits: u32, stack: &mut Stack<ASKS>) -> u32 {
    let mut a = take(node, inside, &mut hits);
    while hits != 0 {
        let b = take(node, inside, &mut hits);
        stack.push(a.min(b));
        a = a.max(b);
    }
    a.child()
}

/// The child in the lowest lane of `hits`, which loses it.
#[inline(always)]
fn take(node: &Node, distance: &[f32; 8], hits: &mut u32) -> Entry {
    let lane = hits.trailing_zeros() as usize & 7;
    *hits &= *hits - 1;
    Entry::new(node.child[lane], distance[lane])
}

/// A method of `Option` would take a closure, which need not be inlined (see `lanes`).
#[inline(always)]
fn made<'a>(shear: &'a mut Option<Shear>, ray: &Ray) -> &'a Shear {
    if shear.is_none() {
        *shear = Some(Shear::new(ray));
    }
    shear.as_ref().expect("made above")
}
