//! Surface points: where a ray has hit, how the surface lies there, and what it is made of.

use super::attribute::Attribute;
use super::{Coating, CoatingAt, Driven, Instance, Moment, SurfaceHit, network};
use crate::bsdf::Side;
use crate::interaction::{Interaction, shading_normal};
use crate::math::Frame;
use glam::{Vec2, Vec3};

impl<'a> Moment<'a> {
    /// The surface point of a hit on a path that travels along `d`.
    pub fn interaction(&self, hit: &SurfaceHit, d: Vec3, side: Side) -> Interaction {
        let instance = &self.instances[hit.instance as usize];
        let geometry = &instance.geometry;
        let [a, b, c] = geometry.corners(hit.triangle, self.time);
        let local = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        let m = &*instance.placed(self.time);
        let at = Vec2::new(hit.u, hit.v);
        let front_normal = m.normal((b - a).cross(c - a)).normalize_or(-d);
        let front = front_normal.dot(d) <= 0.0;
        let outward = matches!(side, Side::Outside) == front;
        let ng = if outward { front_normal } else { -front_normal };
        let wo = -d;
        let corners = geometry.triangles[hit.triangle as usize];
        let ns = geometry.normal(hit.triangle, hit.u, hit.v, self.time).map_or(ng, |normal| {
            let n = m.normal(normal);
            // Inside, the side of wo is -ng: bend there, then turn back.
            match side {
                Side::Outside => shading_normal(n, ng, wo),
                Side::Inside => -shading_normal(n, -ng, wo),
            }
        });
        // Rounding of the barycentric sum and of the affine map: a few ulps of the largest term.
        let extent = (m.linear.abs() * (a.abs().max(b.abs()).max(c.abs()))) + m.translation.abs();
        Interaction {
            p: m.point(local),
            error: 4.0 * f32::EPSILON * extent.max_element(),
            ng,
            frame: match &geometry.strands {
                None => Frame::from_normal(ns),
                Some(strands) => strands.frame(m, hit.triangle as usize, corners, at, wo),
            },
            wo,
            side,
            strand: geometry.strands.is_some(),
            instance: hit.instance,
            triangle: hit.triangle,
            barycentric: at,
            surface: instance.surfaces + geometry.slot(hit.triangle) as u32,
            front,
            display_color: match &geometry.display_color {
                _ if instance.display_color.is_some() => instance.display_color,
                None | Some(Attribute::Constant(_)) => None,
                Some(color) => Some(color.at(hit.triangle as usize, corners, hit.u, hit.v)),
            },
        }
    }

    /// The coating at `si`, whose shading normal it may bend. `width`: of the ray's footprint across the ray.
    pub fn shade(&self, si: &mut Interaction, width: f32) -> CoatingAt<'a> {
        let coating = &self.scene.surfaces[si.surface as usize];
        match &coating.driven {
            None => CoatingAt::Constant(coating),
            Some(driven) => CoatingAt::Driven(self.drive(driven, si, width)),
        }
    }

    /// Bends the shading normal of `si`, if its material does.
    pub fn bend(&self, si: &mut Interaction, width: f32) {
        if let Some(driven) = self.surfaces[si.surface as usize].driven.as_ref().filter(|driven| driven.bends()) {
            self.drive(driven, si, width);
        }
    }

    fn drive(&self, driven: &Driven, si: &mut Interaction, width: f32) -> Coating {
        let instance = &self.instances[si.instance as usize];
        let geometry = &instance.geometry;
        let lookup = network::Lookup {
            primvars: &geometry.primvars,
            instance: instance.primvars.as_ref().map(|(primvars, i)| (&**primvars, *i as usize)),
            triangle: si.triangle as usize,
            corners: geometry.triangles[si.triangle as usize],
            at: si.barycentric,
            across: Some(footprint(instance, si, width, self.time)),
            time: self.time,
        };
        let outward = matches!(si.side, Side::Outside) == si.front;
        let turn = if outward { 1.0 } else { -1.0 };
        let (coating, bent) = driven.at(instance, &lookup, si.display_color, si.frame.n * turn);
        if let Some(n) = bent {
            // As in `interaction`.
            let n = n * turn;
            si.frame = Frame::from_normal(match si.side {
                Side::Outside => shading_normal(n, si.ng, si.wo),
                Side::Inside => -shading_normal(-n, -si.ng, si.wo),
            });
        }
        coating
    }
}

/// Grazing footprints are cut to this many widths: images beyond are averaged by the samples of a pixel.
const LONGEST_FOOTPRINT: f32 = 16.0;

/// Offsets in barycentrics of two points beside `si`: along the ray's projection, and across it.
fn footprint(instance: &Instance, si: &Interaction, width: f32, time: f32) -> [Vec2; 2] {
    let [a, b, c] = instance.geometry.corners(si.triangle, time);
    let placed = instance.placed(time);
    let [e1, e2] = [b - a, c - a].map(|edge| placed.vector(edge));
    let cos = si.wo.dot(si.ng);
    let along = (si.wo - si.ng * cos).try_normalize().unwrap_or_else(|| si.ng.any_orthonormal_vector());
    let stretch = cos.abs().recip().min(LONGEST_FOOTPRINT);
    let (m11, m12, m22) = (e1.length_squared(), e1.dot(e2), e2.length_squared());
    let determinant = m11 * m22 - m12 * m12;
    [along * (width * stretch), si.ng.cross(along) * width].map(|offset| {
        let (x, y) = (offset.dot(e1), offset.dot(e2));
        let barycentric = Vec2::new(m22 * x - m12 * y, m11 * y - m12 * x) / determinant;
        // A needle without area in f32 is seen whole: a point of it.
        if barycentric.is_finite() { barycentric } else { Vec2::ZERO }
    })
}
