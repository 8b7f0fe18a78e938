//! A mesh made ready for rays: triangles about their centre, a BVH, and attributes at the corners.

use super::accel::{Aabb, Blas, ClosestPoint, Ray, TriHit};
use super::attribute::{Attribute, Values, attribute};
use super::displace::{Displacement, Surface};
use super::edges::open_edges;
use super::image::ImageCache;
use super::motion::{Deformation, Keys};
use super::strands::Strands;
use super::triangulation::{Triangulation, slots, triangulate};
use crate::flat;
use crate::math::Affine;
use crate::subdivision::{self, Refinement};
use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

pub struct Geometry {
    /// Object space minus `centre`, so that f32 resolves a mesh far from its origin; of one that deforms at the frame.
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub centre: DVec3,
    /// Empty where it deforms.
    blas: Blas,
    /// `None`: the points stay.
    pub deformation: Option<Box<Deformation>>,
    /// Shading normals in object space, not unit; `None`: flat.
    pub normals: Option<Attribute<Vec3>>,
    pub display_color: Option<Attribute<Vec3>>,
    pub display_opacity: f32,
    /// Those that materials read.
    pub primvars: BTreeMap<String, Values>,
    /// Of curves in a hair material.
    pub strands: Option<Box<Strands>>,
    /// Material slot per triangle: 0 the mesh's own, i the (i-1)th GeomSubset; `None`: all 0.
    pub slots: Option<Vec<u16>>,
    /// `None`: not a subdivision surface.
    pub refinement: Option<Refinement>,
    /// What moved its points; `None`: nothing.
    pub displacement: Option<Displacement>,
    /// Corners whose displacement was no number.
    pub not_displaced: usize,
}

impl Geometry {
    /// From a validated mesh: every index is in range, every point finite. A subdivision surface is refined `level`
    /// times and moved to its limit; at level 0 it is its cage. Then `displacement` moves its points. With `deforms` the
    /// points have their keys.
    pub fn compile(
        mesh: flat::Mesh,
        level: u32,
        deforms: bool,
        displacement: Option<Displacement>,
        images: &ImageCache,
    ) -> Self {
        let displacement = displacement.map(|displacement| (displacement, images));
        let moving = mesh.point_keys.is_some() && deforms;
        let moving = moving.then(|| mesh.clone());
        let centre = centre(&mesh.points);
        let mut geometry = Self::about(mesh, level, centre, deforms, displacement);
        if let Some((mesh, keys)) = moving.as_ref().and_then(|mesh| Some((mesh, mesh.point_keys.as_ref()?))) {
            geometry.deformation = Some(Box::new(geometry.deformed(mesh, keys, images)));
        }
        geometry
    }

    /// Each key by itself, all about one centre.
    fn deformed(&self, mesh: &flat::Mesh, keys: &flat::PointKeys, images: &ImageCache) -> Deformation {
        let level = self.refinement.as_ref().map_or(0, |refinement| refinement.level);
        let at = |k: usize| {
            let mut there = flat::Mesh { points: keys.points[k].clone(), point_keys: None, ..mesh.clone() };
            if let (Some(normals), Some(values)) = (&mut there.normals, keys.normals.get(k)) {
                normals.values = values.clone();
            }
            let displacement = self.displacement.clone().map(|displacement| (displacement, images));
            let there = Self::about(there, level, self.centre, true, displacement);
            (there.points, there.normals)
        };
        let (points, normals): (Vec<_>, Vec<_>) = (0..keys.times.len()).into_par_iter().map(at).unzip();
        let closed = self.strands.as_ref().is_some_and(|strands| !strands.ribbons);
        let points = Keys::new(keys.times.clone(), points);
        Deformation::new(points, normals.into_iter().collect(), &self.triangles, closed)
    }

    /// Without a tree where others take its place.
    fn about(
        mesh: flat::Mesh,
        level: u32,
        centre: DVec3,
        treeless: bool,
        displacement: Option<(Displacement, &ImageCache)>,
    ) -> Self {
        let points: Vec<Vec3> = mesh.points.iter().map(|p| (Vec3::from(*p).as_dvec3() - centre).as_vec3()).collect();
        let build = |mesh: flat::Mesh, points, refinement| {
            Self::build(mesh, points, centre, refinement, displacement, treeless)
        };
        if !subdivision::is_subdivided(&mesh) {
            return build(mesh, points, None);
        }
        if level == 0 {
            let cage_faces = mesh.face_vertex_counts.len();
            return build(mesh, points, Some(Refinement { asked: 0, level, cage_faces, faults: Vec::new() }));
        }
        let refined = subdivision::refine(&mesh, &points, level);
        drop(mesh);
        build(refined.mesh, refined.points, Some(refined.refinement))
    }

