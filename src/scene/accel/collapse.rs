//! From a binary tree to one of eight-wide nodes with conservative boxes.

use super::aabb::Aabb;
use super::lanes::Isa;
use super::node::{LEAF, Node};
use super::pages;
use super::traverse::Tree;
use obvhs::bvh2::{Bvh2, node::Bvh2Node};
use rayon::prelude::*;

/// Gives each node the up to eight largest subtrees below it (Wald et al. 2008: open the child of largest area
/// until eight are found). `leaf` stores a leaf's primitives and returns its index. No recursion: degenerate
/// trees are deep. `bounds` are the [`node_bounds`], which large trees free before they store their leaves.
pub(super) fn collapse<'a>(binary: &'a Bvh2, bounds: Vec<Aabb>, mut leaf: impl FnMut(&'a [u32]) -> u32) -> Tree {
    let mut nodes = pages::with_capacity(binary.nodes.len() / 8 + 1); // most often enough
    nodes.push(Node::EMPTY);
    // Subtrees whose node is still to be made, with the node and slot to hang it on.
    let mut open = Vec::new();
    fill(binary, &bounds, 0, &mut nodes, &mut open, &mut leaf);
    while let Some((subtree, parent, slot)) = open.pop() {
        let index = nodes.len();
        nodes.push(Node::EMPTY);
        nodes[parent].child[slot] = index as u32;
        fill(binary, &bounds, subtree, &mut nodes, &mut open, &mut leaf);
    }
    nodes.shrink_to_fit();
    let stack = stack_need(&nodes);
    Tree { stack, bounds: bounds.first().copied().unwrap_or(Aabb::EMPTY), nodes, isa: Isa::detect() }
}

/// Fills the last of `nodes` with the children that `subtree` gives it.
fn fill<'a>(
    binary: &'a Bvh2,
    bounds: &[Aabb],
    subtree: usize,
    nodes: &mut [Node],
    open: &mut Vec<(usize, usize, usize)>,
    leaf: &mut impl FnMut(&'a [u32]) -> u32,
) {
    let index = nodes.len() - 1;
    let (found, count) = children(binary, bounds, subtree);
    for (slot, &child) in found[..count].iter().enumerate() {
        let node = &binary.nodes[child];
        let reference = if node.is_leaf() {
            let first = node.first_index as usize;
            LEAF | leaf(&binary.primitive_indices[first..first + node.prim_count as usize])
        } else {
            open.push((child, index, slot));
            0 // Set when the child is made.
        };
        nodes[index].set(slot, &bounds[child], reference);
    }
}

/// Up to eight disjoint subtrees that cover `subtree`, and how many they are.
fn children(binary: &Bvh2, bounds: &[Aabb], subtree: usize) -> ([usize; 8], usize) {
    let (mut found, mut areas) = ([subtree; 8], [0.0; 8]);
    // Of leaves, which stay closed, below any other.
    let area = |i: usize| if binary.nodes[i].is_leaf() { -1.0 } else { bounds[i].half_area() };
    let mut count = usize::from(subtree < binary.nodes.len());
    areas[..count].fill_with(|| area(subtree));
    while (1..8).contains(&count) {
        let largest = (1..count).fold(0, |best, i| if areas[i] >= areas[best] { i } else { best });
        if binary.nodes[found[largest]].is_leaf() {
            break;
        }
        let first = binary.nodes[found[largest]].first_index as usize;
        (found[largest], areas[largest]) = (first, area(first));
        (found[count], areas[count]) = (first + 1, area(first + 1));
        count += 1;
    }
    (found, count)
}

/// Boxes of all binary nodes from those of the primitives.
pub(super) fn node_bounds(binary: &Bvh2, boxes: &[Aabb]) -> Vec<Aabb> {
    let of_leaf = |node: &Bvh2Node| {
        let first = node.first_index as usize;
        let range = if node.is_leaf() { first..first + node.prim_count as usize } else { 0..0 };
        binary.primitive_indices[range].iter().fold(Aabb::EMPTY, |b, &p| b.union(&boxes[p as usize]))
    };
    let mut bounds: Vec<Aabb> = binary.nodes.par_iter().with_min_len(1 << 12).map(of_leaf).collect();
    for i in parents_first(binary).into_iter().rev().filter(|&i| !binary.nodes[i].is_leaf()) {
        let first = binary.nodes[i].first_index as usize;
        bounds[i] = bounds[first].union(&bounds[first + 1]);
    }
    bounds
}

fn parents_first(binary: &Bvh2) -> Vec<usize> {
    let mut order = Vec::with_capacity(binary.nodes.len());
    let mut open = Vec::from_iter((!binary.nodes.is_empty()).then_some(0));
    while let Some(i) = open.pop() {
        order.push(i);
        let node = &binary.nodes[i];
        if !node.is_leaf() {
            open.extend([node.first_index as usize, node.first_index as usize + 1]);
        }
    }
    order
}

/// The most stack entries any walk can hold. A node with k children pushes k, and while it is below the child it
/// pops, the other k - 1 wait: need = max(k, k - 1 + the children's largest need). Children follow parents in `nodes`.
fn stack_need(nodes: &[Node]) -> usize {
    let mut need = vec![0; nodes.len()];
    for i in (0..nodes.len()).rev() {
        let below = nodes[i].child.iter().filter(|&&c| c & LEAF == 0).map(|&c| need[c as usize]).max();
        let count = nodes[i].count();
        need[i] = count.max(below.map_or(0, |below: usize| count - 1 + below));
    }
    need.first().map_or(1, |&need| need.max(1))
}
