//! UsdPreviewSurface, after Storm's `previewSurface.glslfx` (26.11).
//!
//! Kept: Schlick with F0 = ((1 - ior) / (1 + ior))^2 or `specularColor`, GGX with alpha = roughness^2, Smith-Schlick
//! masking with k = alpha / 2, diffuse times 1 - F(wo . h), roughness floor 0.001, both workflows, both opacity modes.
//! Left out: the 0.001 that Storm adds to D and to the denominator against division by zero.
//! Changed, because Storm's sum reflects more than it gets: the clear coat is layered by albedo scaling, and the
//! diffuse term is scaled down where specular + diffuse would exceed 1 (bright colours at grazing angles); elsewhere
//! it is Storm's to the digit. In opacityMode `transparent` what passes is (1 - opacity) (1 - E_specular).
//!
//! With `subsurface` > 0 the base is the layered one of OpenPBR, with the same exact-Fresnel GGX specular lobe
//! (`useSpecularWorkflow` 0), so that one medium looks alike in all shaders.

use super::Bsdf;
use super::albedo::{Curve, cosine_mean};
use super::check::Check;
use super::curves::Curves;
use super::diffuse::Diffuse;
use super::fresnel::{Fresnel, f0, schlick_weight};
use super::ggx::Masking;
use super::interior::{Boundary, Interior, InteriorAlbedo, subsurface_radius};
use super::layered::{Description, Layered, Medium};
use super::lobe::Lobe;
use super::specular::Specular;
use super::surface::{Base, Coat, Surface};
use crate::flat::PreviewSurface;
use crate::math::Rgb;
use std::sync::LazyLock;

/// Storm's floor of both roughnesses.
const MIN_ROUGHNESS: f32 = 0.001;

/// Mean of 1 - F(wo . h) over a cosine-weighted hemisphere, for F0 = 0 and F90 = 1.
static BELOW: LazyLock<Curve> = LazyLock::new(|| Curve::tabulate(|mu| 1.0 - cosine_mean(mu, schlick_weight)));

/// The base without a medium: one specular lobe and Storm's diffuse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Storm {
    specular: Specular,
    fresnel: Fresnel,
    rho: Rgb,
    f0: Rgb,
    f90: Rgb,
    opacity: f32,
}

impl Storm {
    fn new(alpha: f32, f0: Rgb, f90: Rgb, rho: Rgb, opacity: f32, curves: &mut Curves) -> Self {
        let fresnel = Fresnel::Schlick { f0, f90 };
        let specular = Specular::new(alpha, fresnel, Masking::Storm, curves);
        Self { specular, fresnel, rho, f0, f90, opacity }
    }

    pub fn with_rho(&self, rho: Rgb) -> Self {
        Self { rho, ..*self }
    }

    pub fn push(&self, bsdf: &mut Bsdf, weight: Rgb) {
        let mu = bsdf.mu();
        let specular = self.specular.albedo(mu);
        let diffuse = self.diffuse_albedo(mu);
        bsdf.push(self.specular.lobe(mu), weight, specular);
        // 1e-6: a black diffuse has nothing to scale.
        let energy = ((Rgb::ONE - specular) / diffuse.max(Rgb::splat(1e-6))).min(Rgb::ONE);
        let lobe = Lobe::StormDiffuse { rho: self.rho, fresnel: self.fresnel };
        bsdf.push(lobe, weight * self.opacity * energy, diffuse);
        bsdf.push(Lobe::PassThrough, weight * self.transparency(mu), Rgb::ONE);
    }

    fn diffuse_albedo(&self, mu: f32) -> Rgb {
        let grazing = 1.0 - BELOW.at(mu);
        self.rho * (Rgb::ONE - self.f0.lerp(self.f90, grazing))
    }

    pub fn transparency(&self, mu: f32) -> Rgb {
        (1.0 - self.opacity) * (Rgb::ONE - self.specular.albedo(mu))
    }
}

/// Checked inputs in common.
struct Inputs {
    diffuse_color: Rgb,
    metallic: f32,
    alpha: f32,
    ior: f32,
    specular_workflow: bool,
    specular_color: Rgb,
    /// Of everything, and of the diffuse part.
    presence: f32,
    opacity: f32,
}

pub fn compile(
    m: &PreviewSurface,
    display_color: Option<Rgb>,
    display_opacity: f32,
    boundary_override: Option<Boundary>,
    curves: &mut Curves,
    check: &mut Check,
) -> Surface {
    let inputs = Inputs::new(m, display_color, display_opacity, check);
    let subsurface = check.unit("subsurface", m.subsurface, 0.0);
    let clearcoat = check.unit("clearcoat", m.clearcoat, 0.0);
    let coat_roughness = check.unit("clearcoatRoughness", m.clearcoat_roughness, 0.01).max(MIN_ROUGHNESS);
    let coat_fresnel = Fresnel::Schlick { f0: Rgb::splat(f0(inputs.ior)), f90: Rgb::ONE };
    let coat = Coat::new(clearcoat, Rgb::ONE, || {
        Specular::new(coat_roughness * coat_roughness, coat_fresnel, Masking::Storm, curves)
    });
    let emission = check.radiance("emissiveColor", m.emissive_color, Rgb::ZERO);
    let mut surface = Surface {
        emission,
        color: inputs.diffuse_color,
        presence: inputs.presence,
        coat,
        base: Base::Storm(inputs.storm(curves)),
        interior: None,
        takes_display_color: m.diffuse_color.is_none() && m.metallic == 0.0,
        scatters_within: false,
    };
    if subsurface > 0.0 {
        add_medium(&mut surface, m, &inputs, subsurface, boundary_override, curves, check);
    }
    surface
}

