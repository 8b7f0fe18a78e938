//! What one path brings to its pixel.

use crate::math::Rgb;
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

/// What the first surface of a camera path was.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FirstHit {
    /// Distance along the view axis, stage units.
    pub depth: f32,
    /// World space, unit.
    pub normal: Vec3,
    /// World space, stage units.
    pub position: Vec3,
    /// Index of the Rprim in path order.
    pub prim_id: i32,
}

/// Depth where nothing was hit: farther than any scene, finite so that compositors can filter it.
pub const NO_DEPTH: f32 = 1e30;

impl FirstHit {
    pub const NONE: Self = Self { depth: NO_DEPTH, normal: Vec3::ZERO, position: Vec3::ZERO, prim_id: -1 };
}

/// One sample of a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Light reflected by the first surface from lights, or emitted by it.
    pub direct: Rgb,
    /// Of it, what came from lights and emitting surfaces to the camera straight.
    pub straight: Rgb,
    pub indirect: Rgb,
    /// Light that entered a medium at the first surface.
    pub subsurface: Rgb,
    pub alpha: f32,
    pub albedo: Rgb,
    pub first: FirstHit,
    /// Where that is; `None`: nothing was hit.
    pub surface: Option<OnSurface>,
    /// Pixels that it goes on the image while the shutter is open, x right, y up; 0 unless asked for.
    pub motion: Vec2,
}

/// A point of a surface as geometry has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnSurface {
    pub instance: u32,
    pub triangle: u32,
    pub barycentric: Vec2,
}

impl Sample {
    pub const BLACK: Self = Self {
        direct: Rgb::ZERO,
        straight: Rgb::ZERO,
        indirect: Rgb::ZERO,
        subsurface: Rgb::ZERO,
        alpha: 0.0,
        albedo: Rgb::ZERO,
        first: FirstHit::NONE,
        surface: None,
        motion: Vec2::ZERO,
    };

    pub fn color(&self) -> Rgb {
        self.direct + self.indirect + self.subsurface
    }
}
