//! From a mesh and its subdivision tags to the first level: creases, corners, holes, boundaries.

use super::Scheme;
use super::creases::INFINITE;
use super::topology::{HalfEdges, NONE, Topology};
use crate::flat::{Mesh, SubdivTags};
use std::collections::BTreeSet;

pub(super) struct Cage {
    pub topology: Topology,
    /// Face-vertex index of each corner, as authored.
    pub corner_source: Vec<u32>,
    /// Face of each face, as authored.
    pub face_source: Vec<u32>,
    /// Faces (of `topology`) that are not rendered.
    pub holes: BTreeSet<u32>,
    /// What could not be used, in words that begin with the attribute.
    pub faults: Vec<String>,
}

impl Cage {
    pub fn build(mesh: &Mesh, scheme: Scheme) -> Self {
        let mut cage = Self::faces(mesh);
        let t = &mut cage.topology;
        sharpen_edges(t, &mesh.subdiv_tags, &mut cage.faults);
        sharpen_vertices(t, &mesh.subdiv_tags, &mut cage.faults);
        let (halves, bad) = t.half_edges();
        if !bad.is_empty() {
            cage.faults.push(format!(
                "faceVertexIndices: {} edges have more than two faces, or two of opposite winding; they stay sharp",
                bad.len()
            ));
        }
        let boundary = mesh.subdiv_tags.interpolate_boundary.as_str();
        let broken = broken_vertices(t, &halves, &bad);
        if boundary == "none" && scheme != Scheme::Bilinear {
            cage.holes.extend(boundary_faces(t));
            if cage.holes.len() == t.faces() {
                let message =
                    "interpolateBoundary: none leaves no face that is not at the boundary; nothing is rendered";
                cage.faults.push(message.into());
            }
        }
        t.sharpen_boundary(&bad);
        sharpen_corners(t, &broken, &bad, boundary == "edgeAndCorner");
        cage
    }

    /// Faces without repeated vertices; what is left of fewer than three is dropped.
    fn faces(mesh: &Mesh) -> Self {
        let hidden: BTreeSet<i32> = mesh.hole_indices.iter().copied().collect();
        let indices = &mesh.face_vertex_indices;
        let (mut starts, mut vertices, mut corner_source) = (vec![0], Vec::new(), Vec::new());
        let (mut face_source, mut holes, mut end) = (Vec::new(), BTreeSet::new(), 0);
        for (face, &count) in mesh.face_vertex_counts.iter().enumerate() {
            let start = end;
            end += count as usize;
            let before = |i: usize| indices[if i == start { end - 1 } else { i - 1 }];
            let kept: Vec<usize> = (start..end).filter(|&i| indices[i] != before(i)).collect();
            if kept.len() < 3 {
                continue;
            }
            if hidden.contains(&(face as i32)) {
                holes.insert(face_source.len() as u32);
            }
            vertices.extend(kept.iter().map(|&i| indices[i] as u32));
            corner_source.extend(kept.iter().map(|&i| i as u32));
            starts.push(vertices.len() as u32);
            face_source.push(face as u32);
        }
        let topology = Topology::new(mesh.points.len(), starts, vertices);
        Self { topology, corner_source, face_source, holes, faults: Vec::new() }
    }
}

/// `creaseSharpnesses` has a value per crease, or per edge of all creases (UsdGeomMesh).
fn sharpen_edges(t: &mut Topology, tags: &SubdivTags, faults: &mut Vec<String>) {
    let lengths: Vec<usize> = tags.crease_lengths.iter().map(|&n| usize::try_from(n).unwrap_or(0)).collect();
    let (creases, points) = (lengths.len(), lengths.iter().fold(0_usize, |sum, n| sum.saturating_add(*n)));
    if lengths.iter().any(|n| *n < 2) || points != tags.crease_indices.len() {
        let given = tags.crease_indices.len();
        faults.push(format!(
            "creaseLengths: {points} points in {creases} creases of 2 or more do not fit the {given} creaseIndices; \
             creases are ignored"
        ));
        return;
    }
    let (given, edges) = (tags.crease_sharpnesses.len(), points - creases);
    if given != creases && given != edges {
        faults.push(format!(
            "creaseSharpnesses: {given} values, neither one for each of {creases} creases nor for each of their {edges} \
             edges; creases are ignored"
        ));
        return;
    }
    let (mut first, mut edge, mut missed) = (0, 0, 0);
    for (crease, length) in lengths.iter().enumerate() {
        for pair in tags.crease_indices[first..first + length].windows(2) {
            let sharpness = tags.crease_sharpnesses[if given == creases { crease } else { edge }];
            missed += usize::from(!sharpen_edge(t, pair, sharpness));
            edge += 1;
        }
        first += length;
    }
    if missed > 0 {
        faults.push(format!(
            "creaseIndices: {missed} of {edges} edges are none of the mesh, or their sharpness is no number; they are \
             ignored"
        ));
    }
}

