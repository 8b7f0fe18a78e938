//! The binary tree, by obvhs: PLOC clustering (Meister, Bittner 2018), collapse of leaves by the surface area
//! heuristic, then reinsertion (Meister, Bittner 2018, "Parallel Reinsertion").
//!
//! obvhs sees *guide* boxes only, made so that no input hangs it or makes it panic; `collapse` computes the boxes
//! that rays are tested against.

use super::aabb::Aabb;
use glam::{DVec3, Vec3};
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

/// Topology over `boxes` with at most `leaf_size` of them in a leaf. The boxes of its nodes are not conservative.
pub(super) fn binary_tree(boxes: &[Aabb], leaf_size: usize) -> Bvh2 {
    let mut guides = guide_boxes(boxes);
    if nested(&guides) {
        guides.iter_mut().for_each(|b| *b = obvhs::aabb::Aabb::from_point(b.center()));
    }
    let mut tree = ploc(&guides);
    merge_leaves(&mut tree, leaf_size as u32);
    reinsert(&mut tree);
    tree
}

fn ploc(guides: &[obvhs::aabb::Aabb]) -> Bvh2 {
    let indices = (0..guides.len() as u32).collect();
    let (distance, precision) = (PlocSearchDistance::VeryLow, SortPrecision::U64);
    PlocBuilder::with_capacity(guides.len()).build(distance, guides, indices, precision, 3)
}

/// Joins leaves where one larger leaf costs a ray no more, by the surface area heuristic; as obvhs' own
/// `leaf_collapser`, but in two sweeps over the nodes in place of climbing from every leaf.
fn merge_leaves(tree: &mut Bvh2, leaf_size: u32) {
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
    // Level by level: reinsertion takes its candidates from the front, where they should be large.
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
fn nested(guides: &[obvhs::aabb::Aabb]) -> bool {
    let stride = guides.len() / SAMPLE;
    stride > 0 && depth(&ploc(&Vec::from_iter(guides.iter().step_by(stride).copied()))) > NESTED
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

/// The boxes scaled into [-1, 1]^3 and grown by a little noise.
///
/// Scaled and clamped, because the areas of huge or infinite boxes overflow and obvhs unwraps comparisons of them.
/// Noise, because PLOC merges pairs that prefer each other, and among equal boxes or equally spaced ones (a
/// million copies, a row of posts) ties make everyone prefer the right neighbour: one merge per pass, n passes.
fn guide_boxes(boxes: &[Aabb]) -> Vec<obvhs::aabb::Aabb> {
    let (centre, scale) = frame(boxes);
    let map = |p: Vec3| ((p.as_dvec3() - centre) * scale).clamp(DVec3::NEG_ONE, DVec3::ONE).as_vec3();
    let guide = |(i, b): (usize, &Aabb)| {
        let (min, max) = if b.is_empty() { (Vec3::ZERO, Vec3::ZERO) } else { (map(b.min), map(b.max)) };
        // Small against the box; for points at least a few roundings of numbers near 1.
        let size = (max - min).max_element() * 2.0_f32.powi(-12) + 4.0 * f32::EPSILON;
        let [low, high] = noise(i as u64);
        obvhs::aabb::Aabb::new((min - low * size).into(), (max + high * size).into())
    };
    boxes.iter().enumerate().map(guide).collect()
}

/// Centre and inverse half size of the finite part of all boxes.
fn frame(boxes: &[Aabb]) -> (DVec3, f64) {
    let finite = boxes.iter().flat_map(|b| [b.min, b.max]).filter(|p| p.is_finite());
    let all = Aabb::from_points(finite);
    if all.is_empty() {
        return (DVec3::ZERO, 1.0);
    }
    let (min, max) = (all.min.as_dvec3(), all.max.as_dvec3());
    let half = (max - min).max_element() * 0.5;
    ((min + max) * 0.5, if half > 0.0 { 1.0 / half } else { 1.0 })
}

/// Six numbers in [0, 1), ten bits each, from SplitMix64's finalizer (Steele et al. 2014).
fn noise(i: u64) -> [Vec3; 2] {
    let mut z = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    let u = |k: u32| ((z >> (10 * k)) & 1023) as f32 / 1024.0;
    [Vec3::new(u(0), u(1), u(2)), Vec3::new(u(3), u(4), u(5))]
}
