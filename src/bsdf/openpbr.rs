//! OpenPBR Surface 1.1.
//!
//! As specified: mixture of metal (F82-tint), translucent base, subsurface and EON diffuse under one dielectric lobe
//! whose index `specular_weight` modulates; coat by coverage, with its effect on the index and roughness below.
//! Left out: coat darkening, the angle in the coat's absorption, anisotropy, fuzz, thin film, dispersion. Emission:
//! a nit is one unit of radiance. Subsurface has `Boundary::Diffuse` unless overridden. A material has one medium:
//! with transmission, the subsurface share is Lambertian.

use super::check::Check;
use super::curves::Curves;
use super::diffuse::Diffuse;
use super::fresnel::{Fresnel, f0, modulated_eta};
use super::ggx::Masking;
use super::interior::{Boundary, subsurface_radius};
use super::layered::{Description, Layered, Medium};
use super::specular::Specular;
use super::surface::{Base, Coat, Surface};
use super::translucent::{self, Shell, Transmission, translucent};
use crate::flat::OpenPbrSurface;
use crate::math::Rgb;

pub fn compile(
    m: &OpenPbrSurface,
    boundary_override: Option<Boundary>,
    curves: &mut Curves,
    check: &mut Check,
) -> Surface {
    let coat_weight = check.unit("coat_weight", m.coat_weight, 0.0);
    let coat_color = check.color("coat_color", m.coat_color, 1.0);
    let coat_roughness = check.unit("coat_roughness", m.coat_roughness, 0.0);
    let coat_ior = check.ior("coat_ior", m.coat_ior);
    let emission = check.radiance("emission_color", m.emission_color, Rgb::ONE)
        * check.positive("emission_luminance", m.emission_luminance, 0.0);

    let coat = Coat::new(coat_weight, coat_color, || {
        let fresnel = Fresnel::Dielectric { eta: coat_ior };
        Specular::new(coat_roughness * coat_roughness, fresnel, Masking::Smith, curves)
    });
    let description = describe(m, [coat_weight, coat_roughness, coat_ior], boundary_override, check);
    Surface {
        emission: emission * under_coat(coat_weight, coat_color, coat_ior),
        color: description.color(),
        presence: check.unit("geometry_opacity", m.geometry_opacity, 1.0),
        coat,
        base: Base::Layered(Layered::new(&description, curves)),
        interior: description.medium.map(|medium| medium.interior),
        takes_display_color: false,
        scatters_within: false,
    }
}

/// What a coat leaves of emission, at normal incidence.
pub fn under_coat(weight: f32, color: Rgb, ior: f32) -> Rgb {
    Rgb::ONE.lerp(color * (1.0 - f0(ior)), weight)
}

fn describe(
    m: &OpenPbrSurface,
    [coat_weight, coat_roughness, coat_ior]: [f32; 3],
    boundary_override: Option<Boundary>,
    check: &mut Check,
) -> Description {
    let roughness = check.unit("specular_roughness", m.specular_roughness, 0.3);
    let roughness = coated_roughness(roughness, coat_roughness, coat_weight);
    let alpha = roughness * roughness;
    let weight = check.positive("specular_weight", m.specular_weight, 1.0);
    let specular_color = check.color("specular_color", m.specular_color, 1.0);
    let ior = check.ior("specular_ior", m.specular_ior);
    let base = check.unit("base_weight", m.base_weight, 1.0) * check.color("base_color", m.base_color, 0.8);
    // A coat's own index hides the base's; beneath a denser coat the inverse ratio avoids total reflection
    // (OpenPBR 1.1, "Coat", and its MaterialX graph).
    let ratio = ior / (1.0 + (coat_ior - 1.0) * coat_weight);
    let reflecting = if coat_weight > 0.0 { ratio.max(ratio.recip()) } else { ratio };
    let eta = modulated_eta(ior, weight);
    let (medium, stand_in) = medium(m, Shell { eta, alpha, boundary: boundary_override }, check);
    Description {
        alpha,
        metalness: check.unit("base_metalness", m.base_metalness, 0.0),
        metal: Fresnel::f82_tint(base, specular_color, weight.min(1.0)),
        specular: Fresnel::Dielectric { eta: modulated_eta(reflecting, weight) },
        specular_weight: 1.0,
        specular_tint: specular_color,
        diffuse: Diffuse { rho: base, roughness: check.unit("base_diffuse_roughness", m.base_diffuse_roughness, 0.0) },
        stand_in,
        medium,
        opacity: 1.0,
    }
}

/// The coat scatters what it lets through (OpenPBR 1.1, "Coat", roughening).
fn coated_roughness(roughness: f32, coat: f32, weight: f32) -> f32 {
    let coated = (roughness.powi(4) + 2.0 * coat.powi(4)).min(1.0).powf(0.25);
    roughness + (coated - roughness) * weight
}

/// The one medium of the material, and the share and colour of what stands in for another.
fn medium(m: &OpenPbrSurface, shell: Shell, check: &mut Check) -> (Option<Medium>, (f32, Rgb)) {
    let transmission = check.unit("transmission_weight", m.transmission_weight, 0.0);
    let subsurface = check.unit("subsurface_weight", m.subsurface_weight, 0.0);
    let color = check.color("subsurface_color", m.subsurface_color, 0.8);
    let stand_in = ((1.0 - transmission) * subsurface, color);
    if transmission > 0.0 {
        if stand_in.0 > 0.0 {
            check
                .warn(|| "transmission_weight and subsurface_weight: subsurface is shaded as diffuse beside it".into());
        }
        let inputs = Transmission {
            color: m.transmission_color,
            depth: m.transmission_depth,
            scatter: m.transmission_scatter,
            anisotropy: m.transmission_scatter_anisotropy,
        };
        return (Some(translucent(inputs, transmission, shell, check)), stand_in);
    }
    if subsurface == 0.0 {
        return (None, (0.0, color));
    }
    let g = check.anisotropy("subsurface_scatter_anisotropy", m.subsurface_scatter_anisotropy);
    let scale = check.radiance("subsurface_radius_scale", m.subsurface_radius_scale, Rgb::new(1.0, 0.5, 0.25));
    let radius = check.positive("subsurface_radius", m.subsurface_radius, 1.0) * scale;
    let Some(radius) = subsurface_radius(radius, "inputs:subsurface_radius * inputs:subsurface_radius_scale", check)
    else {
        return (None, stand_in);
    };
    (Some(translucent::subsurface(subsurface, color, radius, g, shell)), (0.0, color))
}
