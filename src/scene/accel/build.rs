//! The binary tree, by obvhs: PLOC clustering (Meister, Bittner 2018) of chunks that are cut apart where there are many
//! boxes (`cut`), collapse of leaves by the surface area heuristic, then reinsertion (Meister, Bittner 2018, "Parallel
//! Reinsertion").
//!
//! obvhs sees *guide* boxes only, made so that no input hangs it or makes it panic; `collapse` computes the boxes
//! that rays are tested against.

use super::aabb::Aabb;
use super::cut::cut;
use super::guide::Guides;
use obvhs::bvh2::{Bvh2, node::Bvh2Node, reinsertion::ReinsertionOptimizer};
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Cost of a node step in triangle tests, for the collapse of leaves: eight triangles cost about as much as
/// eight boxes, so nearly full leaves pay.
const TRAVERSAL_COST: f32 = 6.0;

/// Share of the nodes in the first of the four passes of reinsertion; the next ones take 1/3, 1/5, 1/7 of it. The
/// gain is near the root, so large trees need no more than `REINSERTED` nodes.
const REINSERTION: f32 = 0.1;
const REINSERTED: f32 = 40_000.0;

/// Trees deeper than this are degenerate; reinsertion is not worth its growing stacks there.
const DEEP: usize = 512;

/// Boxes that `nested` looks at, and the depth of their tree from which it speaks; 15 to 25 is usual.
const SAMPLE: usize = 2048;
const NESTED: usize = 64;

/// More boxes than `LARGE` are cut into chunks of at most `CHUNK`, which are clustered side by side: what that holds
/// meanwhile is small. Numbers of their own, not of threads: the tree is the same for any number of them.
const LARGE: usize = 1 << 20;
const CHUNK: usize = 1 << 16;

/// Topology over `boxes` with at most `leaf_size` of them in a leaf. The boxes of its nodes are not conservative.
pub(super) fn binary_tree(boxes: &[Aabb], leaf_size: usize) -> Bvh2 {
    let mut guides = Guides::new(boxes);
    guides.shrunk = nested(&guides);
    let mut ids = Vec::from_iter(0..boxes.len() as u32);
    let chunk = if boxes.len() > LARGE { CHUNK } else { LARGE };
    let grown = grow(&guides, &mut ids, leaf_size as u32, chunk);
    drop(ids);
    let mut tree = grown.joined();
    reinsert(&mut tree);
    tree
}

/// Trees of chunks, and how they were cut apart.
enum Grown {
    Chunk(Bvh2),
    Pair(Box<[Grown; 2]>),
}

/// The tree of the boxes `ids`, which end up in another order.
fn grow(guides: &Guides, ids: &mut [u32], leaf_size: u32, chunk: usize) -> Grown {
    if ids.len() <= chunk {
        let mut tree = ploc(&Vec::from_iter(ids.iter().map(|&i| guides.get(i))));
        merge_leaves(&mut tree, ids, leaf_size);
        return Grown::Chunk(tree);
    }
    let middle = cut(guides, ids);
    let (left, right) = ids.split_at_mut(middle);
    let (left, right) = rayon::join(|| grow(guides, left, leaf_size, chunk), || grow(guides, right, leaf_size, chunk));
    Grown::Pair(Box::new([left, right]))
}

impl Grown {
    fn root(&self) -> obvhs::aabb::Aabb {
        match self {
            Self::Chunk(tree) => *tree.nodes[0].aabb(),
            Self::Pair(pair) => pair[0].root().union(&pair[1].root()),
        }
    }

    /// One tree, level by level: reinsertion takes its candidates from the front, where they should be large.
    fn joined(self) -> Bvh2 {
        if let Self::Chunk(tree) = self {
            return tree;
        }
        let mut from = vec![(&self, 0)];
        let (mut nodes, mut primitive_indices) = (Vec::new(), Vec::new());
        while let Some(&(grown, i)) = from.get(nodes.len()) {
            let below = from.len() as u32;
            nodes.push(match grown {
                Self::Pair(pair) => {
                    from.extend(pair.iter().map(|grown| (grown, 0)));
                    Bvh2Node::new(grown.root(), 0, below)
                }
                Self::Chunk(tree) => {
                    let mut node = tree.nodes[i];
                    let first = node.first_index as usize;
                    if node.is_leaf() {
                        node.first_index = primitive_indices.len() as u32;
                        let last = first + node.prim_count as usize;
                        primitive_indices.extend_from_slice(&tree.primitive_indices[first..last]);
                    } else {
                        node.first_index = below;
                        from.extend([(grown, first), (grown, first + 1)]);
                    }
                    node
                }
            });
        }
        Bvh2 { nodes, primitive_indices, ..Bvh2::default() }
    }
}

