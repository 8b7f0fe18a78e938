//! Media as OpenPBR and Standard Surface describe them, which differ in names only.

use super::check::Check;
use super::interior::{Boundary, Interior, InteriorAlbedo, transmission};
use super::layered::Medium;
use crate::math::Rgb;

/// The dielectric around a medium.
#[derive(Debug, Clone, Copy)]
pub struct Shell {
    pub eta: f32,
    pub alpha: f32,
    /// Boundary that the render settings force on media.
    pub boundary: Option<Boundary>,
}

/// The transmission inputs, as authored.
#[derive(Debug, Clone, Copy)]
pub struct Transmission {
    pub color: [f32; 3],
    pub depth: f32,
    pub scatter: [f32; 3],
    pub anisotropy: f32,
}

/// A translucent base with the share `share`: clear glass, coloured glass or a scattering dielectric.
pub fn translucent(m: Transmission, share: f32, shell: Shell, check: &mut Check) -> Medium {
    let color = check.color("transmission_color", m.color, 1.0);
    let depth = check.positive("transmission_depth", m.depth, 0.0);
    let scatter = check.radiance("transmission_scatter", m.scatter, Rgb::ZERO);
    let g = check.anisotropy("transmission_scatter_anisotropy", m.anisotropy);
    let (radius, albedo) = transmission(color, depth, scatter);
    let transmit_tint = if depth == 0.0 { color } else { Rgb::ONE };
    let Shell { eta, alpha, boundary } = shell;
    let interior = Interior { boundary: Boundary::Dielectric, eta, alpha, radius, albedo, g };
    let boundary = boundary.filter(|_| !interior.is_clear()).unwrap_or(Boundary::Dielectric);
    Medium { share, interior: interior.bounded(boundary), transmit_tint }
}

/// Subsurface with the share `share`: a diffuse boundary, as production renderers treat it.
pub fn subsurface(share: f32, color: Rgb, radius: Rgb, g: f32, shell: Shell) -> Medium {
    let Shell { eta, alpha, boundary } = shell;
    let boundary = boundary.unwrap_or(Boundary::Diffuse);
    let interior = Interior { boundary, eta, alpha, radius, albedo: InteriorAlbedo::Color(color), g };
    Medium { share, interior: interior.bounded(boundary), transmit_tint: Rgb::ONE }
}