/// Whether there is such an edge, and the sharpness can be used.
fn sharpen_edge(t: &mut Topology, pair: &[i32], sharpness: f32) -> bool {
    let (Ok(a), Ok(b)) = (u32::try_from(pair[0]), u32::try_from(pair[1])) else { return false };
    // Edges are in the order of their vertices at this level.
    let Ok(edge) = t.edges.binary_search(&[a.min(b), a.max(b)]) else { return false };
    if !sharpness.is_nan() {
        t.edge_sharpness[edge] = sharpness.max(0.0);
    }
    !sharpness.is_nan()
}

fn sharpen_vertices(t: &mut Topology, tags: &SubdivTags, faults: &mut Vec<String>) {
    let (indices, values) = (&*tags.corner_indices, &*tags.corner_sharpnesses);
    if indices.len() != values.len() {
        faults.push(format!(
            "cornerSharpnesses: {} values for {} cornerIndices; corners are ignored",
            values.len(),
            indices.len()
        ));
        return;
    }
    let mut missed = 0;
    for (&vertex, &sharpness) in indices.iter().zip(values) {
        match usize::try_from(vertex).ok().and_then(|v| t.vertex_sharpness.get_mut(v)) {
            Some(slot) if !sharpness.is_nan() => *slot = sharpness.max(0.0),
            _ => missed += 1,
        }
    }
    if missed > 0 {
        faults.push(format!(
            "cornerIndices: {missed} of {} are none of the points, or their sharpness is no number; they are ignored",
            indices.len()
        ));
    }
}

/// Vertices whose faces do not form one fan, or that a bad edge touches.
fn broken_vertices(t: &Topology, halves: &HalfEdges, bad: &[u32]) -> Vec<bool> {
    let mut broken = vec![false; t.vertices];
    bad.iter().flat_map(|edge| t.edges[*edge as usize]).for_each(|v| broken[v as usize] = true);
    let (mut count, mut some) = (vec![0_u32; t.vertices], vec![NONE; t.vertices]);
    for (corner, &v) in t.corner_vertex.iter().enumerate() {
        count[v as usize] += 1;
        some[v as usize] = corner as u32;
    }
    for v in 0..t.vertices {
        if count[v] > 1 && !broken[v] {
            broken[v] = fan(t, halves, some[v] as usize, count[v]) != count[v];
        }
    }
    broken
}

/// Corners that turning about the vertex of `start` reaches, at most `all`.
fn fan(t: &Topology, halves: &HalfEdges, start: usize, all: u32) -> u32 {
    let mut reached = 1;
    let mut at = start;
    while let Some(left) = t.turn_left(at, halves).filter(|corner| *corner != start && reached < all) {
        (at, reached) = (left, reached + 1);
    }
    if t.turn_left(at, halves) == Some(start) {
        return reached;
    }
    at = start;
    while let Some(right) = t.turn_right(at, halves).filter(|_| reached < all) {
        (at, reached) = (right, reached + 1);
    }
    reached
}

/// Faces at a vertex with a boundary edge that no crease holds: under `interpolateBoundary` "none" the surface ends
/// before them.
fn boundary_faces(t: &Topology) -> Vec<u32> {
    let faces = t.edge_faces();
    let mut loose = vec![false; t.vertices];
    for (edge, ends) in t.edges.iter().enumerate() {
        if faces[edge] == 1 && t.edge_sharpness[edge] < INFINITE {
            ends.iter().for_each(|v| loose[*v as usize] = true);
        }
    }
    let touches = |face: &usize| t.corner_vertex[t.corners(*face)].iter().any(|v| loose[*v as usize]);
    (0..t.faces()).filter(touches).map(|face| face as u32).collect()
}

/// Vertices that stay where they are: of a single face where the rule says so, and broken ones, except where two
/// edges of many faces pass through one.
fn sharpen_corners(t: &mut Topology, broken: &[bool], bad: &[u32], corners: bool) {
    let (valences, mut faces) = (t.valences(), vec![0; t.vertices]);
    t.corner_vertex.iter().for_each(|v| faces[*v as usize] += 1);
    let (mut bad_edges, mut open) = (vec![0; t.vertices], vec![false; t.vertices]);
    bad.iter().flat_map(|edge| t.edges[*edge as usize]).for_each(|v| bad_edges[v as usize] += 1);
    for (ends, count) in t.edges.iter().zip(t.edge_faces()) {
        ends.iter().for_each(|v| open[*v as usize] |= count == 1);
    }
    for v in 0..t.vertices {
        let passes = bad_edges[v] == 2 && !open[v] && faces[v] > valences[v];
        if (corners && faces[v] == 1 && valences[v] == 2) || (broken[v] && !passes) {
            t.vertex_sharpness[v] = INFINITE;
        }
    }
}
