//! Materials as authored: the surface shader's inputs under their own names; what drives some of them is a
//! [`Network`].

use super::Network;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A bound material. Inputs that are not authored have the default of their specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shader")]
pub enum Material {
    UsdPreviewSurface(PreviewSurface),
    #[serde(rename = "ND_open_pbr_surface_surfaceshader")]
    OpenPbr(OpenPbrSurface),
    #[serde(rename = "ND_standard_surface_surfaceshader")]
    StandardSurface(StandardSurface),
    #[serde(rename = "ND_chiang_hair_bsdf")]
    Hair(ChiangHair),
}

impl Material {
    /// What drives inputs.
    pub fn network(&self) -> &Network {
        match self {
            Self::UsdPreviewSurface(m) => &m.network,
            Self::OpenPbr(m) => &m.network,
            Self::StandardSurface(m) => &m.network,
            Self::Hair(m) => &m.network,
        }
    }

    /// Of its medium, where bodies overlap; the shaders of MaterialX have no word for it.
    pub fn priority(&self) -> i32 {
        match self {
            Self::UsdPreviewSurface(m) => m.subsurface_priority,
            Self::OpenPbr(_) | Self::StandardSurface(_) | Self::Hair(_) => 0,
        }
    }

    /// Its only input is `displacement`: the way along the normal, object units. Empty: none.
    pub fn displacement(&self) -> &Network {
        match self {
            Self::UsdPreviewSurface(m) => &m.displacement,
            Self::OpenPbr(m) => &m.displacement,
            Self::StandardSurface(m) => &m.displacement,
            Self::Hair(m) => &m.displacement,
        }
    }

    /// What drives inputs, and what displaces.
    pub fn networks_mut(&mut self) -> [&mut Network; 2] {
        match self {
            Self::UsdPreviewSurface(m) => [&mut m.network, &mut m.displacement],
            Self::OpenPbr(m) => [&mut m.network, &mut m.displacement],
            Self::StandardSurface(m) => [&mut m.network, &mut m.displacement],
            Self::Hair(m) => [&mut m.network, &mut m.displacement],
        }
    }
}

impl Default for Material {
    fn default() -> Self {
        Self::UsdPreviewSurface(PreviewSurface::default())
    }
}

/// `UsdPreviewSurface` (26.11), and dermis' subsurface inputs in its style.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct PreviewSurface {
    /// `None`: not authored, so `displayColor` of the mesh (or 0.18) is used.
    pub diffuse_color: Option<[f32; 3]>,
    pub emissive_color: [f32; 3],
    pub use_specular_workflow: i32,
    pub specular_color: [f32; 3],
    pub metallic: f32,
    pub roughness: f32,
    pub clearcoat: f32,
    pub clearcoat_roughness: f32,
    pub opacity: f32,
    /// `transparent` or `presence`.
    pub opacity_mode: Cow<'static, str>,
    pub opacity_threshold: f32,
    pub ior: f32,
    /// Weight of the medium against the diffuse base, 0..1.
    pub subsurface: f32,
    /// Multiple-scattering albedo.
    pub subsurface_color: [f32; 3],
    /// Mean free path per channel, stage units.
    pub subsurface_radius: [f32; 3],
    pub subsurface_scale: f32,
    pub subsurface_anisotropy: f32,
    /// `diffuse`, `dielectric` or `indexMatched`.
    pub subsurface_boundary: Cow<'static, str>,
    /// Single-scattering albedo; overrides the inversion of `subsurface_color`.
    pub subsurface_albedo: Option<[f32; 3]>,
    /// Where bodies overlap, the higher one fills the place.
    pub subsurface_priority: i32,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub network: Network,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub displacement: Network,
}

impl Default for PreviewSurface {
    fn default() -> Self {
        Self {
            diffuse_color: None,
            emissive_color: [0.0; 3],
            use_specular_workflow: 0,
            specular_color: [0.0; 3],
            metallic: 0.0,
            roughness: 0.5,
            clearcoat: 0.0,
            clearcoat_roughness: 0.01,
            opacity: 1.0,
            opacity_mode: "transparent".into(),
            opacity_threshold: 0.0,
            ior: 1.5,
            subsurface: 0.0,
            subsurface_color: [0.8; 3],
            subsurface_radius: [1.0; 3],
            subsurface_scale: 1.0,
            subsurface_anisotropy: 0.0,
            subsurface_boundary: "diffuse".into(),
            subsurface_albedo: None,
            subsurface_priority: 0,
            network: Network::default(),
            displacement: Network::default(),
        }
    }
}

/// OpenPBR Surface 1.1: the parts dermis renders, named as in the specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct OpenPbrSurface {
    pub base_weight: f32,
    pub base_color: [f32; 3],
    pub base_diffuse_roughness: f32,
    pub base_metalness: f32,
    pub specular_weight: f32,
    pub specular_color: [f32; 3],
    pub specular_roughness: f32,
    pub specular_ior: f32,
    pub transmission_weight: f32,
    pub transmission_color: [f32; 3],
    pub transmission_depth: f32,
    pub transmission_scatter: [f32; 3],
    pub transmission_scatter_anisotropy: f32,
    pub subsurface_weight: f32,
    pub subsurface_color: [f32; 3],
    pub subsurface_radius: f32,
    pub subsurface_radius_scale: [f32; 3],
    pub subsurface_scatter_anisotropy: f32,
    pub coat_weight: f32,
    pub coat_color: [f32; 3],
    pub coat_roughness: f32,
    pub coat_ior: f32,
    pub emission_luminance: f32,
    pub emission_color: [f32; 3],
    pub geometry_opacity: f32,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub network: Network,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub displacement: Network,
}