fn ploc(guides: &[obvhs::aabb::Aabb]) -> Bvh2 {
    let indices = (0..guides.len() as u32).collect();
    let (distance, precision) = (PlocSearchDistance::VeryLow, SortPrecision::U64);
    PlocBuilder::with_capacity(guides.len()).build(distance, guides, indices, precision, 3)
}

/// Joins leaves where one larger leaf costs a ray no more, by the surface area heuristic; as obvhs' own
/// `leaf_collapser`, but in two sweeps over the nodes in place of climbing from every leaf.
/// Primitives are named by their `ids`.
fn merge_leaves(tree: &mut Bvh2, ids: &[u32], leaf_size: u32) {
    debug_assert!(tree.children_are_ordered_after_parents);
    let nodes = &tree.nodes;
    // Primitives of what is to be a leaf; 0: an inner node.
    let mut size = vec![0; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        let first = node.first_index as usize;
        size[i] = if node.is_leaf() {
            node.prim_count
        } else {
            merged_size(nodes, i, [size[first], size[first + 1]], leaf_size)
        };
    }
    // Level by level, as `joined` and reinsertion have it.
    let mut from = Vec::from_iter((!nodes.is_empty()).then_some(0));
    let (mut merged, mut primitives) = (Vec::new(), Vec::with_capacity(tree.primitive_indices.len()));
    while let Some(&old) = from.get(merged.len()) {
        let mut node = nodes[old];
        if size[old] > 0 {
            (node.first_index, node.prim_count) = (primitives.len() as u32, size[old]);
            gather(tree, old, &mut primitives);
        } else {
            let first = node.first_index as usize;
            node.first_index = from.len() as u32;
            from.extend([first, first + 1]);
        }
        merged.push(node);
    }
    primitives.iter_mut().for_each(|i| *i = ids[*i as usize]);
    (tree.nodes, tree.primitive_indices) = (merged, primitives);
}

/// Appends the primitives below a node.
fn gather(tree: &Bvh2, node: usize, primitives: &mut Vec<u32>) {
    let node = &tree.nodes[node];
    let first = node.first_index as usize;
    if node.is_leaf() {
        primitives.extend_from_slice(&tree.primitive_indices[first..first + node.prim_count as usize]);
    } else {
        gather(tree, first, primitives); // no deeper than a leaf has primitives
        gather(tree, first + 1, primitives);
    }
}

/// Primitives of the leaf that an inner node becomes, 0 if it stays one.
fn merged_size(nodes: &[Bvh2Node], i: usize, [left, right]: [u32; 2], leaf_size: u32) -> u32 {
    let size = left + right;
    if left == 0 || right == 0 || size > leaf_size {
        return 0;
    }
    let first = nodes[i].first_index as usize;
    let area = |i: usize| nodes[i].aabb().half_area();
    let apart = area(first) * left as f32 + area(first + 1) * right as f32;
    if area(i) * (size as f32 - TRAVERSAL_COST) <= apart { size } else { 0 }
}

/// Whether much of the input is boxes within boxes within boxes, like an onion: each prefers the next smaller one,
/// and PLOC takes n passes for a chain of n. A sample of it is a chain too. Centres then have to do.
fn nested(guides: &Guides) -> bool {
    let stride = guides.boxes.len() / SAMPLE;
    let sample = || (0..guides.boxes.len() as u32).step_by(stride).map(|i| guides.get(i));
    stride > 0 && depth(&ploc(&Vec::from_iter(sample()))) > NESTED
}

/// One pass at a time: obvhs' search panics when its stack of 2 `max_depth` is too small, and every pass may deepen
/// the tree. A search of a tree of depth n holds at most n + 1 entries.
fn reinsert(tree: &mut Bvh2) {
    let share = REINSERTION.min(REINSERTED / tree.nodes.len().max(1) as f32);
    let mut optimizer = ReinsertionOptimizer::default();
    for pass in [1, 3, 5, 7] {
        let depth = depth(tree);
        if depth > DEEP {
            return;
        }
        tree.max_depth = depth + 1;
        optimizer.run(tree, share, Some(vec![1.0 / pass as f32]));
    }
}

/// Nodes on the longest way from the root to a leaf.
fn depth(tree: &Bvh2) -> usize {
    let mut deepest = 0;
    let mut open = Vec::from_iter((!tree.nodes.is_empty()).then_some((0, 1)));
    while let Some((node, depth)) = open.pop() {
        deepest = deepest.max(depth);
        let node = &tree.nodes[node as usize];
        if !node.is_leaf() {
            open.extend([(node.first_index, depth + 1), (node.first_index + 1, depth + 1)]);
        }
    }
    deepest
}
