//! The shapes area lights have: what samplers and rays need of any of them.

use super::{cylinder::Cylinder, disk::Disk, ellipsoid::Ellipsoid, mesh::TriangleSet, rect::Rect};
use glam::{Vec2, Vec3};

/// Where a ray meets a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeHit {
    /// Distance along the unit direction.
    pub t: f32,
    /// On the unit shape: rect in [-1, 1]^2, disk in the unit disk, sphere on the unit sphere, cylinder
    /// (x in [-1, 1], cos, sin); unused by meshes.
    pub local: Vec3,
    /// Index into the triangles the caller gave for a mesh light; unused by the others.
    pub triangle: u32,
}

impl ShapeHit {
    /// A hit on a mesh light, found by the caller as a hit on an ordinary mesh.
    pub fn on_mesh(t: f32, triangle: u32) -> Self {
        Self { t, local: Vec3::ZERO, triangle }
    }

    pub(super) fn on_shape(t: f32, local: Vec3) -> Self {
        Self { t, local, triangle: 0 }
    }
}

/// A point on a shape, seen from p.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeSample {
    pub wi: Vec3,
    pub hit: ShapeHit,
    /// Per solid angle at p.
    pub pdf: f32,
}

/// Geometry in render space. All emit from their outer side only: a ray that comes from the other side
/// passes through.
#[derive(Debug, Clone)]
pub enum Shape {
    Rect(Rect),
    Disk(Disk),
    Ellipsoid(Ellipsoid),
    Cylinder(Cylinder),
    Mesh(TriangleSet),
}

impl Shape {
    /// Whether some emitting side may face p. Where false, `sample` gives nothing and `pdf` is 0.
    pub fn faces(&self, p: Vec3) -> bool {
        match self {
            Shape::Rect(s) => s.patch.faces(p),
            Shape::Disk(s) => s.patch.faces(p),
            Shape::Ellipsoid(s) => s.faces(p),
            Shape::Cylinder(s) => s.faces(p),
            Shape::Mesh(_) => true,
        }
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        match self {
            Shape::Rect(s) => s.sample(p, u),
            Shape::Disk(s) => s.sample(p, u),
            Shape::Ellipsoid(s) => s.sample(p, u),
            Shape::Cylinder(s) => s.sample(p, u),
            Shape::Mesh(s) => s.sample(p, u),
        }
    }

    /// Solid-angle pdf at p with which `sample` gives the direction `wi` that meets the shape at `hit`.
    pub fn pdf(&self, p: Vec3, wi: Vec3, hit: &ShapeHit) -> f32 {
        match self {
            Shape::Rect(s) => s.pdf(p, wi, hit.t),
            Shape::Disk(s) => s.pdf(p, wi, hit.t),
            Shape::Ellipsoid(s) => s.pdf(p, wi),
            Shape::Cylinder(s) => s.pdf(p, hit),
            Shape::Mesh(s) => s.pdf(wi, hit),
        }
    }

    /// Outward, not unit.
    pub fn normal(&self, hit: &ShapeHit) -> Vec3 {
        match self {
            Shape::Rect(s) => s.patch.normal,
            Shape::Disk(s) => s.patch.normal,
            Shape::Ellipsoid(s) => s.normal(hit),
            Shape::Cylinder(s) => s.normal(hit),
            Shape::Mesh(s) => s.normal(hit.triangle),
        }
    }

    /// Whether the point `hit` emits back along `wi`.
    pub fn emits(&self, wi: Vec3, hit: &ShapeHit) -> bool {
        self.normal(hit).dot(wi) < 0.0
    }

    /// Nearest hit of the emitting side with t in (0, t_max); mesh lights are hit as meshes, never here.
    pub fn intersect(&self, o: Vec3, d: Vec3, t_max: f32) -> Option<ShapeHit> {
        let hit = match self {
            Shape::Rect(s) => s.intersect(o, d),
            Shape::Disk(s) => s.intersect(o, d),
            Shape::Ellipsoid(s) => s.intersect(o, d),
            Shape::Cylinder(s) => s.intersect(o, d),
            Shape::Mesh(_) => None,
        };
        hit.filter(|hit| hit.t > 0.0 && hit.t < t_max)
    }

    /// Axis-aligned box (min, max).
    pub fn bounds(&self) -> (Vec3, Vec3) {
        match self {
            Shape::Rect(s) => s.bounds(),
            Shape::Disk(s) => s.bounds(),
            Shape::Ellipsoid(s) => s.bounds(),
            Shape::Cylinder(s) => s.bounds(),
            Shape::Mesh(s) => s.bounds(),
        }
    }

    /// Radius about the box's centre that holds the shape.
    pub fn radius(&self) -> f32 {
        match self {
            Shape::Rect(s) => s.radius(),
            Shape::Disk(s) => s.radius(),
            Shape::Ellipsoid(s) => s.radius(),
            Shape::Cylinder(s) => s.radius(),
            Shape::Mesh(s) => {
                let (min, max) = s.bounds();
                0.5 * (max - min).length()
            }
        }
    }

    /// Surface area in stage units^2 as UsdLux counts it for `normalize`.
    pub fn area(&self) -> f64 {
        match self {
            Shape::Rect(s) => s.area(),
            Shape::Disk(s) => s.area(),
            Shape::Ellipsoid(s) => s.area(),
            Shape::Cylinder(s) => s.area(),
            Shape::Mesh(s) => s.area(),
        }
    }

    /// The normal where all points share one.
    pub fn common_normal(&self) -> Option<Vec3> {
        match self {
            Shape::Rect(s) => Some(s.patch.normal),
            Shape::Disk(s) => Some(s.patch.normal),
            _ => None,
        }
    }

    /// A cone that holds all normals, as axis and half angle in radians; `None`: they point everywhere.
    pub fn normals(&self) -> Option<(Vec3, f32)> {
        match self {
            Shape::Mesh(s) => Some(s.normals()),
            _ => Some((self.common_normal()?, 0.0)),
        }
    }

    /// Area as seen from afar: face on for planar shapes, a typical side for the others.
    pub fn projected_area(&self) -> f32 {
        let share = match self {
            Shape::Rect(_) | Shape::Disk(_) => 1.0,
            // A convex body shows a quarter of its surface on average (Cauchy).
            Shape::Ellipsoid(_) | Shape::Cylinder(_) | Shape::Mesh(_) => 0.25,
        };
        (share * self.area()) as f32
    }
}

/// A density per area, `distance` away under `cos` at the surface, as one per solid angle. `None` at
/// grazing angles where it overflows: such directions carry no light.
pub fn solid_angle_pdf(pdf_area: f32, distance: f32, cos: f32) -> Option<f32> {
    let pdf = pdf_area * distance * distance / cos;
    (cos > 0.0 && pdf > 0.0 && pdf.is_finite()).then_some(pdf)
}