    /// From a mesh whose points are about `centre` already.
    fn build(
        mesh: flat::Mesh,
        mut points: Vec<Vec3>,
        centre: DVec3,
        refinement: Option<Refinement>,
        displacement: Option<(Displacement, &ImageCache)>,
        treeless: bool,
    ) -> Self {
        let soup = triangulate(&mesh);
        let slots = slots(&mesh, &soup.faces);
        let mut primvars: BTreeMap<String, Values> =
            mesh.primvars.iter().map(|(name, primvar)| (name.clone(), Values::new(primvar, &soup))).collect();
        let strands = Strands::take(&mut primvars).map(Box::new);
        let mut not_displaced = 0;
        let mut normals = match (&mesh.normals, mesh.subdivision_scheme.as_str()) {
            (Some(normals), "none") => Some(attribute(normals, &soup, Vec3::from)),
            (None, "none") | (_, "bilinear") => None,
            // A subdivision surface is smooth even as its control cage.
            _ => Some(Attribute::Point(smooth_normals(&points, &soup.triangles))),
        };
        if let Some((displacement, images)) = &displacement {
            let (slots, normals_before) = (slots.as_deref(), normals.as_ref());
            let surface = Surface {
                points: &points,
                triangles: &soup.triangles,
                slots,
                primvars: &primvars,
                normals: normals_before,
            };
            let moved = displacement.apply(&surface, images);
            (points, normals, not_displaced) = (moved.points, moved.normals, moved.not_finite);
        }
        let display_color = mesh.display_color.as_ref().map(|c| attribute(c, &soup, Vec3::from));
        let Triangulation { triangles, corners, faces } = soup;
        let display_opacity = mesh.display_opacity.as_ref().and_then(|o| o.values.first().copied()).unwrap_or(1.0);
        drop((mesh, corners, faces)); // a tree being built needs the room
        let blas = Blas::build(&points, if treeless { &[] } else { &triangles });
        let closed = strands.as_ref().is_some_and(|strands| !strands.ribbons);
        Self {
            blas: if closed { blas.one_sided() } else { blas },
            normals,
            display_color,
            display_opacity,
            primvars,
            strands,
            slots,
            points,
            triangles,
            centre,
            deformation: None,
            refinement,
            displacement: displacement.map(|(displacement, _)| displacement),
            not_displaced,
        }
    }

    /// The refine level that it was compiled for.
    pub fn asked_level(&self) -> u32 {
        self.refinement.as_ref().map_or(0, |refinement| refinement.asked)
    }

    /// Corner positions of a triangle, centred object space.
    pub fn corners(&self, triangle: u32, time: f32) -> [Vec3; 3] {
        let indices = self.triangles[triangle as usize];
        match &self.deformation {
            None => indices.map(|i| self.points[i as usize]),
            Some(deformation) => deformation.corners(indices, time),
        }
    }

    /// Shading normal in object space, not unit; `None`: flat.
    pub fn normal(&self, triangle: u32, u: f32, v: f32, time: f32) -> Option<Vec3> {
        let corners = self.triangles[triangle as usize];
        let at = |normals: &Attribute<Vec3>| normals.at(triangle as usize, corners, u, v);
        self.normals_at(time, at, |a, b, f| a + (b - a) * f)
    }

    /// Shading normals at the corners of a triangle.
    pub fn corner_normals(&self, triangle: u32, time: f32) -> Option<[Vec3; 3]> {
        let corners = self.triangles[triangle as usize];
        let at = |normals: &Attribute<Vec3>| normals.corners(triangle as usize, corners);
        self.normals_at(time, at, |a, b, f| [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * f))
    }

    fn normals_at<T>(
        &self,
        time: f32,
        at: impl Fn(&Attribute<Vec3>) -> T,
        between: impl Fn(T, T, f32) -> T,
    ) -> Option<T> {
        match &self.deformation {
            None => self.normals.as_ref().map(at),
            Some(deformation) => {
                let (normals, (i, f)) = (deformation.normals.as_ref()?, deformation.points.segment(time));
                Some(between(at(&normals[i]), at(&normals[i + 1]), f))
            }
        }
    }

    /// As `Blas::closest_skip`.
    #[inline(always)]
    pub fn closest(&self, ray: &Ray, skip: u32, time: f32) -> Option<TriHit> {
        match &self.deformation {
            None => self.blas.closest_skip(ray, skip),
            Some(deformation) => deformation.closest(ray, skip, time),
        }
    }

