//! A binary tree over area lights: one of many is drawn at a cost that grows with the logarithm of their number.
//!
//! Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", without the splitting:
//! clusters split by the surface area orientation heuristic, and a descent by what each child might give. A leaf is a light and
//! weighs what this weighs where all are weighed, so that a descent hardly ever ends where nothing is.

use super::{
    bound::{Bound, Cluster},
    choice::Parts,
};
use glam::Vec3;
use std::collections::VecDeque;

/// Area lights up to which all are weighed: a tree costs as much and knows less (docs/performance.md, Lights).
pub const FEW: usize = 16;

/// Nodes from the root on whose visible share is learned by region: five levels.
const PARTS: usize = 63;

const BINS: usize = 12;

/// Levels from which clusters are halved by count: the heuristic may peel off one light at a time.
const DEEPEST: u32 = 40;

const NONE: u32 = u32::MAX;

#[derive(Debug, Clone)]
pub struct Tree {
    /// Breadth first; siblings are neighbours, the left one at an odd index.
    nodes: Vec<Node>,
    /// By light: its leaf; `NONE` for those that are not in the tree.
    leaves: Vec<u32>,
}

#[derive(Debug, Clone)]
struct Node {
    cluster: Cluster,
    parent: u32,
    /// The left child; 0: a leaf.
    left: u32,
    /// Of a leaf.
    light: u32,
}

/// Who asks.
pub struct Receiver<'a, F> {
    pub p: Vec3,
    pub n: Option<Vec3>,
    /// Visible, of the first nodes; of all others 1.
    pub shares: &'a [f32],
    /// Of a light by itself.
    pub weight: F,
}

impl Tree {
    /// Over lights by index, `lights` in all; `None` where they are few.
    pub fn build(bounds: &[(u32, Bound)], lights: usize) -> Option<Self> {
        (bounds.len() > FEW).then(|| Self::over(bounds, lights))
    }

    /// The same, however few; there is one light at least.
    pub fn over(bounds: &[(u32, Bound)], lights: usize) -> Self {
        let mut bounds = bounds.to_vec();
        let mut tree = Self { nodes: Vec::new(), leaves: vec![NONE; lights] };
        tree.nodes.push(Node::of(&bounds, NONE));
        let mut waiting = VecDeque::from([(0, 0..bounds.len(), 0)]);
        while let Some((at, range, depth)) = waiting.pop_front() {
            let own = &mut bounds[range.clone()];
            if let [(light, _)] = own {
                tree.nodes[at].light = *light;
                tree.leaves[*light as usize] = at as u32;
                continue;
            }
            let middle = range.start + split(own, depth);
            let first = tree.nodes.len();
            tree.nodes[at].left = first as u32;
            for (child, part) in [range.start..middle, middle..range.end].into_iter().enumerate() {
                tree.nodes.push(Node::of(&bounds[part.clone()], at as u32));
                waiting.push_back((first + child, part, depth + 1));
            }
        }
        tree
    }

    pub fn contains(&self, light: u32) -> bool {
        self.leaves[light as usize] != NONE
    }

    /// Estimate of what all lights together give at p.
    pub fn importance(&self, p: Vec3, n: Option<Vec3>) -> f64 {
        self.nodes[0].cluster.importance(p, n)
    }

    /// A light and its probability; `None` where none of the clusters passed can reach p.
    pub fn descend(&self, at: &Receiver<impl Fn(u32) -> f64>, mut u: f64) -> Option<(u32, f64)> {
        let (mut node, mut probability) = (0, 1.0);
        while self.nodes[node].left > 0 {
            let left = self.nodes[node].left as usize;
            let share = self.left_share(left, at)?;
            if u < share {
                (node, probability, u) = (left, probability * share, u / share);
            } else {
                (node, probability, u) = (left + 1, probability * (1.0 - share), (u - share) / (1.0 - share));
            }
        }
        Some((self.nodes[node].light, probability))
    }

    /// Probability with which [`Self::descend`] comes to `light`.
    pub fn probability(&self, light: u32, at: &Receiver<impl Fn(u32) -> f64>) -> f64 {
        let (mut node, mut probability) = (self.leaves[light as usize] as usize, 1.0);
        while node > 0 && probability > 0.0 {
            let is_left = node % 2 == 1;
            let left = if is_left { node } else { node - 1 };
            let share = self.left_share(left, at).map(|share| if is_left { share } else { 1.0 - share });
            probability *= share.unwrap_or(0.0);
            node = self.nodes[node].parent as usize;
        }
        probability
    }

