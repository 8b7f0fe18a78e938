//! Meshes, instancers: topology whose every index is in range, points and placements that are finite.

use super::{
    motion::{check_keys, check_point_keys},
    primvar::{Sizes, check_primvars, floats},
    report::{LARGEST, Report, is_sane, placement_fault},
    topology::{Fault, Faults, compact},
};
use crate::{
    error::Warning,
    flat::{AnyPrimvar, Array, Instancer, Mesh, array::Element},
};

const SCHEMES: [&str; 4] = ["none", "catmullClark", "loop", "bilinear"];
const BOUNDARIES: [&str; 3] = ["none", "edgeOnly", "edgeAndCorner"];
const LINEAR: [&str; 6] = ["none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all"];

/// After it: the counts are 3 or more and add up to the indices; every index of vertices, faces and primvar
/// values is in range; every point and value is finite; no face has all of its area zero (one triangle of a
/// polygon still may); the transform can be inverted; a mesh without faces is invisible.
pub fn validate_mesh(path: &str, mesh: &mut Mesh, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    if let Some(fault) = placement_fault(&mesh.transform) {
        report.warn(format!("xformOpOrder: the transform {fault}, the mesh is not rendered; author a scale above 0"));
        // Emptied, so that it emits nothing as the shape of a light either.
        *mesh = Mesh { visible: false, ..Mesh::default() };
        return;
    }
    check_keys(&mut mesh.transform_keys, 1, "the mesh", &mut report);
    report.token("subdivisionScheme", &mut mesh.subdivision_scheme, &SCHEMES, "none");
    check_tags(mesh, &mut report);
    check_face_lists(mesh, &mut report);
    check_primvars(mesh, &Sizes::of(mesh), &mut report);
    let authored = mesh.face_vertex_counts.len();
    let points_reported = check_faces(mesh, &mut report);
    mend_points(mesh, points_reported, &mut report);
    check_point_keys(mesh, &mut report);
    if mesh.visible && mesh.face_vertex_counts.is_empty() {
        // Faces that were all dropped have been reported.
        if authored == 0 {
            report.warn("faceVertexCounts: the mesh has no faces to render; delete or deactivate the prim");
        }
        mesh.visible = false;
    }
}

/// Placements that cannot place are removed.
pub fn validate_instancer(path: &str, instancer: &mut Instancer, warnings: &mut Vec<Warning>) {
    let total = instancer.transforms.len();
    let mut report = Report::new(path, warnings);
    if !one_each(&mut instancer.display_color, "displayColor", total, &mut report) {
        instancer.display_color = Array::default();
    }
    instancer.primvars.retain(|name, primvar| match primvar {
        AnyPrimvar::Float(primvar) => one_each(&mut primvar.values, name, total, &mut report),
        AnyPrimvar::Float2(primvar) => one_each(&mut primvar.values, name, total, &mut report),
        AnyPrimvar::Float3(primvar) => one_each(&mut primvar.values, name, total, &mut report),
        AnyPrimvar::Float4(primvar) => one_each(&mut primvar.values, name, total, &mut report),
    });
    check_keys(&mut instancer.transform_keys, total, "every instance", &mut report);
    let bad = instancer.transforms.iter().filter(|matrix| placement_fault(matrix).is_some()).count();
    if bad == 0 {
        return;
    }
    let good: Vec<usize> = (0..total).filter(|i| placement_fault(&instancer.transforms[*i]).is_none()).collect();
    keep(&mut instancer.display_color, &good);
    for primvar in instancer.primvars.values_mut() {
        match primvar {
            AnyPrimvar::Float(primvar) => keep(&mut primvar.values, &good),
            AnyPrimvar::Float2(primvar) => keep(&mut primvar.values, &good),
            AnyPrimvar::Float3(primvar) => keep(&mut primvar.values, &good),
            AnyPrimvar::Float4(primvar) => keep(&mut primvar.values, &good),
        }
    }
    keep(&mut instancer.transforms, &good);
    if let Some(keys) = &mut instancer.transform_keys {
        keys.transforms.iter_mut().for_each(|transforms| keep(transforms, &good));
    }
    let why = "their transforms are singular or not finite";
    let message = format!("{bad} of {total} instances dropped: {why}; check positions, orientations and scales");
    Report::new(path, warnings).warn(message);
}

