//! Faces: which cannot be used, and the mesh without them.

use super::report::is_sane;
use crate::flat::{AnyPrimvar, Array, Interpolation, Mesh, Primvar, array::Element};
use glam::Vec3;

/// Why a face is dropped: the first reason that holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Fewer than three vertices.
    TooFew,
    /// Its vertices lie beyond the end of `faceVertexIndices`.
    Missing,
    /// A vertex is not one of the points.
    Index,
    /// A point is not finite.
    Point,
    /// No area.
    Area,
}

impl Fault {
    pub(super) const ALL: [Fault; 5] = [Fault::TooFew, Fault::Missing, Fault::Index, Fault::Point, Fault::Area];
}

/// The faults of a mesh. Allocates only when there is one.
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Per face, empty while all are fine.
    dropped: Vec<bool>,
    counts: [usize; 5],
    /// Indices after the last face.
    spare: usize,
}

impl Faults {
    pub(super) fn find(mesh: &Mesh) -> Self {
        let (counts, indices) = (&*mesh.face_vertex_counts, &*mesh.face_vertex_indices);
        let points_fine = mesh.points.iter().all(|point| is_sane(&point[..]));
        let mut faults = Faults::default();
        let mut start = 0;
        for (face, &count) in counts.iter().enumerate() {
            let end = end_of_face(start, count);
            let fault = match indices.get(start..end) {
                None => Some(Fault::Missing),
                Some(vertices) => fault_of_face(&mesh.points, points_fine, vertices),
            };
            if let Some(fault) = fault {
                faults.record(fault, face, counts.len());
            }
            start = end;
        }
        faults.spare = indices.len().saturating_sub(start);
        faults
    }

    fn record(&mut self, fault: Fault, face: usize, faces: usize) {
        self.dropped.resize(faces, false);
        self.dropped[face] = true;
        self.counts[fault as usize] += 1;
    }

    pub(super) fn count(&self, fault: Fault) -> usize {
        self.counts[fault as usize]
    }

    pub(super) fn spare_indices(&self) -> usize {
        self.spare
    }

    pub(super) fn any(&self) -> bool {
        self.spare > 0 || !self.dropped.is_empty()
    }

    fn keeps(&self, face: usize) -> bool {
        !self.dropped.get(face).copied().unwrap_or(false)
    }
}

/// A negative count has no vertices. Saturating, because the counts of a broken file may add up to anything.
fn end_of_face(start: usize, count: i32) -> usize {
    start.saturating_add(usize::try_from(count).unwrap_or(0))
}

fn fault_of_face(points: &[[f32; 3]], points_fine: bool, vertices: &[i32]) -> Option<Fault> {
    let point = |&vertex: &i32| usize::try_from(vertex).ok().and_then(|vertex| points.get(vertex));
    if vertices.len() < 3 {
        return Some(Fault::TooFew);
    }
    if !vertices.iter().all(|vertex| point(vertex).is_some()) {
        return Some(Fault::Index);
    }
    if !points_fine && !vertices.iter().filter_map(point).all(|point| is_sane(&point[..])) {
        return Some(Fault::Point);
    }
    let mut corners = vertices.iter().filter_map(point).map(|&point| Vec3::from(point).as_dvec3());
    let (first, mut last) = (corners.next()?, corners.next()?);
    // Area of the fan, not of its sum, which is zero for a bow tie as well. The products are f64 because
    // those of f32 overflow; an edge across 1e-12 of the squared length is the rounding of such a product.
    let flat = corners.all(|corner| {
        let (a, b) = (last - first, corner - first);
        last = corner;
        a.cross(b).length() <= 1e-12 * a.length_squared().max(b.length_squared())
    });
    flat.then_some(Fault::Area)
}

/// The mesh without its faulty faces and spare indices: topology, primvars, holes and subsets alike.
pub(super) fn compact(mesh: &mut Mesh, faults: &Faults) {
    let faces: Vec<bool> = (0..mesh.face_vertex_counts.len()).map(|face| faults.keeps(face)).collect();
    let corners = corner_mask(mesh, &faces);
    mesh.face_vertex_counts = masked(&mesh.face_vertex_counts, &faces);
    mesh.face_vertex_indices = masked(&mesh.face_vertex_indices, &corners);
    compact_primvar(&mut mesh.normals, &faces, &corners);
    for primvar in mesh.primvars.values_mut() {
        match primvar {
            AnyPrimvar::Float(primvar) => compact_values(primvar, &faces, &corners),
            AnyPrimvar::Float2(primvar) => compact_values(primvar, &faces, &corners),
            AnyPrimvar::Float3(primvar) => compact_values(primvar, &faces, &corners),
            AnyPrimvar::Float4(primvar) => compact_values(primvar, &faces, &corners),
        }
    }
    compact_primvar(&mut mesh.display_color, &faces, &corners);
    compact_primvar(&mut mesh.display_opacity, &faces, &corners);
    let renumbered = renumbering(&faces);
    mesh.hole_indices = renumber(&mesh.hole_indices, &renumbered);
    for subset in &mut mesh.geom_subsets {
        subset.indices = renumber(&subset.indices, &renumbered);
    }
}

/// Per corner, whether its face stays; ends where `faceVertexIndices` or the faces end.
fn corner_mask(mesh: &Mesh, faces: &[bool]) -> Vec<bool> {
    let mut corners = Vec::with_capacity(mesh.face_vertex_indices.len());
    for (&count, &keep) in mesh.face_vertex_counts.iter().zip(faces) {
        let end = end_of_face(corners.len(), count).min(mesh.face_vertex_indices.len());
        corners.resize(end, keep);
    }
    corners
}

fn masked<T: Element>(values: &Array<T>, mask: &[bool]) -> Array<T> {
    values.iter().zip(mask).filter_map(|(value, keep)| keep.then_some(*value)).collect::<Vec<_>>().into()
}

fn compact_primvar<T: Element>(primvar: &mut Option<Primvar<T>>, faces: &[bool], corners: &[bool]) {
    if let Some(primvar) = primvar {
        compact_values(primvar, faces, corners);
    }
}

fn compact_values<T: Element>(primvar: &mut Primvar<T>, faces: &[bool], corners: &[bool]) {
    let mask = match primvar.interpolation {
        Interpolation::Uniform => faces,
        Interpolation::FaceVarying => corners,
        Interpolation::Constant | Interpolation::Varying | Interpolation::Vertex => return,
    };
    match &mut primvar.indices {
        Some(indices) => *indices = masked(indices, mask),
        None => primvar.values = masked(&primvar.values, mask),
    }
}

/// The new number of each face, -1 for those that go.
fn renumbering(faces: &[bool]) -> Vec<i32> {
    let mut next = 0;
    let mut number = |keep: &bool| {
        next += i32::from(*keep);
        if *keep { next - 1 } else { -1 }
    };
    faces.iter().map(&mut number).collect()
}

/// `faces` are in range: checked before.
fn renumber(faces: &Array<i32>, renumbered: &[i32]) -> Array<i32> {
    let number = |face: &i32| renumbered.get(*face as usize).copied().filter(|face| *face >= 0);
    faces.iter().filter_map(number).collect::<Vec<_>>().into()
}
