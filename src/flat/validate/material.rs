//! Materials: every input inside what its specification allows, named as its own shader spells it.

use super::report::{LARGEST, NOT_NEGATIVE, Report, UNIT};
use crate::{
    error::Warning,
    flat::{ChiangHair, Material, OpenPbrSurface, PreviewSurface, StandardSurface},
};
use std::ops::RangeInclusive;

/// Henyey-Greenstein is a delta at -1 and 1, and its sampling divides by zero there.
const ANISOTROPY: RangeInclusive<f32> = -0.99..=0.99;
/// No surface has an index outside, and its square is a float: Fresnel stays finite.
const IOR: RangeInclusive<f32> = 0.01..=100.0;

pub fn validate_material(path: &str, material: &mut Material, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    material.networks_mut().into_iter().for_each(|network| super::network::check_network(network, &mut report));
    match material {
        Material::UsdPreviewSurface(surface) => check_preview(surface, &mut report),
        Material::OpenPbr(surface) => check_open_pbr(surface, &mut report),
        Material::StandardSurface(surface) => check_standard(surface, &mut report),
        Material::Hair(hair) => check_hair(hair, &mut report),
    }
}

/// Clamps fields of `$surface` to `$range`, each under the name of its input.
macro_rules! clamp {
    ($report:ident, $surface:ident, $default:ident, $range:expr; $($field:ident $name:literal),* $(,)?) => {
        $($report.clamp(concat!("inputs:", $name), &mut $surface.$field, $range, $default.$field);)*
    };
}

/// An index of refraction of 0 or less says nothing: the default of the shader.
fn check_ior(name: &str, ior: &mut f32, default: f32, report: &mut Report) {
    report.positive(name, ior, default);
    report.clamp(name, ior, IOR, default);
}

fn check_preview(surface: &mut PreviewSurface, report: &mut Report) {
    let default = PreviewSurface::default();
    clamp!(report, surface, default, UNIT; specular_color "specularColor", metallic "metallic",
        roughness "roughness", clearcoat "clearcoat", clearcoat_roughness "clearcoatRoughness", opacity "opacity",
        opacity_threshold "opacityThreshold", subsurface "subsurface", subsurface_color "subsurfaceColor");
    clamp!(report, surface, default, NOT_NEGATIVE; emissive_color "emissiveColor",
        subsurface_radius "subsurfaceRadius", subsurface_scale "subsurfaceScale");
    clamp!(report, surface, default, ANISOTROPY; subsurface_anisotropy "subsurfaceAnisotropy");
    check_ior("inputs:ior", &mut surface.ior, default.ior, report);
    if let Some(color) = &mut surface.diffuse_color {
        // 0.18: the specification's default.
        report.clamp("inputs:diffuseColor", color, UNIT, [0.18; 3]);
    }
    if let Some(albedo) = &mut surface.subsurface_albedo {
        // No default in the shader; black scatters nothing.
        report.clamp("inputs:subsurfaceAlbedo", albedo, UNIT, [0.0; 3]);
    }
    let boundaries = ["diffuse", "dielectric", "indexMatched"];
    let boundary = &mut surface.subsurface_boundary;
    report.token("inputs:subsurfaceBoundary", boundary, &boundaries, &default.subsurface_boundary);
    report.token("inputs:opacityMode", &mut surface.opacity_mode, &["transparent", "presence"], &default.opacity_mode);
    if !(0..=1).contains(&surface.use_specular_workflow) {
        report
            .warn(format!("inputs:useSpecularWorkflow is {}, 0 is used; author 0 or 1", surface.use_specular_workflow));
        surface.use_specular_workflow = 0;
    }
}

fn check_open_pbr(surface: &mut OpenPbrSurface, report: &mut Report) {
    let default = OpenPbrSurface::default();
    clamp!(report, surface, default, UNIT; base_weight "base_weight", base_color "base_color",
        base_diffuse_roughness "base_diffuse_roughness", base_metalness "base_metalness",
        specular_color "specular_color", specular_roughness "specular_roughness",
        transmission_weight "transmission_weight", transmission_color "transmission_color",
        subsurface_weight "subsurface_weight", subsurface_color "subsurface_color",
        subsurface_radius_scale "subsurface_radius_scale", coat_weight "coat_weight", coat_color "coat_color",
        coat_roughness "coat_roughness", geometry_opacity "geometry_opacity");
    clamp!(report, surface, default, NOT_NEGATIVE; specular_weight "specular_weight",
        transmission_depth "transmission_depth", transmission_scatter "transmission_scatter",
        subsurface_radius "subsurface_radius", emission_luminance "emission_luminance",
        emission_color "emission_color");
    clamp!(report, surface, default, ANISOTROPY;
        transmission_scatter_anisotropy "transmission_scatter_anisotropy",
        subsurface_scatter_anisotropy "subsurface_scatter_anisotropy");
    check_ior("inputs:specular_ior", &mut surface.specular_ior, default.specular_ior, report);
    check_ior("inputs:coat_ior", &mut surface.coat_ior, default.coat_ior, report);
    check_emission("inputs:emission_luminance", &mut surface.emission_luminance, surface.emission_color, report);
}

fn check_standard(surface: &mut StandardSurface, report: &mut Report) {
    let default = StandardSurface::default();
    clamp!(report, surface, default, UNIT; base "base", base_color "base_color",
        diffuse_roughness "diffuse_roughness", metalness "metalness", specular "specular",
        specular_color "specular_color", specular_roughness "specular_roughness", transmission "transmission",
        transmission_color "transmission_color", subsurface "subsurface", subsurface_color "subsurface_color",
        coat "coat", coat_color "coat_color", coat_roughness "coat_roughness", opacity "opacity");
    clamp!(report, surface, default, NOT_NEGATIVE; transmission_depth "transmission_depth",
        transmission_scatter "transmission_scatter", subsurface_radius "subsurface_radius",
        subsurface_scale "subsurface_scale", emission "emission", emission_color "emission_color");
    clamp!(report, surface, default, ANISOTROPY;
        transmission_scatter_anisotropy "transmission_scatter_anisotropy",
        subsurface_anisotropy "subsurface_anisotropy");
    check_ior("inputs:specular_IOR", &mut surface.specular_ior, default.specular_ior, report);
    check_ior("inputs:coat_IOR", &mut surface.coat_ior, default.coat_ior, report);
    check_emission("inputs:emission", &mut surface.emission, surface.emission_color, report);
}

fn check_hair(hair: &mut ChiangHair, report: &mut Report) {
    let default = ChiangHair::default();
    clamp!(report, hair, default, UNIT; cuticle_angle "cuticle_angle", opacity "opacity");
    clamp!(report, hair, default, 0.0..=100.0; roughness_r "roughness_R", roughness_tt "roughness_TT",
        roughness_trt "roughness_TRT");
    clamp!(report, hair, default, NOT_NEGATIVE; tint_r "tint_R", tint_tt "tint_TT", tint_trt "tint_TRT",
        absorption_coefficient "absorption_coefficient");
    check_ior("inputs:ior", &mut hair.ior, default.ior, report);
}

/// Weight and colour may each be in range and their product not.
fn check_emission(name: &str, weight: &mut f32, color: [f32; 3], report: &mut Report) {
    if color.into_iter().any(|channel| *weight * channel > LARGEST) {
        report.warn(format!("{name} times the emission colour is beyond {LARGEST:e}, 0 is used; author less"));
        *weight = 0.0;
    }
}
