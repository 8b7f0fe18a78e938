//! Face-varying values as a topology of their own: a vertex per value at a mesh vertex, edges that part where the
//! values do. Seams are then boundaries, and `faceVaryingLinearInterpolation` says which of its corners stay put.

use super::cage::Cage;
use super::creases::INFINITE;
use super::topology::Topology;
use crate::flat::{Primvar, array::Element};
use std::collections::HashMap;

/// `UsdGeomMesh.faceVaryingLinearInterpolation`: what of a face-varying boundary is sharp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Linear {
    None,
    CornersOnly,
    CornersPlus1,
    CornersPlus2,
    Boundaries,
    All,
}

impl Linear {
    pub fn named(name: &str) -> Self {
        match name {
            "none" => Linear::None,
            "cornersOnly" => Linear::CornersOnly,
            "cornersPlus2" => Linear::CornersPlus2,
            "boundaries" => Linear::Boundaries,
            "all" => Linear::All,
            _ => Linear::CornersPlus1,
        }
    }

    /// A junction, or a concave corner on one side of a seam, sharpens all that meets there.
    fn depends(self) -> bool {
        matches!(self, Linear::CornersPlus1 | Linear::CornersPlus2)
    }
}

/// The topology of a primvar and its values, one per vertex of that. With indices, values are one where their indices
/// are; without, where they are equal.
pub(super) fn channel<T: Element>(cage: &Cage, primvar: &Primvar<T>, linear: Linear) -> (Topology, Vec<T>) {
    let index = value_indices(cage, primvar);
    let t = &cage.topology;
    let mut keys: Vec<(u32, u32, u32)> = (t.corner_vertex.iter().zip(&index).enumerate())
        .map(|(corner, (&vertex, &value))| (vertex, value, corner as u32))
        .collect();
    keys.sort_unstable();
    let (mut owners, mut values) = (Vec::new(), Vec::new());
    let mut corner_value = vec![0; keys.len()];
    let mut last = None;
    for (vertex, value, corner) in keys {
        if last != Some((vertex, value)) {
            last = Some((vertex, value));
            owners.push(vertex);
            values.push(primvar.values[value as usize]);
        }
        corner_value[corner as usize] = owners.len() as u32 - 1;
    }
    let mut channel = Topology::new(owners.len(), t.starts_of_faces(), corner_value);
    sharpen(&mut channel, t, &owners, linear);
    (channel, values)
}

/// Index into the values, by corner.
fn value_indices<T: Element>(cage: &Cage, primvar: &Primvar<T>) -> Vec<u32> {
    let sources = cage.corner_source.iter().map(|corner| *corner as usize);
    if let Some(indices) = &primvar.indices {
        return sources.map(|corner| indices[corner] as u32).collect();
    }
    let mut first: HashMap<&[u8], u32> = HashMap::new();
    sources.map(|i| *first.entry(bytemuck::bytes_of(&primvar.values[i])).or_insert(i as u32)).collect()
}

/// Sharpness of the mesh where values are continuous; infinite at seams, and at the corners that `linear` names
/// (the rules of OpenSubdiv's face-varying levels; it also sharpens the other side of a seam at semi-sharp vertices
/// while they are, which is left out here).
fn sharpen(channel: &mut Topology, mesh: &Topology, owners: &[u32], linear: Linear) {
    for (&own, &edge) in channel.corner_edge.iter().zip(&mesh.corner_edge) {
        channel.edge_sharpness[own as usize] = mesh.edge_sharpness[edge as usize];
    }
    for (sharpness, &owner) in channel.vertex_sharpness.iter_mut().zip(owners) {
        *sharpness = mesh.vertex_sharpness[owner as usize];
    }
    let (_, bad) = channel.half_edges();
    channel.sharpen_boundary(&bad);
    let ends = Ends::of(channel, mesh);
    let mut first = 0;
    while first < owners.len() {
        let siblings = first..first + owners[first..].iter().take_while(|owner| **owner == owners[first]).count();
        for value in siblings.clone() {
            if ends.sharp(value, &siblings, linear) {
                channel.vertex_sharpness[value] = INFINITE;
            }
        }
        first = siblings.end;
    }
}

/// What meets at each value.
struct Ends {
    corners: Vec<u32>,
    /// Edges with one face.
    open: Vec<u32>,
    /// Those of them that are seams, not boundaries of the mesh.
    seams: Vec<u32>,
    /// Edges that never smooth out.
    hard: Vec<u32>,
}

impl Ends {
    fn of(channel: &Topology, mesh: &Topology) -> Self {
        let zeros = || vec![0; channel.vertices];
        let mut ends = Self { corners: zeros(), open: zeros(), seams: zeros(), hard: zeros() };
        channel.corner_vertex.iter().for_each(|v| ends.corners[*v as usize] += 1);
        let (own, of_mesh) = (channel.edge_faces(), mesh.edge_faces());
        let mut parts = vec![0; channel.edges.len()];
        for (&edge, &of) in channel.corner_edge.iter().zip(&mesh.corner_edge) {
            parts[edge as usize] = of_mesh[of as usize];
        }
        for (edge, vertices) in channel.edges.iter().enumerate() {
            for v in vertices.map(|v| v as usize) {
                ends.open[v] += u32::from(own[edge] == 1);
                ends.seams[v] += u32::from(own[edge] < parts[edge]);
                ends.hard[v] += u32::from(channel.edge_sharpness[edge] >= INFINITE);
            }
        }
        ends
    }

    /// Whether a value among its siblings, those at the same vertex, stays put.
    fn sharp(&self, value: usize, siblings: &std::ops::Range<usize>, linear: Linear) -> bool {
        let any = |what: &dyn Fn(usize) -> bool| siblings.clone().any(what);
        let corner = |v: usize| self.corners[v] == 1 && self.open[v] > 0;
        let mismatch = any(&|v| self.seams[v] > 0);
        let dart = siblings.len() == 1 && mismatch && self.open[value] == self.seams[value];
        match linear {
            Linear::None => false,
            Linear::All | Linear::Boundaries => self.open[value] > 0 || dart,
            _ if corner(value) => true,
            _ if linear.depends() && siblings.len() > 2 => true,
            _ if linear.depends() && siblings.len() == 2 && any(&|v| self.hard[v] > 2) => true,
            Linear::CornersPlus2 => dart || siblings.len() == 2 && any(&corner),
            Linear::CornersOnly | Linear::CornersPlus1 => false,
        }
    }
}
