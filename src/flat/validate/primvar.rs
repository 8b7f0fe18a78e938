//! Primvars of a mesh: as many values as their interpolation asks for, all of them finite.

use super::report::{LARGEST, Report, UNIT, is_sane};
use crate::flat::{AnyPrimvar, Interpolation, Mesh, Primvar, array::Element};
use bytemuck::Pod;

/// How many elements the interpolations ask for, by the topology as authored.
pub(super) struct Sizes {
    points: usize,
    faces: usize,
    /// Length of `faceVertexIndices`.
    indices: usize,
    /// Sum of `faceVertexCounts`; not `indices` in a broken mesh, whose primvars may follow either.
    corners: usize,
}

impl Sizes {
    pub(super) fn of(mesh: &Mesh) -> Self {
        let counts = mesh.face_vertex_counts.iter().map(|&count| usize::try_from(count).unwrap_or(0));
        Self {
            points: mesh.points.len(),
            faces: mesh.face_vertex_counts.len(),
            indices: mesh.face_vertex_indices.len(),
            corners: counts.fold(0, usize::saturating_add),
        }
    }

    fn fit(&self, interpolation: Interpolation, length: usize) -> bool {
        match interpolation {
            Interpolation::Constant => length == 1,
            Interpolation::Uniform => length == self.faces,
            Interpolation::Varying | Interpolation::Vertex => length == self.points,
            Interpolation::FaceVarying => length == self.indices || length == self.corners,
        }
    }

    fn wanted(&self, interpolation: Interpolation) -> String {
        match interpolation {
            Interpolation::Constant => "constant interpolation, which has 1".into(),
            Interpolation::Uniform => format!("uniform interpolation, which has {}", self.faces),
            Interpolation::Varying => format!("varying interpolation, which has {}", self.points),
            Interpolation::Vertex => format!("vertex interpolation, which has {}", self.points),
            Interpolation::FaceVarying => format!("faceVarying interpolation, which has {}", self.indices),
        }
    }
}

/// Drops the primvars that do not fit the mesh; colours and opacities are brought into 0..1.
pub(super) fn check_primvars(mesh: &mut Mesh, sizes: &Sizes, report: &mut Report) {
    check(&mut mesh.normals, "normals", sizes, report);
    check(&mut mesh.display_color, "primvars:displayColor", sizes, report);
    check(&mut mesh.display_opacity, "primvars:displayOpacity", sizes, report);
    mesh.primvars.retain(|name, primvar| {
        let fault = match primvar {
            AnyPrimvar::Float(primvar) => fault(primvar, sizes),
            AnyPrimvar::Float2(primvar) => fault(primvar, sizes),
            AnyPrimvar::Float3(primvar) => fault(primvar, sizes),
            AnyPrimvar::Float4(primvar) => fault(primvar, sizes),
        };
        if let Some(fault) = &fault {
            report.warn(format!("primvars:{name} dropped: {fault}"));
        }
        fault.is_none()
    });
    clamp_to_unit(&mut mesh.display_color, "primvars:displayColor", report);
    clamp_to_unit(&mut mesh.display_opacity, "primvars:displayOpacity", report);
}

fn check<T: Element>(primvar: &mut Option<Primvar<T>>, name: &str, sizes: &Sizes, report: &mut Report) {
    let fault = primvar.as_ref().and_then(|primvar| fault(primvar, sizes));
    if let Some(fault) = fault {
        report.warn(format!("{name} dropped: {fault}"));
        *primvar = None;
    }
}

fn fault<T: Element>(primvar: &Primvar<T>, sizes: &Sizes) -> Option<String> {
    let values = primvar.values.len();
    let length = primvar.indices.as_ref().map_or(values, |indices| indices.len());
    if !sizes.fit(primvar.interpolation, length) {
        return Some(format!("{length} elements do not fit {}", sizes.wanted(primvar.interpolation)));
    }
    let in_range = |index: &i32| usize::try_from(*index).is_ok_and(|index| index < values);
    if primvar.indices.as_ref().is_some_and(|indices| !indices.iter().all(in_range)) {
        return Some(format!("its indices are outside its {values} values; author indices from 0"));
    }
    let bad = floats(&primvar.values).iter().filter(|value| !is_sane(&[**value])).count();
    (bad > 0).then(|| format!("{bad} numbers are not finite or beyond {LARGEST:e}; author finite values"))
}

fn clamp_to_unit<T: Element>(primvar: &mut Option<Primvar<T>>, name: &str, report: &mut Report) {
    let Some(primvar) = primvar else { return };
    let outside = floats(&primvar.values).iter().filter(|value| !UNIT.contains(value)).count();
    if outside > 0 {
        let mut values = primvar.values.to_vec();
        bytemuck::cast_slice_mut::<T, f32>(&mut values).iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
        primvar.values = values.into();
        report.warn(format!("{name}: {outside} numbers clamped; author 0 to 1"));
    }
}

/// Every primvar is one of floats.
pub(super) fn floats<T: Pod>(values: &[T]) -> &[f32] {
    bytemuck::cast_slice(values)
}