/// Replaces Storm's base by the layered one.
fn add_medium(
    surface: &mut Surface,
    m: &PreviewSurface,
    inputs: &Inputs,
    share: f32,
    boundary_override: Option<Boundary>,
    curves: &mut Curves,
    check: &mut Check,
) {
    let color = check.color("subsurfaceColor", m.subsurface_color, 0.8);
    surface.interior = interior(m, inputs, color, boundary_override, check);
    let medium = surface.interior.map(|interior| Medium { share, interior, transmit_tint: Rgb::ONE });
    let metal = Fresnel::Schlick { f0: inputs.diffuse_color, f90: inputs.diffuse_color };
    let description = Description {
        alpha: inputs.alpha,
        metalness: inputs.metallic,
        metal,
        specular: inputs.exact_fresnel(),
        specular_weight: 1.0,
        specular_tint: Rgb::ONE,
        diffuse: Diffuse::lambert(inputs.diffuse_color),
        stand_in: if medium.is_some() { (0.0, color) } else { (share, color) },
        medium,
        opacity: inputs.opacity,
    };
    surface.color = description.color();
    surface.base = Base::Layered(Layered::new(&description, curves));
}

/// The medium of dermis' subsurface inputs; `None` where its mean free path is 0.
fn interior(
    m: &PreviewSurface,
    inputs: &Inputs,
    color: Rgb,
    boundary_override: Option<Boundary>,
    check: &mut Check,
) -> Option<Interior> {
    let radius = check.radiance("subsurfaceRadius", m.subsurface_radius, Rgb::ONE);
    let scale = check.positive("subsurfaceScale", m.subsurface_scale, 1.0);
    let g = check.anisotropy("subsurfaceAnisotropy", m.subsurface_anisotropy);
    let single = m.subsurface_albedo.map(|albedo| check.color("subsurfaceAlbedo", albedo, 0.8));
    let authored = Boundary::from_token(&m.subsurface_boundary).unwrap_or_else(|| {
        check.warn(|| format!("inputs:subsurfaceBoundary `{}` is unknown; `diffuse` is used", m.subsurface_boundary));
        Boundary::Diffuse
    });
    let radius = subsurface_radius(radius * scale, "inputs:subsurfaceRadius * inputs:subsurfaceScale", check)?;
    let interior = Interior {
        boundary: authored,
        eta: inputs.ior,
        alpha: inputs.alpha,
        radius,
        albedo: single.map_or(InteriorAlbedo::Color(color), InteriorAlbedo::Single),
        g,
    };
    Some(interior.bounded(boundary_override.unwrap_or(authored)))
}

impl Inputs {
    fn new(m: &PreviewSurface, display_color: Option<Rgb>, display_opacity: f32, check: &mut Check) -> Self {
        let diffuse_color = match (m.diffuse_color, display_color) {
            (Some(color), _) => check.color("diffuseColor", color, 0.18),
            (None, Some(color)) => check.color("diffuseColor (primvars:displayColor)", color.into(), 0.18),
            (None, None) => Rgb::splat(0.18),
        };
        let opacity = opacity(m, display_opacity, check);
        let (presence, opacity) = if is_presence(m, check) { (opacity, 1.0) } else { (1.0, opacity) };
        let roughness = check.unit("roughness", m.roughness, 0.5).max(MIN_ROUGHNESS);
        Self {
            diffuse_color,
            metallic: check.unit("metallic", m.metallic, 0.0),
            alpha: roughness * roughness,
            ior: check.ior("ior", m.ior),
            specular_workflow: m.use_specular_workflow == 1,
            specular_color: check.color("specularColor", m.specular_color, 0.0),
            presence,
            opacity,
        }
    }

    /// Storm: `evaluateLight`.
    fn storm(&self, curves: &mut Curves) -> Storm {
        let (f0, f90, rho) = if self.specular_workflow {
            (self.specular_color, Rgb::ONE, self.diffuse_color)
        } else {
            let color = Rgb::ONE.lerp(self.diffuse_color, self.metallic);
            let f0 = (f0(self.ior) * color).lerp(color, self.metallic);
            (f0, color, self.diffuse_color * (1.0 - self.metallic))
        };
        Storm::new(self.alpha, f0, f90, rho, self.opacity, curves)
    }

    /// The specular lobe over a medium: exact, but for a `specularColor` there is only Schlick.
    fn exact_fresnel(&self) -> Fresnel {
        if self.specular_workflow {
            return Fresnel::Schlick { f0: self.specular_color, f90: Rgb::ONE };
        }
        Fresnel::Dielectric { eta: self.ior }
    }
}

/// Opacity after the threshold, which makes it 0 or 1; `displayOpacity` counts where `displayColor` does.
fn opacity(m: &PreviewSurface, display_opacity: f32, check: &mut Check) -> f32 {
    let mut opacity = check.unit("opacity", m.opacity, 1.0);
    if m.diffuse_color.is_none() {
        opacity *= check.unit("opacity (primvars:displayOpacity)", display_opacity, 1.0);
    }
    let threshold = check.unit("opacityThreshold", m.opacity_threshold, 0.0);
    if threshold > 0.0 { if opacity < threshold { 0.0 } else { 1.0 } } else { opacity }
}

/// A threshold is a cut-out of everything, whatever the mode.
fn is_presence(m: &PreviewSurface, check: &mut Check) -> bool {
    if !matches!(&*m.opacity_mode, "transparent" | "presence") {
        check.warn(|| format!("inputs:opacityMode `{}` is unknown; `transparent` is used", m.opacity_mode));
    }
    m.opacity_threshold > 0.0 || m.opacity_mode == "presence"
}
