//! Mesh lights: triangles chosen by area, then a point uniform in area.
//!
//! A triangle (a, b, c) emits on the side of (b - a) x (c - a), its outward side: whoever hands the triangles
//! over has already turned those of left-handed or mirrored meshes.

use super::{
    bound::join_cones,
    shape::{ShapeHit, ShapeSample, solid_angle_pdf},
};
use crate::math::PI;
use crate::sampling::distribution::Distribution1D;
use glam::{Vec2, Vec3};

#[derive(Debug, Clone)]
pub struct TriangleSet {
    triangles: Vec<[Vec3; 3]>,
    /// By area; degenerate triangles keep their index and have no probability.
    choice: Distribution1D,
    bounds: (Vec3, Vec3),
}

impl TriangleSet {
    /// Triangles in render space; `None` where they have no finite area.
    pub fn new(triangles: Vec<[Vec3; 3]>) -> Option<Self> {
        let choice = Distribution1D::new(triangles.iter().map(|t| 0.5 * cross(t).as_dvec3().length()))?;
        let points = || triangles.iter().flatten().copied();
        let bounds = (points().reduce(Vec3::min)?, points().reduce(Vec3::max)?);
        let finite = points().all(|p| p.is_finite());
        finite.then_some(Self { triangles, choice, bounds })
    }

    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let (index, x) = self.choice.sample(f64::from(u.x));
        let [a, b, c] = self.triangles[index];
        // Uniform barycentrics (Turk 1990, Graphics Gems, "Generating Random Points in Triangles").
        let root = (x as f32).sqrt();
        let q = a * (1.0 - root) + b * (root * (1.0 - u.y)) + c * (root * u.y);
        let t = (q - p).length();
        // p on the light itself: no direction.
        let wi = (q - p).try_normalize()?;
        let hit = ShapeHit::on_mesh(t, index as u32);
        Some(ShapeSample { wi, hit, pdf: self.area_pdf(wi, &hit)? })
    }

    /// Solid-angle pdf of [`Self::sample`].
    pub fn pdf(&self, wi: Vec3, hit: &ShapeHit) -> f32 {
        self.area_pdf(wi, hit).unwrap_or(0.0)
    }

    fn area_pdf(&self, wi: Vec3, hit: &ShapeHit) -> Option<f32> {
        let normal = self.normal(hit.triangle).try_normalize()?;
        solid_angle_pdf((1.0 / self.area()) as f32, hit.t, -wi.dot(normal))
    }

    /// Outward, not unit; zero for an index that is not there.
    pub fn normal(&self, triangle: u32) -> Vec3 {
        self.triangles.get(triangle as usize).map_or(Vec3::ZERO, cross)
    }

    /// A cone that holds the normals of all triangles, as axis and half angle in radians.
    pub fn normals(&self) -> (Vec3, f32) {
        let normals = self.triangles.iter().filter_map(|t| cross(t).try_normalize());
        normals.map(|n| (n, 0.0)).reduce(join_cones).unwrap_or((Vec3::Z, PI))
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }

    pub fn area(&self) -> f64 {
        self.choice.sum()
    }
}

fn cross(t: &[Vec3; 3]) -> Vec3 {
    (t[1] - t[0]).cross(t[2] - t[0])
}
