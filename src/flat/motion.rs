//! What prims are at times of the shutter: 0 where it opens, 1 where it closes. In between values go straight from one
//! key to the next, as Hydra has it.

use super::{Array, Matrix4d};
use serde::{Deserialize, Serialize};

/// Placements; one of each kind per time, in ascending order from 0 to 1.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct TransformKeys {
    pub times: Vec<f32>,
    /// By time: one matrix, or one per instance.
    pub transforms: Vec<Array<Matrix4d>>,
}

/// Points of a mesh, and its normals where these move; per time as many as the mesh has.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct PointKeys {
    /// In ascending order from 0 to 1.
    pub times: Vec<f32>,
    pub points: Vec<Array<[f32; 3]>>,
    /// Values of `Mesh::normals`; empty: those of the mesh all the time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub normals: Vec<Array<[f32; 3]>>,
}
