//! The flattened scene: USD's words and units, ids instead of pointers, nothing compiled.

pub mod array;
mod camera;
pub mod file;
mod light;
mod material;
mod mesh;
mod motion;
mod network;
#[cfg(test)]
pub(crate) mod sample;
mod settings;
pub mod validate;

pub use array::Array;
pub use camera::{Camera, Projection};
pub use light::{Ies, Light, LightShape, Portal, Shadow, Shaping};
pub use material::{ChiangHair, Material, OpenPbrSurface, PreviewSurface, StandardSurface};
pub use mesh::{
    AnyPrimvar, GeomSubset, IDENTITY, Image, Instancer, Interpolation, Matrix4d, Mesh, Orientation, Prims, Primvar,
    SubdivTags, Texels, Texture,
};
pub use motion::{PointKeys, TransformKeys};
pub use network::{ImageNode, Network, Node, Op, Tile, Wrap};
pub use settings::{
    AOVS, EXTRA_AOVS, GUIDE_AOVS, LIGHT_AOV, LOBE_AOVS, MAX_NORMALS, PRIMVAR_AOV, RenderSettings, WALKS, parts_of,
};

use serde::{Deserialize, Serialize};

/// Stage metadata that gives numbers their meaning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct StageInfo {
    pub file: String,
    /// `Y` or `Z`.
    pub up_axis: String,
    pub meters_per_unit: f64,
    pub time_code: f64,
}

impl Default for StageInfo {
    fn default() -> Self {
        Self { file: String::new(), up_axis: "Y".into(), meters_per_unit: 0.01, time_code: 0.0 }
    }
}

/// One prim as the bridge hands it to `RenderDelegate::sync`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type")]
#[allow(clippy::large_enum_variant)] // one at a time, on its way into the scene: a box would only be unpacked
pub enum Prim {
    Mesh(Mesh),
    Instancer(Instancer),
    Material(Material),
    Light(Light),
    Camera(Camera),
    Texture(Texture),
    Image(Image),
}

/// A whole stage at one time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct FlatScene {
    pub stage: StageInfo,
    pub meshes: Prims<Mesh>,
    pub instancers: Prims<Instancer>,
    pub materials: Prims<Material>,
    pub lights: Prims<Light>,
    pub cameras: Prims<Camera>,
    pub textures: Prims<Texture>,
    pub images: Prims<Image>,
    pub settings: RenderSettings,
    /// What the bridge dropped or replaced on the way here.
    pub warnings: Vec<crate::error::Warning>,
}

impl FlatScene {
    /// Whether things move in the picture: the shutter opens, and blur is wanted.
    pub fn moves(&self) -> bool {
        !self.settings.disable_motion_blur && self.opens()
    }

    /// Whether the ways of things are asked for beside a sharp picture.
    pub fn has_tracks(&self) -> bool {
        let vectors = self.settings.aovs.iter().any(|aov| aov == "motionVector");
        vectors && self.settings.disable_motion_blur && self.opens()
    }

    fn opens(&self) -> bool {
        self.cameras.get(&self.settings.camera).is_some_and(Camera::opens)
    }
}