/// Whether there is a value for each instance; those that are no numbers become NaN, which means none.
fn one_each<T: Element>(values: &mut Array<T>, name: &str, total: usize, report: &mut Report) -> bool {
    if values.is_empty() {
        return false;
    }
    if values.len() != total {
        let found = values.len();
        report.warn(format!("primvars:{name} dropped: {found} values for {total} instances; author one each"));
        return false;
    }
    let none = |value: &T| floats(std::slice::from_ref(value)).iter().all(|x| x.is_nan());
    let bad = |value: &T| !none(value) && !is_sane(floats(std::slice::from_ref(value)));
    let count = values.iter().filter(|value| bad(value)).count();
    if count > 0 {
        report
            .warn(format!("primvars:{name}: {count} values are not finite, the meshes' own are used; author numbers"));
        let mut mended = values.to_vec();
        for value in mended.iter_mut().filter(|value| bad(value)) {
            bytemuck::cast_slice_mut::<T, f32>(std::slice::from_mut(value)).fill(f32::NAN);
        }
        *values = mended.into();
    }
    true
}

fn keep<T: Element>(values: &mut Array<T>, good: &[usize]) {
    if !values.is_empty() {
        *values = good.iter().map(|i| values[*i]).collect::<Vec<_>>().into();
    }
}

/// The tokens; creases and corners are checked against the edges where they are used.
fn check_tags(mesh: &mut Mesh, report: &mut Report) {
    let tags = &mut mesh.subdiv_tags;
    report.token("interpolateBoundary", &mut tags.interpolate_boundary, &BOUNDARIES, "edgeAndCorner");
    let linear = &mut tags.face_varying_linear_interpolation;
    report.token("faceVaryingLinearInterpolation", linear, &LINEAR, "cornersPlus1");
    let rule = &mut tags.triangle_subdivision_rule;
    report.token("triangleSubdivisionRule", rule, &["catmullClark", "smooth"], "catmullClark");
}

/// Hole indices and subsets name faces that are there.
fn check_face_lists(mesh: &mut Mesh, report: &mut Report) {
    let faces = mesh.face_vertex_counts.len();
    if let Some(dropped) = keep_in_range(&mut mesh.hole_indices, faces) {
        report.warn(format!("{dropped} holeIndices dropped: outside the {faces} faces; remove them"));
    }
    for subset in &mut mesh.geom_subsets {
        if let Some(dropped) = keep_in_range(&mut subset.indices, faces) {
            let message = format!("{dropped} of the subset's indices dropped: outside the {faces} faces; remove them");
            report.warn_at(&subset.path, message);
        }
    }
}

/// Returns how many were dropped, if any.
fn keep_in_range(indices: &mut Array<i32>, end: usize) -> Option<usize> {
    let fits = |index: &&i32| usize::try_from(**index).is_ok_and(|index| index < end);
    let before = indices.len();
    if indices.iter().all(|index| fits(&index)) {
        return None;
    }
    *indices = indices.iter().filter(fits).copied().collect::<Vec<_>>().into();
    Some(before - indices.len())
}

/// Drops the faces that cannot be shaded, and the indices that belong to no face. Returns whether points were among the
/// reasons.
fn check_faces(mesh: &mut Mesh, report: &mut Report) -> bool {
    let faults = Faults::find(mesh);
    let (faces, points) = (mesh.face_vertex_counts.len(), mesh.points.len());
    for fault in Fault::ALL {
        let count = faults.count(fault);
        if count > 0 {
            let why = match fault {
                Fault::TooFew => "faceVertexCounts below 3; remove them".into(),
                Fault::Missing => {
                    "the sum of faceVertexCounts exceeds the length of faceVertexIndices; export the mesh again".into()
                }
                Fault::Index => format!("faceVertexIndices outside the {points} points; export the mesh again"),
                Fault::Point => format!("points not finite or beyond {LARGEST:e}; export the mesh again"),
                Fault::Area => "points in one place or on one line, the area is zero; clean the mesh up".into(),
            };
            report.warn(format!("{count} of {faces} faces dropped: {why}"));
        }
    }
    let spare = faults.spare_indices();
    if spare > 0 {
        let why = "beyond the sum of faceVertexCounts; export the mesh again";
        report.warn(format!("{spare} faceVertexIndices dropped: {why}"));
    }
    if faults.any() {
        compact(mesh, &faults);
    }
    faults.count(Fault::Point) > 0
}

/// Points that no face uses any more must not reach a bounding box either.
fn mend_points(mesh: &mut Mesh, reported: bool, report: &mut Report) {
    let bad = mesh.points.iter().filter(|point| !is_sane(&point[..])).count();
    if bad == 0 {
        return;
    }
    let total = mesh.points.len();
    let stand_in = mesh.points.iter().find(|point| is_sane(&point[..])).copied().unwrap_or_default();
    let mended = mesh.points.iter().map(|point| if is_sane(&point[..]) { *point } else { stand_in });
    mesh.points = mended.collect::<Vec<_>>().into();
    if !reported {
        report.warn(format!("{bad} of {total} points are not finite or beyond {LARGEST:e}; export the mesh again"));
    }
}