impl Default for OpenPbrSurface {
    fn default() -> Self {
        Self {
            base_weight: 1.0,
            base_color: [0.8; 3],
            base_diffuse_roughness: 0.0,
            base_metalness: 0.0,
            specular_weight: 1.0,
            specular_color: [1.0; 3],
            specular_roughness: 0.3,
            specular_ior: 1.5,
            transmission_weight: 0.0,
            transmission_color: [1.0; 3],
            transmission_depth: 0.0,
            transmission_scatter: [0.0; 3],
            transmission_scatter_anisotropy: 0.0,
            subsurface_weight: 0.0,
            subsurface_color: [0.8; 3],
            subsurface_radius: 1.0,
            subsurface_radius_scale: [1.0, 0.5, 0.25],
            subsurface_scatter_anisotropy: 0.0,
            coat_weight: 0.0,
            coat_color: [1.0; 3],
            coat_roughness: 0.0,
            coat_ior: 1.6,
            emission_luminance: 0.0,
            emission_color: [1.0; 3],
            geometry_opacity: 1.0,
            network: Network::default(),
            displacement: Network::default(),
        }
    }
}

/// Autodesk Standard Surface 1.0.1 as MaterialX names it: the parts dermis renders.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StandardSurface {
    pub base: f32,
    pub base_color: [f32; 3],
    pub diffuse_roughness: f32,
    pub metalness: f32,
    pub specular: f32,
    pub specular_color: [f32; 3],
    pub specular_roughness: f32,
    #[serde(rename = "specular_IOR")]
    pub specular_ior: f32,
    pub transmission: f32,
    pub transmission_color: [f32; 3],
    pub transmission_depth: f32,
    pub transmission_scatter: [f32; 3],
    pub transmission_scatter_anisotropy: f32,
    pub subsurface: f32,
    pub subsurface_color: [f32; 3],
    pub subsurface_radius: [f32; 3],
    pub subsurface_scale: f32,
    pub subsurface_anisotropy: f32,
    pub coat: f32,
    pub coat_color: [f32; 3],
    pub coat_roughness: f32,
    #[serde(rename = "coat_IOR")]
    pub coat_ior: f32,
    pub emission: f32,
    pub emission_color: [f32; 3],
    pub opacity: [f32; 3],
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub network: Network,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub displacement: Network,
}

impl Default for StandardSurface {
    fn default() -> Self {
        Self {
            base: 1.0,
            base_color: [0.8; 3],
            diffuse_roughness: 0.0,
            metalness: 0.0,
            specular: 1.0,
            specular_color: [1.0; 3],
            specular_roughness: 0.2,
            specular_ior: 1.5,
            transmission: 0.0,
            transmission_color: [1.0; 3],
            transmission_depth: 0.0,
            transmission_scatter: [0.0; 3],
            transmission_scatter_anisotropy: 0.0,
            subsurface: 0.0,
            subsurface_color: [1.0; 3],
            subsurface_radius: [1.0; 3],
            subsurface_scale: 1.0,
            subsurface_anisotropy: 0.0,
            coat: 0.0,
            coat_color: [1.0; 3],
            coat_roughness: 0.1,
            coat_ior: 1.5,
            emission: 0.0,
            emission_color: [1.0; 3],
            opacity: [1.0; 3],
            network: Network::default(),
            displacement: Network::default(),
        }
    }
}

/// MaterialX 1.39 `chiang_hair_bsdf` behind a `surface`, whose opacity is the last. Roughness is (longitudinal variance,
/// azimuthal scale), as `chiang_hair_roughness` gives it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ChiangHair {
    #[serde(rename = "tint_R")]
    pub tint_r: [f32; 3],
    #[serde(rename = "tint_TT")]
    pub tint_tt: [f32; 3],
    #[serde(rename = "tint_TRT")]
    pub tint_trt: [f32; 3],
    pub ior: f32,
    #[serde(rename = "roughness_R")]
    pub roughness_r: [f32; 2],
    #[serde(rename = "roughness_TT")]
    pub roughness_tt: [f32; 2],
    #[serde(rename = "roughness_TRT")]
    pub roughness_trt: [f32; 2],
    /// Tilt of the scales: 0 to 1 is -90 to 90 degrees, above 0.5 towards the root.
    pub cuticle_angle: f32,
    /// Per radius of the strand.
    pub absorption_coefficient: [f32; 3],
    pub opacity: f32,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub network: Network,
    #[serde(skip_serializing_if = "Network::is_empty")]
    pub displacement: Network,
}

impl Default for ChiangHair {
    fn default() -> Self {
        Self {
            tint_r: [1.0; 3],
            tint_tt: [1.0; 3],
            tint_trt: [1.0; 3],
            ior: 1.55,
            roughness_r: [0.1; 2],
            roughness_tt: [0.05; 2],
            roughness_trt: [0.2; 2],
            cuticle_angle: 0.5,
            absorption_coefficient: [0.0; 3],
            opacity: 1.0,
            network: Network::default(),
            displacement: Network::default(),
        }
    }
}
