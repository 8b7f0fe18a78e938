//! Which of many boxes overlap a box: a binary tree over them, halved along the axis on which their middles lie furthest
//! apart.

use super::accel::Aabb;
use std::ops::Range;

/// Boxes that are asked one by one.
const FEW: usize = 4;

pub(super) struct Boxes<'a> {
    boxes: &'a [Aabb],
    /// Indices of boxes; those of a node follow each other.
    order: Vec<u32>,
    /// Depth first.
    nodes: Vec<Node>,
}

struct Node {
    bounds: Aabb,
    /// Of `order`.
    range: Range<usize>,
    /// The second child, the first comes next; 0: there is none.
    second: usize,
}

impl<'a> Boxes<'a> {
    pub fn new(boxes: &'a [Aabb]) -> Self {
        let mut tree = Self { boxes, order: (0..boxes.len() as u32).collect(), nodes: Vec::new() };
        tree.build(0..boxes.len());
        tree
    }

    fn build(&mut self, range: Range<usize>) {
        let at = self.nodes.len();
        let all = |f: fn(&Aabb, &Aabb) -> Aabb, of: fn(&Aabb) -> Aabb| {
            let boxes = self.order[range.clone()].iter().map(|&i| of(&self.boxes[i as usize]));
            boxes.fold(Aabb::EMPTY, |all, next| f(&all, &next))
        };
        let bounds = all(Aabb::union, |of| *of);
        let middles = all(Aabb::union, |of| Aabb { min: of.centre(), max: of.centre() }).extent();
        self.nodes.push(Node { bounds, range: range.clone(), second: 0 });
        if range.len() <= FEW {
            return;
        }
        // Of boxes without end middles are no numbers: they are halved by their order all the same.
        let axis = (0..3).max_by(|&a, &b| middles[a].total_cmp(&middles[b])).unwrap_or(0);
        let half = range.len() / 2;
        let middle = |i: u32| self.boxes[i as usize].centre()[axis];
        self.order[range.clone()]
            .select_nth_unstable_by(half, |&a, &b| middle(a).total_cmp(&middle(b)).then(a.cmp(&b)));
        self.build(range.start..range.start + half);
        self.nodes[at].second = self.nodes.len();
        self.build(range.start + half..range.end);
    }

    /// Those that overlap `with`, ascending.
    pub fn overlapping(&self, with: &Aabb) -> Vec<u32> {
        let mut found = Vec::new();
        let mut waiting = vec![0];
        while let Some(at) = waiting.pop() {
            let node = &self.nodes[at];
            if !overlap(&node.bounds, with) {
                continue;
            }
            if node.second > 0 {
                waiting.extend([node.second, at + 1]);
            } else {
                let few = self.order[node.range.clone()].iter().copied();
                found.extend(few.filter(|&i| overlap(&self.boxes[i as usize], with)));
            }
        }
        found.sort_unstable();
        found
    }
}

pub(super) fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::sampler::Sampler;
    use glam::Vec3;

    /// Boxes of all sizes, some flat, empty, without end, or the same as another.
    fn crowd(n: u32, seed: u32) -> Vec<Aabb> {
        let mut sampler = Sampler::new(seed, 0, 0);
        let mut v = |scale: f32| Vec3::from_array(std::array::from_fn(|_| sampler.random())) * scale;
        let boxes = (0..n).map(|i| {
            let min = v(10.0).round() * if i % 3 == 0 { 1.0 } else { 0.97 };
            match i % 11 {
                0 => Aabb::EMPTY,
                1 => Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY },
                2 => {
                    Aabb { min: Vec3::new(min.x, f32::NEG_INFINITY, min.z), max: Vec3::new(min.x, f32::INFINITY, 20.0) }
                }
                3 => Aabb { min, max: min },
                k => Aabb { min, max: min + v(3.0_f32.powi(k as i32 - 7)) },
            }
        });
        boxes.collect()
    }

    #[test]
    fn the_tree_finds_what_asking_all_finds() {
        for (seed, n) in [0, 1, 4, 5, 40, 700].into_iter().enumerate() {
            let boxes = crowd(n, seed as u32);
            let tree = Boxes::new(&boxes);
            for with in boxes.iter().chain(&crowd(60, 99)) {
                let all: Vec<u32> = (0..n).filter(|&i| overlap(&boxes[i as usize], with)).collect();
                assert_eq!(tree.overlapping(with), all, "{with:?}");
            }
        }
    }

    /// A row along each axis in turn: a sweep along one of them would look at everything.
    #[test]
    fn what_is_apart_is_not_looked_at() {
        for axis in 0..3 {
            let at = |i: u32| Vec3::AXES[axis] * (2 * i) as f32;
            let boxes: Vec<Aabb> = (0..4096).map(|i| Aabb { min: at(i), max: at(i) + 1.0 }).collect();
            let tree = Boxes::new(&boxes);
            assert_eq!(tree.overlapping(&boxes[777]), [777]);
            // 1024 leaves of 4: ten levels.
            let depth = |at: usize| boxes_met(&tree, &boxes[at]);
            assert!((0..4096).step_by(97).all(|at| depth(at) < 40), "axis {axis}");
        }
    }

    /// Nodes that are looked at.
    fn boxes_met(tree: &Boxes, with: &Aabb) -> usize {
        let (mut waiting, mut met) = (vec![0], 0);
        while let Some(at) = waiting.pop() {
            met += 1;
            if tree.nodes[at].second > 0 && overlap(&tree.nodes[at].bounds, with) {
                waiting.extend([tree.nodes[at].second, at + 1]);
            }
        }
        met
    }
}
