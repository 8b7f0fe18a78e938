//! A tree over area lights: one of many is drawn at a cost that grows with the logarithm of their number.
//!
//! After Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", eight children wide
//! in place of the splitting: a descent chooses among more clusters at a time, which are smaller, and weighs them together.

use super::{
    bound::Bound,
    choice::Parts,
    lanes::{LANES, Lanes},
    split::split,
};
use glam::Vec3;
use std::{collections::VecDeque, ops::Range};

/// Area lights up to which all are weighed: a tree knows less (docs/performance.md, Lights).
pub const FEW: usize = 16;

/// Nodes from the root on of whose children visible shares are learned by region: two levels.
const KNOWN: usize = 1 + LANES;

/// Levels of which a receiver's descents remember the last node; all below share the last one.
const REMEMBERED: usize = 4;

const NONE: u32 = u32::MAX;

#[derive(Debug, Clone)]
pub struct Tree {
    /// Breadth first.
    nodes: Vec<Node>,
    /// By light: the child that it is; of no node, those that are not in the tree.
    leaves: Vec<Place>,
}

#[derive(Debug, Clone)]
struct Node {
    lanes: Lanes,
    children: [Child; LANES],
    /// By bit: children that are lights.
    lights: u32,
    /// The child that this node is.
    place: Place,
}

#[derive(Debug, Clone, Copy)]
enum Child {
    Node(u32),
    Light(u32),
    None,
}

/// A child of a node.
#[derive(Debug, Clone, Copy)]
struct Place {
    node: u32,
    lane: u32,
}

impl Place {
    const NONE: Self = Self { node: NONE, lane: 0 };

    /// Its part among those of the tree; 0 is the root.
    fn part(self) -> u32 {
        if self.node == NONE { 0 } else { 1 + self.node * LANES as u32 + self.lane }
    }
}

/// Who asks.
pub struct Receiver<'a, F> {
    pub p: Vec3,
    pub n: Option<Vec3>,
    /// Visible, of the tree's parts; of all others 1.
    pub shares: &'a [f32],
    /// By node, as bits: children with a light that is for it; `None`: all are.
    pub lanes: Option<&'a [u8]>,
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
        let mut tree = Self { nodes: Vec::new(), leaves: vec![Place::NONE; lights] };
        let mut waiting = VecDeque::from([(Cluster::of(&bounds, 0..bounds.len(), 0), Place::NONE)]);
        let mut named = 1;
        while let Some((cluster, place)) = waiting.pop_front() {
            let clusters = cluster.open(&mut bounds);
            let node = tree.nodes.len() as u32;
            let lanes: Vec<Bound> = clusters.iter().map(|cluster| cluster.bound.clone()).collect();
            let (mut children, mut lights) = ([Child::None; LANES], 0);
            for (lane, cluster) in clusters.into_iter().enumerate() {
                let at = Place { node, lane: lane as u32 };
                if cluster.range.len() == 1 {
                    let light = bounds[cluster.range.start].0;
                    children[lane] = Child::Light(light);
                    lights |= 1 << lane;
                    tree.leaves[light as usize] = at;
                } else {
                    children[lane] = Child::Node(named);
                    named += 1;
                    waiting.push_back((cluster, at));
                }
            }
            tree.nodes.push(Node { lanes: Lanes::new(&lanes), children, lights, place });
        }
        tree
    }

    pub fn contains(&self, light: u32) -> bool {
        self.leaves[light as usize].node != NONE
    }

    /// Descents for one receiver.
    pub fn descents<'a, F: Fn(u32) -> f64>(&'a self, at: Receiver<'a, F>) -> Descents<'a, F> {
        Descents { tree: self, at, passed: [Passed::NOTHING; REMEMBERED] }
    }

    /// Estimate of what all lights together give.
    pub fn irradiance(&self, at: &Receiver<impl Fn(u32) -> f64>) -> f64 {
        self.weigh(0, at).sum * self.nodes[0].lanes.unit
    }

    /// Probability with which a descent comes to `light`.
    pub fn probability(&self, light: u32, at: &Receiver<impl Fn(u32) -> f64>) -> f64 {
        let (mut place, mut probability) = (self.leaves[light as usize], 1.0);
        while place.node != NONE && probability > 0.0 {
            probability *= self.weigh(place.node, at).share(place.lane as usize);
            place = self.nodes[place.node as usize].place;
        }
        probability
    }

    /// Weighs a node's children. A light about the receiver weighs what it weighs by itself: from behind or within, nothing.
    #[inline]
    fn weigh(&self, node: u32, at: &Receiver<impl Fn(u32) -> f64>) -> Passed {
        let of = &self.nodes[node as usize];
        let given = of.lanes.weigh(at.p, at.n);
        let mut weights = [0.0; LANES];
        given.fours[0].write_to_slice(&mut weights[..4]);
        given.fours[1].write_to_slice(&mut weights[4..]);
        let mut near = given.near & of.lights;
        while near != 0 {
            let lane = near.trailing_zeros() as usize;
            let Child::Light(light) = of.children[lane] else { break };
            weights[lane] = of.lanes.weight((at.weight)(light));
            near &= near - 1;
        }
        let first = Place { node, lane: 0 }.part() as usize;
        if let Some(shares) = at.shares.get(first..first + LANES) {
            (0..LANES).for_each(|lane| weights[lane] *= shares[lane]);
        }
        if let Some(lanes) = at.lanes {
            let linked = lanes[node as usize];
            (0..LANES).filter(|lane| linked >> lane & 1 == 0).for_each(|lane| weights[lane] = 0.0);
        }
        let sum = weights.iter().map(|weight| f64::from(*weight)).sum();
        Passed { node, weights, sum }
    }

    /// By node, as bits: children that are or hold a light which is `wanted`.
    pub fn lanes_with(&self, wanted: impl Fn(u32) -> bool) -> Vec<u8> {
        let mut lanes = vec![0; self.nodes.len()];
        // Children come after their parents.
        for (i, node) in self.nodes.iter().enumerate().rev() {
            for (lane, child) in node.children.iter().enumerate() {
                let has = match *child {
                    Child::Node(child) => lanes[child as usize] != 0,
                    Child::Light(light) => wanted(light),
                    Child::None => false,
                };
                lanes[i] |= u8::from(has) << lane;
            }
        }
        lanes
    }

    /// Adds the root and the children of the first nodes to `parts`, which may hold other lights already.
    pub fn add_parts(&self, parts: &mut Parts) {
        let offset = parts.parents.len() as u32;
        let known = self.nodes.len().min(KNOWN);
        parts.parents.push(None);
        for node in &self.nodes[..known] {
            parts.parents.extend([Some(offset + node.place.part()); LANES]);
        }
        for (light, leaf) in self.leaves.iter().enumerate().filter(|(_, leaf)| leaf.node != NONE) {
            let mut at = *leaf;
            while at.node as usize >= known {
                at = self.nodes[at.node as usize].place;
            }
            parts.of_light[light] = offset + at.part();
        }
    }
}

