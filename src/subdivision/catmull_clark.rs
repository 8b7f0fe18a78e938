//! Catmull and Clark 1978: the smooth rules; [`super::creases`] has the others.

use super::creases::Rules;
use super::limit::Sector;
use super::{Value, topology::Topology};
use glam::Vec3;
use std::f32::consts::PI;

/// Weight of the centre of a triangle in an edge point under `triangleSubdivisionRule` "smooth" (OpenSubdiv).
const SMOOTH_TRIANGLE: f32 = 0.470;

/// Values one level down, in the order of [`Topology::split_into_quads`].
pub(super) fn refine<T: Value>(t: &Topology, rules: &Rules, values: &[T], smooth_triangles: bool) -> Vec<T> {
    let (v, e) = (t.vertices, t.edges.len());
    let mut out = vec![T::default(); v + e + t.faces()];
    for face in 0..t.faces() {
        let corners = t.corners(face);
        let sum = t.corner_vertex[corners.clone()].iter().fold(T::default(), |sum, &i| sum + values[i as usize]);
        let centre = sum * (1.0 / corners.len() as f32);
        out[v + e + face] = centre;
        for corner in corners {
            out[t.corner_vertex[corner] as usize] += centre;
            out[v + t.corner_edge[corner] as usize] += centre;
        }
    }
    let triangles = smooth_triangles.then(|| triangles_at_edges(t));
    for (edge, [a, b]) in t.edges.iter().map(|edge| edge.map(|i| i as usize)).enumerate() {
        out[a] += values[b];
        out[b] += values[a];
        let ends = values[a] + values[b];
        let inside = 0.25 + 0.5 * (SMOOTH_TRIANGLE - 0.25) * triangles.as_ref().map_or(0, |n| n[edge]) as f32;
        let smooth = ends * (0.5 - inside) + out[v + edge] * inside;
        out[v + edge] = blend(smooth, ends * 0.5, t.edge_sharpness[edge]);
    }
    for (i, &n) in rules.valences.iter().enumerate() {
        let n = n.max(1) as f32;
        out[i] = values[i] * ((n - 2.0) / n) + out[i] * (1.0 / (n * n));
    }
    rules.refine(values, &mut out[..v]);
    out
}

/// A semi-sharp edge point lies between the smooth one and the middle of the edge.
pub(super) fn blend<T: Value>(smooth: T, middle: T, sharpness: f32) -> T {
    match sharpness {
        s if s <= 0.0 => smooth,
        s if s >= 1.0 => middle,
        s => smooth * (1.0 - s) + middle * s,
    }
}

fn triangles_at_edges(t: &Topology) -> Vec<u32> {
    let mut count = vec![0; t.edges.len()];
    for corners in (0..t.faces()).map(|face| t.corners(face)).filter(|corners| corners.len() == 3) {
        t.corner_edge[corners].iter().for_each(|edge| count[*edge as usize] += 1);
    }
    count
}

/// Values at the limit of a level of quads: (n^2 V + 4 sum E + sum F) / (n (n + 5)), Halstead et al. 1993.
pub(super) fn limit<T: Value>(t: &Topology, rules: &Rules, values: &[T]) -> Vec<T> {
    let mut out = vec![T::default(); t.vertices];
    for face in 0..t.faces() {
        let quad = &t.corner_vertex[t.corners(face)];
        (0..4).for_each(|i| out[quad[i] as usize] += values[quad[(i + 2) % 4] as usize]);
    }
    for [a, b] in t.edges.iter().map(|edge| edge.map(|i| i as usize)) {
        out[a] += values[b] * 4.0;
        out[b] += values[a] * 4.0;
    }
    for (i, &n) in rules.valences.iter().enumerate() {
        let n = n.max(1) as f32;
        // Two quads around a vertex share both edges: OpenSubdiv keeps it in place.
        out[i] = if n <= 2.0 { values[i] } else { (values[i] * (n * n) + out[i]) * (1.0 / (n * (n + 5.0))) };
    }
    rules.limit(values, &mut out);
    out
}

/// Limit tangents at a smooth vertex, up to a factor (Halstead et al. 1993); their cross product is the normal.
pub(super) fn smooth_tangents(sector: &Sector) -> [Vec3; 2] {
    let n = sector.faces.len();
    let theta = 2.0 * PI / n as f32;
    let cos = theta.cos();
    // Subdominant eigenvalue of the subdivision matrix.
    let lambda = (5.0 + cos + (0.5 * theta).cos() * (2.0 * (9.0 + cos)).sqrt()) / 16.0;
    let across = 1.0 / (4.0 * lambda - 1.0);
    let along = |phase: usize| {
        let wave = |i: usize| ((i + n - phase) as f32 * theta).cos();
        let terms =
            (0..n).map(|i| sector.edges[i] * 4.0 * wave(i) + sector.faces[i] * across * (wave(i) + wave(i + 1)));
        terms.sum::<Vec3>()
    };
    // The second is the first, turned by one edge.
    [along(0), along(1)]
}

/// The same at a crease, of the surface between its two edges: along the first of them, and inwards. The second is the
/// left eigenvector of the subdivision matrix whose entries at interior edges are sin(i pi / k). For up to two faces
/// that is OpenSubdiv's mask; for more, OpenSubdiv has that of Biermann, Levin and Zorin 2000, whose subdivision rules
/// are others. With more than four faces, the rules leave no tangent plane there (which those others mend).
pub(super) fn crease_tangents(sector: &Sector) -> [Vec3; 2] {
    let k = sector.faces.len();
    let (first, last) = (sector.edges[0], sector.edges[k]);
    if k == 1 {
        return [first - last, first + last - sector.vertex * 2.0];
    }
    let theta = PI / k as f32;
    let (sin, c) = (theta.sin(), 1.0 + theta.cos());
    // 4 lambda - 1 for the eigenvalue lambda: the root of 2 x^2 - c x - c.
    let x = 0.25 * (c + (c * c + 8.0 * c).sqrt());
    // Half of lambda less the eigenvalue along the crease, 1/2.
    let half = 0.125 * (x - 1.0);
    // Sum of the entries at interior edges and faces: with those of the vertex and the crease they are zero in all.
    let sum = (1.0 + 0.5 / x) / (0.5 * theta).tan();
    let vertex = -(half * sum + sin * (1.0 + 1.0 / x) / 16.0) / (0.125 + half);
    let wave = |i: usize| if i == 0 || i == k { 0.0 } else { (i as f32 * theta).sin() };
    let interior = |i| sector.edges[i] * wave(i) + sector.faces[i] * ((wave(i) + wave(i + 1)) / (4.0 * x));
    let interior: Vec3 = (0..k).map(interior).sum();
    [first - last, interior + sector.vertex * vertex - (first + last) * (0.5 * (vertex + sum))]
}