    /// Probability of node `left` against its sibling; `None` where neither gives anything.
    fn left_share(&self, left: usize, at: &Receiver<impl Fn(u32) -> f64>) -> Option<f64> {
        let weight = |i: usize| {
            let node = &self.nodes[i];
            let importance = match node.left {
                0 => (at.weight)(node.light),
                _ => node.cluster.importance(at.p, at.n),
            };
            importance * f64::from(at.shares.get(i).copied().unwrap_or(1.0))
        };
        let (a, b) = (weight(left), weight(left + 1));
        (a + b > 0.0).then(|| a / (a + b))
    }

    /// Adds the first nodes to `parts`, which may hold other lights already.
    pub fn add_parts(&self, parts: &mut Parts) {
        let offset = parts.parents.len() as u32;
        let known = self.nodes.len().min(PARTS);
        parts
            .parents
            .extend(self.nodes[..known].iter().map(|node| (node.parent != NONE).then(|| offset + node.parent)));
        for (light, leaf) in self.leaves.iter().enumerate().filter(|(_, leaf)| **leaf != NONE) {
            let mut at = *leaf;
            while at as usize >= known {
                at = self.nodes[at as usize].parent;
            }
            parts.of_light[light] = offset + at;
        }
    }
}

impl Node {
    fn of(lights: &[(u32, Bound)], parent: u32) -> Self {
        let bound = lights.iter().map(|(_, bound)| bound.clone()).reduce(|a, b| a.union(&b));
        let bound = bound.expect("a cluster holds lights");
        Self { cluster: Cluster::new(&bound), parent, left: 0, light: 0 }
    }
}

/// Sorts the lights into two clusters; the number of those in the first, which is neither 0 nor all.
fn split(lights: &mut [(u32, Bound)], depth: u32) -> usize {
    let centre = |bound: &Bound| 0.5 * (bound.min + bound.max);
    let (lo, hi) = lights
        .iter()
        .map(|(_, bound)| (centre(bound), centre(bound)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        .expect("a cluster holds lights");
    let size = hi - lo;
    let bin = |bound: &Bound, axis: usize| {
        let x = (centre(bound)[axis] - lo[axis]) / size[axis];
        ((x * BINS as f32) as usize).min(BINS - 1)
    };
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| depth < DEEPEST && size[axis] > 0.0 && size[axis].is_finite()) {
        let mut bins: [Option<Bound>; BINS] = [const { None }; BINS];
        for (_, bound) in lights.iter() {
            let slot = &mut bins[bin(bound, axis)];
            *slot = Some(slot.as_ref().map_or(bound.clone(), |old| old.union(bound)));
        }
        // Thin slices of long boxes are worse than their area says (Conty Estevez and Kulla 2018, section 4.4).
        let regularity = f64::from(size.max_element() / size[axis]);
        for (plane, cost) in costs(&bins) {
            if best.is_none_or(|(least, ..)| regularity * cost < least) {
                best = Some((regularity * cost, axis, plane));
            }
        }
    }
    let Some((_, axis, plane)) = best else { return lights.len() / 2 };
    // Stable: the tree is a function of the scene.
    lights.sort_by_key(|(_, bound)| bin(bound, axis) >= plane);
    lights.iter().filter(|(_, bound)| bin(bound, axis) < plane).count()
}

/// Cost of a split before each bin that leaves lights on both sides.
fn costs(bins: &[Option<Bound>; BINS]) -> impl Iterator<Item = (usize, f64)> {
    let mut below: [Option<Bound>; BINS] = [const { None }; BINS];
    let mut above = below.clone();
    let join = |a: &Option<Bound>, b: &Option<Bound>| match (a, b) {
        (Some(a), Some(b)) => Some(a.union(b)),
        (a, b) => a.clone().or_else(|| b.clone()),
    };
    for i in 1..BINS {
        below[i] = join(&below[i - 1], &bins[i - 1]);
    }
    above[BINS - 1] = bins[BINS - 1].clone();
    for i in (0..BINS - 1).rev() {
        above[i] = join(&above[i + 1], &bins[i]);
    }
    (1..BINS).filter_map(move |i| Some((i, below[i].as_ref()?.cost() + above[i].as_ref()?.cost())))
}
