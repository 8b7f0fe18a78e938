//! Geometry prims: polygon meshes with USD's attribute names, and what places copies of them.

use super::{Array, PointKeys, TransformKeys};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Row-vector 4x4 matrix as `GfMatrix4d`: translation in the last row, stage units.
pub type Matrix4d = [[f64; 4]; 4];

pub const IDENTITY: Matrix4d = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub enum Orientation {
    #[default]
    RightHanded,
    LeftHanded,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub enum Interpolation {
    Constant,
    Uniform,
    Varying,
    #[default]
    Vertex,
    FaceVarying,
}

/// Values on a mesh; with `indices`, element i is `values[indices[i]]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Primvar<T: super::array::Element> {
    pub interpolation: Interpolation,
    pub values: Array<T>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indices: Option<Array<i32>>,
}

/// A primvar that materials read, by its number of components.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "camelCase")]
pub enum AnyPrimvar {
    Float(Primvar<f32>),
    Float2(Primvar<[f32; 2]>),
    Float3(Primvar<[f32; 3]>),
    Float4(Primvar<[f32; 4]>),
}

/// `UsdGeomSubset` of family `materialBind`: faces with a material of their own.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct GeomSubset {
    /// Prim path of the subset.
    pub path: String,
    /// Face indices.
    pub indices: Array<i32>,
    /// Prim path of the bound material; empty: none.
    pub material: String,
}

/// What shapes a subdivision surface beside its cage: the tags of `UsdGeomMesh`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct SubdivTags {
    /// `none`, `edgeOnly`, `edgeAndCorner`.
    pub interpolate_boundary: String,
    /// `none`, `cornersOnly`, `cornersPlus1`, `cornersPlus2`, `boundaries`, `all`.
    pub face_varying_linear_interpolation: String,
    /// `catmullClark`, `smooth`.
    pub triangle_subdivision_rule: String,
    /// Point indices, crease after crease.
    pub crease_indices: Array<i32>,
    /// Points of each crease.
    pub crease_lengths: Array<i32>,
    /// One per crease, or one per edge; 10 and more: infinite.
    pub crease_sharpnesses: Array<f32>,
    /// Point indices.
    pub corner_indices: Array<i32>,
    pub corner_sharpnesses: Array<f32>,
}

impl Default for SubdivTags {
    fn default() -> Self {
        Self {
            interpolate_boundary: "edgeAndCorner".into(),
            face_varying_linear_interpolation: "cornersPlus1".into(),
            triangle_subdivision_rule: "catmullClark".into(),
            crease_indices: Array::default(),
            crease_lengths: Array::default(),
            crease_sharpnesses: Array::default(),
            corner_indices: Array::default(),
            corner_sharpnesses: Array::default(),
        }
    }
}

/// A polygon mesh: `UsdGeomMesh`, or an implicit prim that the bridge tessellated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Mesh {
    /// Local to world; with an instancer, local to the prototype root.
    pub transform: Matrix4d,
    pub visible: bool,
    pub double_sided: bool,
    pub orientation: Orientation,
    /// Object space, stage units.
    pub points: Array<[f32; 3]>,
    pub face_vertex_counts: Array<i32>,
    pub face_vertex_indices: Array<i32>,
    pub hole_indices: Array<i32>,
    /// `none`, `catmullClark`, `loop`, `bilinear`. Authored normals count for `none` only.
    pub subdivision_scheme: String,
    pub subdiv_tags: SubdivTags,
    /// Refinements of this mesh; `None`: those of the render settings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine_level: Option<u32>,
    pub normals: Option<Primvar<[f32; 3]>>,
    /// By name: those that the networks of its materials read.
    pub primvars: BTreeMap<String, AnyPrimvar>,
    pub display_color: Option<Primvar<[f32; 3]>>,
    pub display_opacity: Option<Primvar<f32>>,
    /// Where bodies with a medium overlap, the higher one fills the place; `None`: that of its materials.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub medium_priority: Option<i32>,
    /// Meshes of one name share one interior behind their diffuse boundaries; empty: that of this mesh alone.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub subsurface_set: String,
    /// Prim path of the bound material; empty: none.
    pub material: String,
    pub geom_subsets: Vec<GeomSubset>,
    /// Key of the [`Instancer`] that places this mesh; empty: placed once, by `transform`.
    pub instancer: String,
    /// Hydra's categories: of the collections that lights name ([`super::Light::light_link`]), those that it is in.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub categories: Vec<String>,
    /// Of `transform`; `None`: it stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform_keys: Option<TransformKeys>,
    /// Of `points`; `None`: they stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_keys: Option<PointKeys>,
}

