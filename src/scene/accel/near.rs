//! The triangles of a mesh that are near something: a walk through the boxes that are.

use super::aabb::Aabb;
use super::blas::Blas;
use super::node::{LEAF, Node};
use super::triangle::WIDTH;
use glam::Vec3;

impl Blas {
    /// Whether a triangle is `wanted`, by its corners; those in boxes that are not `near` are not asked.
    pub fn any_triangle(&self, near: impl Fn(&Aabb) -> bool, wanted: impl Fn([Vec3; 3]) -> bool) -> bool {
        let mut waiting = vec![0];
        while let Some(child) = waiting.pop() {
            if child & LEAF != 0 {
                let leaf = &self.leaves[(child & !LEAF) as usize];
                // Lanes without a triangle hold no numbers, of which nothing is true.
                if (0..WIDTH).any(|lane| wanted(leaf.corners(lane))) {
                    return true;
                }
                continue;
            }
            let node = &self.tree.nodes[child as usize];
            waiting.extend((0..node.count()).filter(|&slot| near(&node.bounds(slot))).map(|slot| node.child[slot]));
        }
        false
    }
}

impl Node {
    fn bounds(&self, slot: usize) -> Aabb {
        let corner = |side: usize| Vec3::from_array([0, 1, 2].map(|axis| self.planes[axis][side][slot]));
        Aabb { min: corner(0), max: corner(1) }
    }
}
