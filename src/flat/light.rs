//! UsdLux lights with the specification's names and defaults.

use super::array::Array;
use super::mesh::{IDENTITY, Matrix4d};
use super::motion::TransformKeys;
use serde::{Deserialize, Serialize};

/// What shape emits; local frame and defaults as in UsdLux (emission along -Z unless said).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", rename_all_fields = "camelCase", tag = "kind")]
pub enum LightShape {
    /// XY rectangle; `texture` is a key of `FlatScene::textures` or empty. Min uv at (+X, +Y).
    Rect { width: f32, height: f32, texture: String },
    /// XY disk.
    Disk { radius: f32 },
    /// Emits outward.
    Sphere { radius: f32 },
    /// Axis X, emits outward, no caps.
    Cylinder { length: f32, radius: f32 },
    /// `angle` in degrees (full angle); travels along -Z.
    Distant { angle: f32 },
    /// `texture` as for Rect; latlong. `pole_axis` is `Y` or `Z` (the bridge resolves `scene`).
    Dome { texture: String, pole_axis: String },
    /// The mesh at `mesh` (a key of `FlatScene::meshes`) emits from its outer side.
    Mesh { mesh: String },
}

/// `UsdLuxShapingAPI`, present only where applied.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Shaping {
    pub focus: f32,
    pub focus_tint: [f32; 3],
    /// Half angle, degrees.
    pub cone_angle: f32,
    pub cone_softness: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ies: Option<Ies>,
}

/// An IES profile, all around.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Ies {
    /// Degrees from the light's -Z, ascending.
    pub vertical: Array<f32>,
    /// Degrees from +X towards +Y, ascending from 0 to 360; a single one: the same all around.
    pub horizontal: Array<f32>,
    /// One per vertical angle, for each horizontal angle.
    pub candela: Array<f32>,
    pub angle_scale: f32,
    pub normalize: bool,
}

impl Default for Shaping {
    fn default() -> Self {
        Self { focus: 0.0, focus_tint: [0.0; 3], cone_angle: 90.0, cone_softness: 0.0, ies: None }
    }
}

/// `UsdLuxShadowAPI`, present only where something in it is not the default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Shadow {
    pub enable: bool,
    pub color: [f32; 3],
    /// From the shaded point to what casts the shadow; negative: no limit.
    pub distance: f32,
    /// Of the distance, the last part, in which shadows fade; not positive: none.
    pub falloff: f32,
    pub falloff_gamma: f32,
}

impl Default for Shadow {
    fn default() -> Self {
        Self { enable: true, color: [0.0; 3], distance: -1.0, falloff: -1.0, falloff_gamma: 1.0 }
    }
}

/// `UsdLuxPortalLight`: an XY rectangle through which the light of a dome comes in, along -Z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Portal {
    /// Of its prim, for warnings.
    pub path: String,
    /// Local to world, at the frame.
    pub transform: Matrix4d,
    pub width: f32,
    pub height: f32,
}

impl Default for Portal {
    fn default() -> Self {
        Self { path: String::new(), transform: IDENTITY, width: 1.0, height: 1.0 }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Light {
    /// Local to world.
    pub transform: Matrix4d,
    /// Whether it lights at all (visibility resolved by the bridge).
    pub visible: bool,
    /// Whether camera rays see the shape (or, for a dome, the background).
    pub camera_visible: bool,
    pub intensity: f32,
    pub exposure: f32,
    pub color: [f32; 3],
    pub enable_color_temperature: bool,
    /// Kelvin.
    pub color_temperature: f32,
    /// `UsdLux.BlackbodyTemperatureAsRgb(colorTemperature)`, resolved by the bridge.
    pub blackbody: [f32; 3],
    pub normalize: bool,
    /// Factors of its effect on diffuse lobes and media, and on the others.
    #[serde(skip_serializing_if = "is_one")]
    pub diffuse: f32,
    #[serde(skip_serializing_if = "is_one")]
    pub specular: f32,
    pub shaping: Option<Shaping>,
    pub shape: LightShape,
    /// Category of what it lights, and of what casts its shadows ([`super::Mesh::categories`]); empty: everything.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub light_link: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    pub shadow_link: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadow: Option<Shadow>,
    /// Of `transform`; `None`: it stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform_keys: Option<TransformKeys>,
    /// Path of its prim, where the key does not end on its name: of the prototype of an instancer; for AOVs.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub prim: String,
    /// Light group, for AOVs; empty: none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub group: String,
    /// Of a dome: they guide its samples.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub portals: Vec<Portal>,
}

// serde hands out references.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_one(value: &f32) -> bool {
    *value == 1.0
}

impl Default for Light {
    fn default() -> Self {
        Self {
            transform: IDENTITY,
            visible: true,
            camera_visible: false,
            intensity: 1.0,
            exposure: 0.0,
            color: [1.0; 3],
            enable_color_temperature: false,
            color_temperature: 6500.0,
            blackbody: [1.0; 3],
            normalize: false,
            diffuse: 1.0,
            specular: 1.0,
            shaping: None,
            shape: LightShape::Sphere { radius: 0.5 },
            light_link: String::new(),
            shadow_link: String::new(),
            shadow: None,
            transform_keys: None,
            prim: String::new(),
            group: String::new(),
            portals: Vec::new(),
        }
    }
}