impl Mesh {
    /// Empties what its geometry alone is compiled from. Of one that moves it stays: its ways are asked for again.
    pub fn let_go(&mut self) {
        if self.point_keys.is_none() {
            self.points = Array::default();
            (self.face_vertex_counts, self.face_vertex_indices) = (Array::default(), Array::default());
            self.normals = None;
        }
    }
}

impl Default for Mesh {
    fn default() -> Self {
        Self {
            transform: IDENTITY,
            visible: true,
            double_sided: false,
            orientation: Orientation::RightHanded,
            points: Array::default(),
            face_vertex_counts: Array::default(),
            face_vertex_indices: Array::default(),
            hole_indices: Array::default(),
            subdivision_scheme: "none".into(),
            subdiv_tags: SubdivTags::default(),
            refine_level: None,
            normals: None,
            primvars: BTreeMap::new(),
            display_color: None,
            display_opacity: None,
            medium_priority: None,
            subsurface_set: String::new(),
            material: String::new(),
            geom_subsets: Vec::new(),
            instancer: String::new(),
            categories: Vec::new(),
            transform_keys: None,
            point_keys: None,
        }
    }
}

/// One prototype's placements: native instances or a point instancer, nesting multiplied out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Instancer {
    pub visible: bool,
    /// Prototype root to world, one per instance.
    pub transforms: Array<Matrix4d>,
    /// One per instance, in place of the meshes' own; empty, and for instances with NaN: theirs.
    #[serde(skip_serializing_if = "is_empty")]
    pub display_color: Array<[f32; 3]>,
    /// Those that networks read, one value per instance in place of the meshes' own; NaN: theirs. Interpolation says
    /// nothing here.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub primvars: BTreeMap<String, AnyPrimvar>,
    /// Of `transforms`; `None`: they stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform_keys: Option<TransformKeys>,
}

fn is_empty(values: &Array<[f32; 3]>) -> bool {
    values.is_empty()
}

/// An image of a light, decoded by the bridge: linear Rec.709, row 0 at the top.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Texture {
    pub file: String,
    pub width: u32,
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Array<[f32; 3]>,
}

/// Channels interleaved, rows from the top.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "format", content = "values", rename_all = "camelCase")]
pub enum Texels {
    /// 255 is 1.
    U8(Array<u8>),
    /// 65535 is 1.
    U16(Array<u16>),
    /// IEEE half floats, by their bits.
    Half(Array<u16>),
    Float(Array<f32>),
}

impl Texels {
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) | Self::Half(values) => values.len(),
            Self::Float(values) => values.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values as they are in memory.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::U8(values) => values,
            Self::U16(values) | Self::Half(values) => bytemuck::cast_slice(values),
            Self::Float(values) => bytemuck::cast_slice(values),
        }
    }

    /// Map, and range in bytes, of values that are in a file.
    pub fn map(&self) -> Option<(&memmap2::Mmap, usize, usize)> {
        match self {
            Self::U8(values) => values.map(),
            Self::U16(values) | Self::Half(values) => values.map(),
            Self::Float(values) => values.map(),
        }
    }

    /// `len` values of this format from byte `offset` of a map on, a multiple of 64.
    pub fn mapped(&self, map: &std::sync::Arc<memmap2::Mmap>, offset: usize, len: usize) -> Self {
        let map = map.clone();
        match self {
            Self::U8(_) => Self::U8(Array::mapped(map, offset, len)),
            Self::U16(_) => Self::U16(Array::mapped(map, offset, len)),
            Self::Half(_) => Self::Half(Array::mapped(map, offset, len)),
            Self::Float(_) => Self::Float(Array::mapped(map, offset, len)),
        }
    }

    /// Bytes of one value.
    pub fn size(&self) -> usize {
        match self {
            Self::U8(_) => 1,
            Self::U16(_) | Self::Half(_) => 2,
            Self::Float(_) => 4,
        }
    }
}

/// An image that a material reads, in the numbers of its file: Rec.709 after `srgb` is undone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Image {
    pub file: String,
    pub width: u32,
    pub height: u32,
    /// 1: grey, 2: grey and alpha, 3: colour, 4: colour and alpha.
    pub channels: u32,
    /// Colours (not alpha) carry the transfer curve of IEC 61966-2-1.
    pub srgb: bool,
    /// `width * height * channels` values; empty where the file could not be read.
    pub texels: Texels,
    /// Why it could not be read.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub fault: String,
}

impl Default for Image {
    fn default() -> Self {
        Self {
            file: String::new(),
            width: 0,
            height: 0,
            channels: 1,
            srgb: false,
            texels: Texels::U8(Array::default()),
            fault: String::new(),
        }
    }
}

/// Prims by path. A `BTreeMap`, so that every walk over the scene has one order.
pub type Prims<T> = BTreeMap<String, T>;