/// A node that was weighed.
#[derive(Debug, Clone, Copy)]
struct Passed {
    node: u32,
    /// Of its children.
    weights: [f32; LANES],
    sum: f64,
}

impl Passed {
    const NOTHING: Self = Self { node: NONE, weights: [0.0; LANES], sum: 0.0 };

    fn share(&self, lane: usize) -> f64 {
        if self.sum > 0.0 { f64::from(self.weights[lane]) / self.sum } else { 0.0 }
    }

    /// A child and `u` remapped; nothing where none gives anything.
    #[inline]
    fn pick(&self, u: f64) -> Option<(usize, f64)> {
        let mut left = u * self.sum;
        // Rounding may leave a remainder beyond the last weight: it is the last child's.
        let mut last = None;
        for (lane, weight) in self.weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            let weight = f64::from(*weight);
            if left < weight {
                return Some((lane, left / weight));
            }
            left -= weight;
            last = Some((lane, 1.0));
        }
        last
    }
}

/// Descents for one receiver: neighbours in u pass the same nodes, which are weighed once.
pub struct Descents<'a, F> {
    tree: &'a Tree,
    at: Receiver<'a, F>,
    /// By depth, the last ones.
    passed: [Passed; REMEMBERED],
}

impl<F: Fn(u32) -> f64> Descents<'_, F> {
    pub fn irradiance(&mut self) -> f64 {
        self.pass(0, 0).sum * self.tree.nodes[0].lanes.unit
    }

    /// A light and its probability; `None` where none of the clusters passed can reach the receiver.
    pub fn descend(&mut self, mut u: f64) -> Option<(u32, f64)> {
        let (mut node, mut probability) = (0, 1.0);
        for depth in 0.. {
            let passed = self.pass(node, depth);
            let (lane, rest) = passed.pick(u)?;
            (probability, u) = (probability * passed.share(lane), rest);
            match self.tree.nodes[node as usize].children[lane] {
                Child::Node(child) => node = child,
                Child::Light(light) => return Some((light, probability)),
                Child::None => break,
            }
        }
        None
    }

    #[inline]
    fn pass(&mut self, node: u32, depth: usize) -> &Passed {
        let last = &mut self.passed[depth.min(REMEMBERED - 1)];
        if last.node != node {
            *last = self.tree.weigh(node, &self.at);
        }
        last
    }
}

/// Lights that are neighbours.
struct Cluster {
    range: Range<usize>,
    bound: Bound,
    /// Halvings that led to it.
    depth: u32,
}

impl Cluster {
    fn of(lights: &[(u32, Bound)], range: Range<usize>, depth: u32) -> Self {
        let bound = lights[range.clone()].iter().map(|(_, bound)| bound.clone()).reduce(|a, b| a.union(&b));
        Self { range, bound: bound.expect("a cluster holds lights"), depth }
    }

    /// Its clusters, at most [`LANES`]: halved as long as there is room, the one with the greatest cost first. Neighbours stay
    /// neighbours.
    fn open(self, lights: &mut [(u32, Bound)]) -> Vec<Self> {
        let mut clusters = vec![self];
        while clusters.len() < LANES {
            let cost = |at: &usize| clusters[*at].bound.cost();
            let divisible = (0..clusters.len()).filter(|&at| clusters[at].range.len() > 1);
            let Some(at) = divisible.max_by(|a, b| cost(a).total_cmp(&cost(b))) else { break };
            let Self { range, depth, .. } = clusters.remove(at);
            let middle = range.start + split(&mut lights[range.clone()], depth);
            for (i, part) in [range.start..middle, middle..range.end].into_iter().enumerate() {
                clusters.insert(at + i, Self::of(lights, part, depth + 1));
            }
        }
        clusters
    }
}
