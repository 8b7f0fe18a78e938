//! A binary tree over area lights: one of many is drawn at a cost that grows with the logarithm of their number.
//!
//! Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", without the splitting:
//! clusters split by the surface area orientation heuristic, and a descent by what each child might give. Leaves hold a few
//! lights and weigh what these weigh, so that a descent hardly ever ends where nothing is.

use super::{
    bound::{Bound, Cluster},
    choice::Parts,
};
use glam::Vec3;
use std::collections::VecDeque;

/// Area lights up to which all are weighed: a tree costs as much and knows less (docs/performance.md, Lights).
pub const FEW: usize = 16;

/// Most lights of a leaf: weighing four costs about what two levels of the tree do, and knows more.
const LEAF: usize = 4;

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
    /// Lights, leaf by leaf.
    order: Vec<u32>,
    /// By light: its leaf; `NONE` for those that are not in the tree.
    leaves: Vec<u32>,
}

#[derive(Debug, Clone)]
struct Node {
    cluster: Cluster,
    parent: u32,
    /// The left child; of a leaf, its first place in `order`.
    first: u32,
    /// Lights of a leaf; 0: an inner node.
    count: u32,
}

impl Tree {
    /// Over lights by index, `lights` in all; `None` where they are few.
    pub fn build(bounds: &[(u32, Bound)], lights: usize) -> Option<Self> {
        (bounds.len() > FEW).then(|| Self::over(bounds, lights))
    }

    /// The same, however few; there is one light at least.
    pub fn over(bounds: &[(u32, Bound)], lights: usize) -> Self {
        let mut bounds = bounds.to_vec();
        let mut tree = Self { nodes: Vec::new(), order: Vec::new(), leaves: vec![NONE; lights] };
        tree.nodes.push(Node::of(&bounds, NONE));
        let mut waiting = VecDeque::from([(0, 0..bounds.len(), 0)]);
        while let Some((at, range, depth)) = waiting.pop_front() {
            let own = &mut bounds[range.clone()];
            if own.len() <= LEAF {
                tree.make_leaf(at, own);
                continue;
            }
            let middle = range.start + split(own, depth);
            let first = tree.nodes.len();
            tree.nodes[at].first = first as u32;
            for (child, part) in [range.start..middle, middle..range.end].into_iter().enumerate() {
                tree.nodes.push(Node::of(&bounds[part.clone()], at as u32));
                waiting.push_back((first + child, part, depth + 1));
            }
        }
        tree
    }

    fn make_leaf(&mut self, at: usize, lights: &[(u32, Bound)]) {
        self.nodes[at].first = self.order.len() as u32;
        self.nodes[at].count = lights.len() as u32;
        for (light, _) in lights {
            self.order.push(*light);
            self.leaves[*light as usize] = at as u32;
        }
    }

    pub fn contains(&self, light: u32) -> bool {
        self.leaves[light as usize] != NONE
    }

    /// Estimate of what all lights together give at p.
    pub fn importance(&self, p: Vec3, n: Option<Vec3>) -> f64 {
        self.nodes[0].cluster.importance(p, n)
    }

    /// A leaf's lights, the probability of having come there, and `u` remapped; `None` where no light of the clusters passed
    /// can reach p. `shares`: visible shares of the first nodes, of all others 1; `light`: the weight of one.
    pub fn descend(
        &self,
        p: Vec3,
        n: Option<Vec3>,
        shares: &[f32],
        light: impl Fn(u32) -> f64,
        u: f64,
    ) -> Option<(&[u32], f64, f64)> {
        let (mut at, mut probability, mut u) = (0, 1.0, u);
        while self.nodes[at].count == 0 {
            let left = self.nodes[at].first as usize;
            let share = self.left_share(left, p, n, shares, &light)?;
            if u < share {
                (at, probability, u) = (left, probability * share, u / share);
            } else {
                (at, probability, u) = (left + 1, probability * (1.0 - share), (u - share) / (1.0 - share));
            }
        }
        Some((self.of_leaf(at), probability, u))
    }

    /// Probability with which [`Self::descend`] comes to the leaf of `light`, and the lights there.
    pub fn probability(
        &self,
        light: u32,
        p: Vec3,
        n: Option<Vec3>,
        shares: &[f32],
        weight: impl Fn(u32) -> f64,
    ) -> (f64, &[u32]) {
        let leaf = self.leaves[light as usize] as usize;
        let (mut at, mut probability) = (leaf, 1.0);
        while at > 0 && probability > 0.0 {
            let is_left = at % 2 == 1;
            let left = if is_left { at } else { at - 1 };
            let share = self.left_share(left, p, n, shares, &weight).map(|share| if is_left { share } else { 1.0 - share });
            probability *= share.unwrap_or(0.0);
            at = self.nodes[at].parent as usize;
        }
        (probability, self.of_leaf(leaf))
    }

    /// Probability of node `left` against its sibling; `None` where neither gives anything.
    fn left_share(
        &self,
        left: usize,
        p: Vec3,
        n: Option<Vec3>,
        shares: &[f32],
        light: &impl Fn(u32) -> f64,
    ) -> Option<f64> {
        let weight = |node: usize| {
            let share = shares.get(node).copied().unwrap_or(1.0);
            let importance = match self.nodes[node].count {
                0 => self.nodes[node].cluster.importance(p, n),
                _ => self.of_leaf(node).iter().map(|&l| light(l)).sum(),
            };
            importance * f64::from(share)
        };
        let (a, b) = (weight(left), weight(left + 1));
        (a + b > 0.0).then(|| a / (a + b))
    }

    fn of_leaf(&self, at: usize) -> &[u32] {
        let node = &self.nodes[at];
        &self.order[node.first as usize..(node.first + node.count) as usize]
    }

    /// Adds the first nodes to `parts`, which may hold other lights already.
    pub fn add_parts(&self, parts: &mut Parts) {
        let offset = parts.parents.len() as u32;
        let known = self.nodes.len().min(PARTS);
        parts.parents.extend(self.nodes[..known].iter().map(|node| (node.parent != NONE).then(|| offset + node.parent)));
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
        Self { cluster: Cluster::new(&bound), parent, first: 0, count: 0 }
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
