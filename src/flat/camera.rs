//! `UsdGeomCamera` with the specification's names; lengths as authored.

use super::mesh::{IDENTITY, Matrix4d};
use super::motion::TransformKeys;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub enum Projection {
    #[default]
    Perspective,
    Orthographic,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Camera {
    /// Local to world; looks along -Z, up +Y.
    pub transform: Matrix4d,
    pub projection: Projection,
    /// Tenths of a stage unit, as are the next four.
    pub horizontal_aperture: f32,
    pub vertical_aperture: f32,
    pub horizontal_aperture_offset: f32,
    pub vertical_aperture_offset: f32,
    pub focal_length: f32,
    /// Stage units.
    pub clipping_range: [f32; 2],
    /// 0: pinhole.
    pub f_stop: f32,
    /// Stage units; 0: no depth of field.
    pub focus_distance: f32,
    /// `UsdGeomCamera.ComputeLinearExposureScale()`, resolved by the bridge.
    pub exposure_scale: f32,
    /// When the shutter opens and closes, time codes from the frame on; equal: nothing moves.
    pub shutter: [f32; 2],
    /// Of `transform`; `None`: it stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform_keys: Option<TransformKeys>,
}

impl Camera {
    /// Whether the shutter is open for any time.
    pub fn opens(&self) -> bool {
        self.shutter[1] > self.shutter[0]
    }
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            transform: IDENTITY,
            projection: Projection::Perspective,
            horizontal_aperture: 20.955,
            vertical_aperture: 15.2908,
            horizontal_aperture_offset: 0.0,
            vertical_aperture_offset: 0.0,
            focal_length: 50.0,
            clipping_range: [1.0, 1_000_000.0],
            f_stop: 0.0,
            focus_distance: 0.0,
            exposure_scale: 1.0,
            shutter: [0.0; 2],
            transform_keys: None,
        }
    }
}
