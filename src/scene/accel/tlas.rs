//! The boxes of placed objects.

use super::Ray;
use super::aabb::Aabb;
use super::build::binary_tree;
use super::collapse::{collapse, node_bounds};
use super::lanes::Lanes;
use super::traverse::{Order, Tree, Visitor};
use super::triangle::Shear;

/// Top-level acceleration structure.
#[derive(Debug, Clone)]
pub struct Tlas {
    pub(super) tree: Tree,
    /// The one object there is: its own tree finds out whether it is met.
    only: Option<u32>,
}

impl Tlas {
    /// Boxes may overlap, coincide, be infinite or empty (the last are never visited). At most 2^31.
    pub fn build(boxes: &[Aabb]) -> Self {
        let only = (boxes.len() == 1 && !boxes[0].is_empty()).then_some(0);
        let binary = binary_tree(boxes, 1);
        Self { tree: collapse(&binary, node_bounds(&binary, boxes), |ids| ids[0]), only }
    }

    /// Visits the boxes that the ray meets in (0, t_max), about nearest first (a single one in any case); `visit` gets the index of a box,
    /// shrinks `ray.t_max` when it finds a hit inside and returns true to stop. It must leave `o` and `d` alone.
    /// The order depends on the boxes and the ray only.
    pub fn traverse(&self, ray: &mut Ray, mut visit: impl FnMut(u32, &mut Ray) -> bool) {
        if let Some(only) = self.only {
            visit(only, ray);
            return;
        }
        let start = *ray;
        self.tree.walk(&start, Objects { ray, visit });
    }

    /// As [`Tlas::traverse`] for a ray that stops at the first hit: in no order of distance, but about first where most of
    /// the ray is inside.
    pub fn traverse_any(&self, ray: &Ray, mut visit: impl FnMut(u32) -> bool) {
        if let Some(only) = self.only {
            visit(only);
            return;
        }
        self.tree.walk(ray, AnyObject { t_max: ray.t_max, visit });
    }

    /// Empty without boxes.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds
    }

    /// Bytes.
    pub fn memory(&self) -> usize {
        self.tree.memory()
    }
}

struct Objects<'a, F> {
    ray: &'a mut Ray,
    visit: F,
}

impl<F: FnMut(u32, &mut Ray) -> bool> Visitor for Objects<'_, F> {
    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.ray.t_max
    }

    #[inline(always)]
    fn leaf<L: Lanes>(&mut self, object: u32, _: &Shear) -> bool {
        (self.visit)(object, self.ray)
    }
}

struct AnyObject<F> {
    t_max: f32,
    visit: F,
}

impl<F: FnMut(u32) -> bool> Visitor for AnyObject<F> {
    const ORDER: Order = Order::Longest;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }

    #[inline(always)]
    fn leaf<L: Lanes>(&mut self, object: u32, _: &Shear) -> bool {
        (self.visit)(object)
    }
}
