//! Loop 1987, for triangles: the smooth rules; [`super::creases`] has the others.

use super::catmull_clark::blend;
use super::creases::Rules;
use super::limit::Sector;
use super::{Value, topology::Topology};
use glam::Vec3;
use std::f32::consts::PI;

/// Values one level down, in the order of [`Topology::split_triangles`].
pub(super) fn refine<T: Value>(t: &Topology, rules: &Rules, values: &[T]) -> Vec<T> {
    let v = t.vertices;
    let mut out = vec![T::default(); v + t.edges.len()];
    for face in 0..t.faces() {
        let first = t.corners(face).start;
        for i in 0..3 {
            out[v + t.corner_edge[first + i] as usize] += values[t.corner_vertex[first + (i + 2) % 3] as usize];
        }
    }
    for (edge, [a, b]) in t.edges.iter().map(|edge| edge.map(|i| i as usize)).enumerate() {
        out[a] += values[b];
        out[b] += values[a];
        let ends = values[a] + values[b];
        out[v + edge] = blend(ends * 0.375 + out[v + edge] * 0.125, ends * 0.5, t.edge_sharpness[edge]);
    }
    for (i, &n) in rules.valences.iter().enumerate() {
        let beta = neighbour_weight(n.max(1));
        out[i] = values[i] * (1.0 - n as f32 * beta) + out[i] * beta;
    }
    rules.refine(values, &mut out[..v]);
    out
}

/// Weight of each of n neighbours.
fn neighbour_weight(n: u32) -> f32 {
    let n = n as f32;
    let c = 0.375 + 0.25 * (2.0 * PI / n).cos();
    (0.625 - c * c) / n
}

/// Values at the limit: neighbours weigh 1 / (n + 3 / (8 beta)).
pub(super) fn limit<T: Value>(t: &Topology, rules: &Rules, values: &[T]) -> Vec<T> {
    let mut out = vec![T::default(); t.vertices];
    for [a, b] in t.edges.iter().map(|edge| edge.map(|i| i as usize)) {
        out[a] += values[b];
        out[b] += values[a];
    }
    for (i, &n) in rules.valences.iter().enumerate() {
        let weight = 1.0 / (n as f32 + 0.375 / neighbour_weight(n.max(1)));
        out[i] = values[i] * (1.0 - n as f32 * weight) + out[i] * weight;
    }
    rules.limit(values, &mut out);
    out
}

/// Limit tangents at a smooth vertex, up to a factor; their cross product is the normal.
pub(super) fn smooth_tangents(sector: &Sector) -> [Vec3; 2] {
    let theta = 2.0 * PI / sector.faces.len() as f32;
    let wave = |f: fn(f32) -> f32| sector.edges.iter().enumerate().map(|(i, e)| *e * f(i as f32 * theta)).sum();
    [wave(f32::cos), wave(f32::sin)]
}

/// The same at a crease, of the surface between its two edges: along the first of them, and inwards. The second is the
/// left eigenvector of the subdivision matrix whose interior entries are sin(i pi / k). For up to three triangles that is
/// OpenSubdiv's mask; for more, OpenSubdiv has that of Hoppe et al. 1994, whose subdivision rules are others.
pub(super) fn crease_tangents(sector: &Sector) -> [Vec3; 2] {
    let k = sector.faces.len();
    let (first, last) = (sector.edges[0], sector.edges[k]);
    if k == 1 {
        return [first - last, first + last - sector.vertex * 2.0];
    }
    let theta = PI / k as f32;
    // Half of the eigenvalue 3/8 + cos(theta) / 4 less that along the crease, 1/2.
    let half = 0.5 * (0.25 * theta.cos() - 0.125);
    let sum = 1.0 / (0.5 * theta).tan();
    let vertex = -(half * sum + 0.125 * theta.sin()) / (0.125 + half);
    let interior: Vec3 = (1..k).map(|i| sector.edges[i] * (i as f32 * theta).sin()).sum();
    [first - last, interior + sector.vertex * vertex - (first + last) * (0.5 * (vertex + sum))]
}
