//! From faces to triangles.

use crate::flat::{self, Orientation};

/// Triangles of a mesh with what they came from.
pub(super) struct Triangulation {
    pub triangles: Vec<[u32; 3]>,
    /// Face-vertex index of each corner.
    pub corners: Vec<[u32; 3]>,
    pub faces: Vec<u32>,
}

/// Fans, as Hydra's HdMeshUtil; holes left out, left-handed faces turned so that winding is outward.
pub(super) fn triangulate(mesh: &flat::Mesh) -> Triangulation {
    let holes: std::collections::BTreeSet<i32> = mesh.hole_indices.iter().copied().collect();
    let left_handed = mesh.orientation == Orientation::LeftHanded;
    let n = mesh.face_vertex_indices.len().saturating_sub(2 * mesh.face_vertex_counts.len());
    let mut soup = Triangulation {
        triangles: Vec::with_capacity(n),
        corners: Vec::with_capacity(n),
        faces: Vec::with_capacity(n),
    };
    let mut first = 0_u32;
    for (face, &count) in mesh.face_vertex_counts.iter().enumerate() {
        let count = count as u32;
        if holes.is_empty() || !holes.contains(&(face as i32)) {
            for k in 1..count.saturating_sub(1) {
                let (b, c) = if left_handed { (k + 1, k) } else { (k, k + 1) };
                let corners = [first, first + b, first + c];
                soup.triangles.push(corners.map(|i| mesh.face_vertex_indices[i as usize] as u32));
                soup.corners.push(corners);
                soup.faces.push(face as u32);
            }
        }
        first += count;
    }
    soup
}

/// Slot per triangle; the last subset that claims a face wins (families are non-overlapping).
pub(super) fn slots(mesh: &flat::Mesh, faces: &[u32]) -> Option<Vec<u16>> {
    if mesh.geom_subsets.is_empty() {
        return None;
    }
    let mut by_face = vec![0_u16; mesh.face_vertex_counts.len()];
    for (i, subset) in mesh.geom_subsets.iter().enumerate() {
        for &face in subset.indices.iter() {
            by_face[face as usize] = i as u16 + 1;
        }
    }
    Some(faces.iter().map(|&f| by_face[f as usize]).collect())
}
