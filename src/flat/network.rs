//! What drives the inputs of a material: nodes in the words of UsdShade and MaterialX, compound ones taken apart.
//!
//! A node has four lanes; a float has the same number in all of them, so that lanes of every width mix. Nodes
//! read nodes before them only.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The nodes of one material.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Network {
    pub nodes: Vec<Node>,
    /// Input of the surface -> index of the node that drives it. `normal` is in tangent space, -1 to 1.
    pub inputs: BTreeMap<String, usize>,
    /// Primvar whose directions are the tangents of `normal`.
    pub tangents: String,
}

impl Network {
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty()
    }

    /// Names of the primvars that it reads.
    pub fn primvars(&self) -> impl Iterator<Item = &String> {
        self.nodes.iter().filter_map(|node| if let Node::Primvar { varname, .. } = node { Some(varname) } else { None })
    }

    /// Keys of the images that it reads.
    pub fn images(&self) -> impl Iterator<Item = &String> {
        let tiles =
            self.nodes.iter().filter_map(|node| if let Node::Image(image) = node { Some(&image.tiles) } else { None });
        tiles.flatten().map(|tile| &tile.image)
    }

    /// The same, to name them otherwise.
    pub fn images_mut(&mut self) -> impl Iterator<Item = &mut String> {
        let nodes = self.nodes.iter_mut();
        let tiles = nodes.filter_map(|node| if let Node::Image(image) = node { Some(&mut image.tiles) } else { None });
        tiles.flatten().map(|tile| &mut tile.image)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "node", rename_all = "camelCase")]
pub enum Node {
    Constant {
        value: [f32; 4],
    },
    /// `UsdPrimvarReader_*`, `ND_geompropvalue_*`, `ND_texcoord_*`: `fallback` where a mesh has no such primvar.
    Primvar {
        varname: String,
        fallback: [f32; 4],
    },
    Image(ImageNode),
    /// Lane by lane.
    Math {
        op: Op,
        args: Vec<usize>,
    },
    /// Lane i is lane `lanes[i]` of node `args[i]`: extract, combine, swizzle.
    Gather {
        args: [usize; 4],
        lanes: [usize; 4],
    },
}

/// `UsdUVTexture` before its scale and bias, or `ND_image_*`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ImageNode {
    /// One image everywhere with `udim` 0, else that of its square of texture space.
    pub tiles: Vec<Tile>,
    /// Node whose first lanes are s and t; (0, 0) is the lower left corner of an image.
    pub st: usize,
    pub wrap_s: Wrap,
    pub wrap_t: Wrap,
    /// What [`Wrap::Black`] shows beyond the image.
    pub border: [f32; 4],
    /// Where there is no image.
    pub fallback: [f32; 4],
    /// Nearest texel of the finest level.
    #[serde(default)]
    pub closest: bool,
}

/// Key of an image, and where it lies: UDIM, 1001 + u + 10 v.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tile {
    pub udim: u32,
    pub image: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub enum Wrap {
    Black,
    Clamp,
    #[default]
    Repeat,
    Mirror,
}

/// MaterialX's names; angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Op {
    Add,
    Subtract,
    Multiply,
    Divide,
    Modulo,
    Power,
    Min,
    Max,
    Atan2,
    Absval,
    Sign,
    Floor,
    Ceil,
    Round,
    Sqrt,
    Exp,
    Ln,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    /// a > b ? c : d
    IfGreater,
    /// a == b ? c : d
    IfEqual,
    RgbToHsv,
    HsvToRgb,
}

impl Op {
    pub fn arity(self) -> usize {
        use Op::*;
        match self {
            Add | Subtract | Multiply | Divide | Modulo | Power | Min | Max | Atan2 => 2,
            Absval | Sign | Floor | Ceil | Round | Sqrt | Exp | Ln | Sin | Cos | Tan | Asin | Acos | RgbToHsv
            | HsvToRgb => 1,
            IfGreater | IfEqual => 4,
        }
    }
}
