//! Direct lighting by midpoint sums over the surface of a light, in f64, straight from the definitions.

use crate::flat::{self, LightShape, Matrix4d};
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// A point of a light's surface: world position, area vector (outward, length = area of the piece).
pub struct Piece {
    pub position: DVec3,
    pub area: DVec3,
}

fn transform(m: &Matrix4d, v: DVec3, w: f64) -> DVec3 {
    let v = [v.x, v.y, v.z, w];
    let column = |j: usize| (0..4).map(|i| v[i] * m[i][j]).sum::<f64>();
    DVec3::new(column(0), column(1), column(2))
}

/// Local point, its derivatives, and a local direction with a positive component outward.
fn local(shape: &LightShape, a: f64, b: f64) -> [DVec3; 4] {
    match *shape {
        LightShape::Rect { width, height, .. } => {
            let (w, h) = (f64::from(width), f64::from(height));
            let point = DVec3::new((a - 0.5) * w, (b - 0.5) * h, 0.0);
            [point, DVec3::X * w, DVec3::Y * h, DVec3::NEG_Z]
        }
        LightShape::Disk { radius } => {
            let (rho, (sin, cos)) = (f64::from(radius) * a, (TAU * b).sin_cos());
            let (radial, around) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
            [radial * rho, radial * f64::from(radius), around * rho * TAU, DVec3::NEG_Z]
        }
        LightShape::Sphere { radius } => {
            let (r, (sin_t, cos_t), (sin, cos)) = (f64::from(radius), (PI * a).sin_cos(), (TAU * b).sin_cos());
            let point = DVec3::new(sin_t * cos, sin_t * sin, cos_t);
            let along = DVec3::new(cos_t * cos, cos_t * sin, -sin_t) * PI;
            [point * r, along * r, DVec3::new(-sin, cos, 0.0) * sin_t * TAU * r, point]
        }
        LightShape::Cylinder { length, radius } => {
            let (l, r, (sin, cos)) = (f64::from(length), f64::from(radius), (TAU * b).sin_cos());
            let out = DVec3::new(0.0, cos, sin);
            [DVec3::X * (a - 0.5) * l + out * r, DVec3::X * l, DVec3::new(0.0, -sin, cos) * TAU * r, out]
        }
        _ => unreachable!("no area light"),
    }
}

/// n x n pieces of the surface.
pub fn pieces(light: &flat::Light, n: usize) -> impl Iterator<Item = Piece> {
    (0..n * n).map(move |i| {
        let at = |k: usize| (k as f64 + 0.5) / n as f64;
        let [point, da, db, outward] = local(&light.shape, at(i % n), at(i / n));
        let m = &light.transform;
        let area = transform(m, da, 0.0).cross(transform(m, db, 0.0)) / (n * n) as f64;
        // Whichever way the cross product turned, outward leads away from the surface.
        let area = area * area.dot(transform(m, outward, 0.0)).signum();
        Piece { position: transform(m, point, 1.0), area }
    })
}

/// Shaping and intensity as the schema words them; no color, exposure or normalize.
fn radiance(light: &flat::Light, emitted: DVec3) -> f64 {
    let axis = transform(&light.transform, DVec3::NEG_Z, 0.0).normalize();
    let intensity = f64::from(light.intensity);
    let Some(shaping) = &light.shaping else { return intensity };
    let cos = axis.dot(emitted).clamp(-1.0, 1.0);
    let (theta, cutoff) = (cos.acos(), f64::from(shaping.cone_angle).to_radians());
    let start = cutoff * (1.0 - f64::from(shaping.cone_softness));
    let x = ((theta - start) / (cutoff - start)).clamp(0.0, 1.0);
    let cone = if theta > cutoff { 0.0 } else { 1.0 - x * x * (3.0 - 2.0 * x) };
    let focus = cos.abs().powf(f64::from(shaping.focus));
    intensity * cone * (f64::from(shaping.focus_tint[0]) * (1.0 - focus) + focus)
}

/// Irradiance at p on the side of n.
pub fn irradiance(light: &flat::Light, p: DVec3, n: DVec3, grid: usize) -> f64 {
    let contribution = |piece: Piece| {
        let to = piece.position - p;
        let wi = to.normalize();
        let projected = -piece.area.dot(wi);
        let cos = n.dot(wi);
        if projected <= 0.0 || cos <= 0.0 { 0.0 } else { radiance(light, -wi) * cos * projected / to.length_squared() }
    };
    pieces(light, grid).map(contribution).sum()
}

/// Surface area.
pub fn area(light: &flat::Light, grid: usize) -> f64 {
    pieces(light, grid).map(|piece| piece.area.length()).sum()
}