    /// The same where nothing deforms.
    #[inline(always)]
    pub fn closest_still(&self, ray: &Ray, skip: u32) -> Option<TriHit> {
        self.blas.closest_skip(ray, skip)
    }

    /// As `Blas::any_skip`, where nothing deforms.
    #[inline(always)]
    pub fn any_still(&self, ray: &Ray, skip: u32) -> bool {
        self.blas.any_skip(ray, skip)
    }

    /// As `Blas::any_skip`.
    #[inline(always)]
    pub fn any(&self, ray: &Ray, skip: u32, time: f32) -> bool {
        match &self.deformation {
            None => self.blas.any_skip(ray, skip),
            Some(deformation) => deformation.any(ray, skip, time),
        }
    }

    /// As `Blas::closest_point_under`.
    pub fn closest_point_under(&self, metric: &Mat3, least_stretch: f32, p: Vec3, time: f32) -> Option<ClosestPoint> {
        match &self.deformation {
            None => self.blas.closest_point_under(metric, least_stretch, p),
            Some(deformation) => {
                let (blas, f) = deformation.stretch(time);
                blas.closest_point_under(metric, least_stretch, p, f)
            }
        }
    }

    /// Of all the time that the shutter is open; centred object space.
    pub fn bounds(&self) -> Aabb {
        self.deformation.as_ref().map_or_else(|| self.blas.bounds(), |deformation| deformation.bounds())
    }

    /// A box around all points under `m`, all of the time; closer with more `levels` of the tree (see `Blas::bounds_under`).
    pub fn bounds_under(&self, m: &Affine, levels: u32) -> Aabb {
        match &self.deformation {
            None => self.blas.bounds_under(m, levels),
            Some(deformation) => deformation.bounds().transform(m),
        }
    }

    pub fn slot(&self, triangle: u32) -> usize {
        self.slots.as_ref().map_or(0, |slots| usize::from(slots[triangle as usize]))
    }

    /// Which of `count` slots have a triangle.
    pub fn slots_in_use(&self, count: usize) -> Vec<bool> {
        let mut used = vec![false; count];
        match &self.slots {
            None => used[0] = !self.triangles.is_empty(),
            Some(slots) => slots.iter().for_each(|&slot| used[usize::from(slot)] = true),
        }
        used
    }

    /// Whether a triangle of a mesh that does not deform is `wanted`, by its corners; those in boxes that are not `near` are
    /// not asked.
    pub fn any_triangle(&self, near: impl Fn(&Aabb) -> bool, wanted: impl Fn([Vec3; 3]) -> bool) -> bool {
        self.blas.any_triangle(near, wanted)
    }

    /// Bytes, attributes and BVH included.
    pub fn memory(&self) -> usize {
        let attributes = [&self.normals, &self.display_color].into_iter().flatten().map(Attribute::memory);
        let primvars = self.primvars.values().map(Values::memory).sum::<usize>();
        let strands = self.strands.as_ref().map_or(0, |strands| strands.memory());
        let slots = self.slots.as_ref().map_or(0, |slots| size_of_val(slots.as_slice()));
        let indexed = size_of_val(self.points.as_slice()) + size_of_val(self.triangles.as_slice());
        let deformation = self.deformation.as_ref().map_or(0, |deformation| deformation.memory());
        indexed + deformation + self.blas.memory() + attributes.sum::<usize>() + primvars + strands + slots
    }

    /// Edges (between points welded by position) that do not join faces in pairs: what keeps the mesh from
    /// enclosing a volume. Asked only for meshes with a medium.
    pub fn open_edges(&self) -> usize {
        open_edges(&self.points, &self.triangles)
    }
}

/// Centre of the bounding box; any point of it serves, the middle rounds least.
fn centre(points: &[[f32; 3]]) -> DVec3 {
    let mut bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for p in points.iter().map(|p| Vec3::from(*p)).filter(|p| p.is_finite()) {
        bounds = (bounds.0.min(p), bounds.1.max(p));
    }
    if bounds.0.x > bounds.1.x { DVec3::ZERO } else { (bounds.0.as_dvec3() + bounds.1.as_dvec3()) * 0.5 }
}

/// Normals at points, weighted by area; not unit.
fn smooth_normals(points: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; points.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| points[i as usize]);
        let n = (b - a).cross(c - a);
        for &i in triangle {
            normals[i as usize] += n;
        }
    }
    normals
}
