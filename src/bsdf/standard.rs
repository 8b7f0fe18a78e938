//! Autodesk Standard Surface 1.0.1, as its MaterialX graph lays it out.
//!
//! Metal is the artistic conductor of the graph (Gulbrandsen 2014, exact conductor Fresnel) from base colour and
//! `specular_color` * `specular`. `diffuse_roughness` is EON's sigma, which keeps energy, in place of the
//! qualitative Oren-Nayar. `specular` scales the lobe; for a dielectric boundary, where a scaled lobe would break
//! reciprocity, it scales the reflectance at normal incidence through the index as in OpenPBR. `opacity` counts by
//! its luminance. Left out: sheen, thin film, dispersion, anisotropy, `coat_affect_*`.

use super::check::Check;
use super::curves::Curves;
use super::diffuse::Diffuse;
use super::fresnel::{Fresnel, modulated_eta};
use super::ggx::Masking;
use super::interior::{Boundary, subsurface_radius};
use super::layered::{Description, Layered, Medium};
use super::openpbr::under_coat;
use super::specular::Specular;
use super::surface::{Base, Coat, Surface};
use super::translucent::{self, Shell, Transmission, translucent};
use crate::flat::StandardSurface;
use crate::math::{Rgb, luminance};

pub fn compile(
    m: &StandardSurface,
    boundary_override: Option<Boundary>,
    curves: &mut Curves,
    check: &mut Check,
) -> Surface {
    let coat_weight = check.unit("coat", m.coat, 0.0);
    let coat_color = check.color("coat_color", m.coat_color, 1.0);
    let coat_roughness = check.unit("coat_roughness", m.coat_roughness, 0.1);
    let coat_ior = check.ior("coat_IOR", m.coat_ior);
    let emission =
        check.radiance("emission_color", m.emission_color, Rgb::ONE) * check.positive("emission", m.emission, 0.0);
    let coat = Coat::new(coat_weight, coat_color, || {
        let fresnel = Fresnel::Dielectric { eta: coat_ior };
        Specular::new(coat_roughness * coat_roughness, fresnel, Masking::Smith, curves)
    });
    let description = describe(m, boundary_override, check);
    Surface {
        emission: emission * under_coat(coat_weight, coat_color, coat_ior),
        color: description.color(),
        presence: luminance(check.color("opacity", m.opacity, 1.0)).min(1.0),
        coat,
        base: Base::Layered(Layered::new(&description, curves)),
        interior: description.medium.map(|medium| medium.interior),
        takes_display_color: false,
        scatters_within: false,
    }
}

fn describe(m: &StandardSurface, boundary_override: Option<Boundary>, check: &mut Check) -> Description {
    let roughness = check.unit("specular_roughness", m.specular_roughness, 0.2);
    let alpha = roughness * roughness;
    let weight = check.unit("specular", m.specular, 1.0);
    let specular_color = check.color("specular_color", m.specular_color, 1.0);
    let ior = check.ior("specular_IOR", m.specular_ior);
    let base = check.unit("base", m.base, 1.0) * check.color("base_color", m.base_color, 0.8);
    let shell = Shell { eta: modulated_eta(ior, weight), alpha, boundary: boundary_override };
    let (medium, stand_in) = medium(m, shell, check);
    Description {
        alpha,
        metalness: check.unit("metalness", m.metalness, 0.0),
        metal: Fresnel::artistic_conductor(base, specular_color * weight),
        specular: Fresnel::Dielectric { eta: ior },
        specular_weight: weight,
        specular_tint: specular_color,
        diffuse: Diffuse { rho: base, roughness: check.unit("diffuse_roughness", m.diffuse_roughness, 0.0) },
        stand_in,
        medium,
        opacity: 1.0,
    }
}

/// The one medium of the material, and the share and colour of what stands in for another.
fn medium(m: &StandardSurface, shell: Shell, check: &mut Check) -> (Option<Medium>, (f32, Rgb)) {
    let transmission = check.unit("transmission", m.transmission, 0.0);
    let subsurface = check.unit("subsurface", m.subsurface, 0.0);
    let color = check.color("subsurface_color", m.subsurface_color, 1.0);
    let stand_in = ((1.0 - transmission) * subsurface, color);
    if transmission > 0.0 {
        if stand_in.0 > 0.0 {
            check.warn(|| "transmission and subsurface: subsurface is shaded as diffuse beside transmission".into());
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
    let g = check.anisotropy("subsurface_anisotropy", m.subsurface_anisotropy);
    let radius = check.radiance("subsurface_radius", m.subsurface_radius, Rgb::ONE);
    let scale = check.positive("subsurface_scale", m.subsurface_scale, 1.0);
    let name = "inputs:subsurface_radius * inputs:subsurface_scale";
    let Some(radius) = subsurface_radius(radius * scale, name, check) else {
        return (None, stand_in);
    };
    (Some(translucent::subsurface(subsurface, color, radius, g, shell)), (0.0, color))
}
