//! Keys of motion: times in order, as many values as there are times, each as sound as the value at the frame. What is
//! not makes the prim stand still.

use super::report::{Report, is_sane, placement_fault};
use crate::flat::{Mesh, TransformKeys};

/// After it: two times or more, ascending; `count` invertible matrices at each.
pub(super) fn check_keys(keys: &mut Option<TransformKeys>, count: usize, what: &str, report: &mut Report) {
    let Some(found) = keys else { return };
    let fault = if !in_order(&found.times) || found.transforms.len() != found.times.len() {
        Some("their times are not in order, or not one for each".into())
    } else if found.transforms.iter().any(|transforms| transforms.len() != count) {
        Some(format!("not {count} at each time"))
    } else {
        let fault = found.transforms.iter().flat_map(|transforms| transforms.iter()).find_map(placement_fault);
        fault.map(|fault| format!("one of them {fault}"))
    };
    if let Some(fault) = fault {
        report.warn(format!("transforms within the shutter: {fault}; {what} stands still: mend the xformOps"));
        *keys = None;
    }
}

/// After it: as [`check_keys`], with as many finite points as the mesh has, and normals as its own or none.
pub(super) fn check_point_keys(mesh: &mut Mesh, report: &mut Report) {
    let Some(keys) = &mut mesh.point_keys else { return };
    let count = mesh.points.len();
    let fits = |points: &crate::flat::Array<[f32; 3]>| points.len() == count && points.iter().all(|p| is_sane(&p[..]));
    if !in_order(&keys.times) || keys.points.len() != keys.times.len() || !keys.points.iter().all(fits) {
        report.warn("points within the shutter: not finite, or not as many at each time; the mesh keeps its shape");
        mesh.point_keys = None;
        return;
    }
    // Normals that were dropped have been reported.
    let Some(normals) = mesh.normals.as_ref().map(|normals| normals.values.len()) else { return keys.normals.clear() };
    let fits =
        |values: &crate::flat::Array<[f32; 3]>| values.len() == normals && values.iter().all(|n| is_sane(&n[..]));
    let fit = keys.normals.is_empty() || keys.normals.len() == keys.times.len() && keys.normals.iter().all(fits);
    if !fit {
        report.warn("normals within the shutter: not finite, or not as many at each time; those of the frame are used");
        keys.normals.clear();
    }
}

fn in_order(times: &[f32]) -> bool {
    times.len() > 1 && times.iter().all(|t| t.is_finite()) && times.windows(2).all(|pair| pair[0] < pair[1])
}
