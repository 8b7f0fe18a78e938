//! A compiled material: the constants a vertex needs, and the layers above the base that all shaders share.

use super::albedo::Curve;
use super::check::Check;
use super::curves::{Curves, Key};
use super::dielectric::{Dielectric, Interface};
use super::hair::{self, Hair};
use super::interior::{Boundary, Interior};
use super::layered::Layered;
use super::lobe::Lobe;
use super::preview::Storm;
use super::specular::Specular;
use super::{Bsdf, Side, openpbr, preview, standard};
use crate::error::Warning;
use crate::flat::Material;
use crate::math::Rgb;
use glam::Vec3;

/// A clear layer on top, with a coverage; below it everything is tinted by `tint` (constant over angle: the longer
/// way of slanted light through the coat, and light reflected down again by it, are left out).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coat {
    pub weight: f32,
    pub tint: Rgb,
    pub specular: Specular,
}

impl Coat {
    /// `None` without coverage.
    pub fn new(weight: f32, tint: Rgb, specular: impl FnOnce() -> Specular) -> Option<Self> {
        (weight > 0.0).then(|| Self { weight, tint, specular: specular() })
    }

    /// Share left for what is below, seen under the cosine `mu`.
    fn below(&self, mu: f32) -> Rgb {
        (Rgb::ONE - self.weight * self.specular.albedo(mu)) * Rgb::ONE.lerp(self.tint, self.weight)
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
// A scene has few surfaces; a box would cost every vertex a cache line.
#[allow(clippy::large_enum_variant)]
pub enum Base {
    /// UsdPreviewSurface without a medium.
    Storm(Storm),
    Layered(Layered),
    Hair(Hair),
}

/// A compiled material. Constants only; copying it is two kilobytes, so it is passed by reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Radiance, both sides.
    pub(super) emission: Rgb,
    /// Colour for the albedo AOV.
    pub(super) color: Rgb,
    /// 1 - share of the whole surface that is absent.
    pub(super) presence: f32,
    pub(super) coat: Option<Coat>,
    pub(super) base: Base,
    pub(super) interior: Option<Interior>,
    /// The diffuse colour is the mesh's.
    pub(super) takes_display_color: bool,
    /// Of the interior, set once that is known.
    pub(super) scatters_within: bool,
}

/// What a surface takes from elsewhere than its material.
#[derive(Debug, Clone, Copy)]
pub struct OfMesh {
    pub display_color: Option<Rgb>,
    pub display_opacity: f32,
    pub boundary_override: Option<Boundary>,
}

/// Albedo curves that a surface was compiled with.
#[derive(Debug, Clone)]
pub struct NotedCurves(Vec<(Key, Curve)>);

impl Surface {
    /// Compiles `material`. `display_color` and `display_opacity` are the mesh's and stand in for a
    /// UsdPreviewSurface whose `diffuseColor` is not authored. `boundary_override` replaces the boundary of every
    /// medium that scatters or absorbs. Inputs out of range are clamped, NaN and infinity replaced by the default,
    /// with a warning that names `prim` (the material's path) and the input.
    pub fn compile(
        material: &Material,
        display_color: Option<Rgb>,
        display_opacity: f32,
        boundary_override: Option<Boundary>,
        prim: &str,
        warnings: &mut Vec<Warning>,
    ) -> Self {
        let mut check = Check { prim, warnings: Some(warnings) };
        let mut noted = Vec::new();
        let mesh = OfMesh { display_color, display_opacity, boundary_override };
        Self::with_curves(material, mesh, &mut Curves::Exact(&mut noted), &mut check)
    }

    /// As [`Self::compile`], with the curves it used.
    pub fn compile_noting(
        material: &Material,
        mesh: OfMesh,
        prim: &str,
        warnings: &mut Vec<Warning>,
    ) -> (Self, NotedCurves) {
        let mut noted = Vec::new();
        let mut check = Check { prim, warnings: Some(warnings) };
        let surface = Self::with_curves(material, mesh, &mut Curves::Exact(&mut noted), &mut check);
        (surface, NotedCurves(noted))
    }

    /// As [`Self::compile`], for numbers of one surface point: quick, without allocations or a word about what is
    /// clamped. Curves that were not noted come from a grid.
    pub fn at_point(material: &Material, mesh: OfMesh, noted: &NotedCurves) -> Self {
        let mut check = Check { prim: "", warnings: None };
        Self::with_curves(material, mesh, &mut Curves::Known(&noted.0), &mut check)
    }

    fn with_curves(material: &Material, mesh: OfMesh, curves: &mut Curves, check: &mut Check) -> Self {
        let OfMesh { display_color, display_opacity, boundary_override } = mesh;
        let surface = match material {
            Material::UsdPreviewSurface(m) => {
                preview::compile(m, display_color, display_opacity, boundary_override, curves, check)
            }
            Material::OpenPbr(m) => openpbr::compile(m, boundary_override, curves, check),
            Material::StandardSurface(m) => standard::compile(m, boundary_override, curves, check),
            Material::Hair(m) => hair::compile(m, check),
        };
        Self { scatters_within: surface.interior.is_some_and(|interior| interior.scatters()), ..surface }
    }

    /// The medium behind the surface.
    pub fn interior(&self) -> Option<Interior> {
        self.interior
    }

    /// Emitted radiance, the same in every direction on both sides; already dimmed by a coat.
    pub fn emission(&self) -> Rgb {
        self.presence * self.emission
    }

    /// This surface with `color` for its `displayColor`, where that varies over the mesh; `None` where the material
    /// says its own colour (or is a metal or a medium, which take the mesh's constant one).
    pub fn with_display_color(&self, color: Rgb) -> Option<Self> {
        let Base::Storm(storm) = &self.base else { return None };
        self.takes_display_color.then(|| Self { color, base: Base::Storm(storm.with_rho(color)), ..*self })
    }

    /// Colour for the albedo AOV.
    pub fn albedo(&self) -> Rgb {
        self.color
    }

    /// Share of light that goes straight through (opacity) at the absolute cosine `mu`: what a shadow ray keeps, and
    /// exactly the weight of `Event::PassThrough`. 0 opaque, 1 invisible. Depends on `mu` only in opacityMode
    /// `transparent`, where the specular lobe stays and takes its share.
    pub fn transparency(&self, mu: f32) -> Rgb {
        let base = match &self.base {
            Base::Storm(storm) => storm.transparency(mu),
            Base::Layered(layered) => layered.transparency(mu),
            Base::Hair(_) => Rgb::ZERO,
        };
        let coat = self.coat.map_or(Rgb::ONE, |coat| coat.below(mu));
        Rgb::splat(1.0 - self.presence) + self.presence * coat * base
    }

    /// True where [`Surface::transparency`] is 0 at every angle.
    pub fn is_opaque(&self) -> bool {
        self.transparency(1.0) == Rgb::ZERO
    }

    /// The mixture seen along `wo` (unit, away from the vertex; local, z = normal to the outside of the object).
    /// With `Side::Inside` it is the boundary seen from the medium: opacity, metal and coat are not there. Without a
    /// medium the object is two-sided: both hemispheres of `wo` shade alike, whatever `side` says.
    pub fn bsdf(&self, wo: Vec3, side: Side) -> Bsdf {
        match self.interior {
            Some(interior) if side == Side::Inside => self.inside(wo, interior),
            _ => self.outside(wo),
        }
    }

    pub fn is_hair(&self) -> bool {
        matches!(self.base, Base::Hair(_))
    }

    /// As [`Self::bsdf`], in surroundings of the index `beside`.
    pub fn bsdf_beside(&self, wo: Vec3, side: Side, beside: f32) -> Bsdf {
        match &self.base {
            Base::Layered(layered) if beside != 1.0 && layered.interface().is_some() => {
                Self { base: Base::Layered(layered.beside(beside)), ..*self }.bsdf(wo, side)
            }
            _ => self.bsdf(wo, side),
        }
    }

    /// Index of the inside / index of the outside and tint of a boundary that refracts into single directions.
    pub fn smooth_interface(&self) -> Option<(f32, Rgb)> {
        let Base::Layered(layered) = &self.base else { return None };
        let interface = layered.interface().filter(|interface| interface.is_smooth())?;
        Some((interface.eta, interface.transmit_tint))
    }

    /// The facets of a boundary that refracts into lobes, from outside, where the index is `beside`: neither tinted nor
    /// compensated.
    pub fn rough_interface(&self, beside: f32) -> Option<Dielectric> {
        let Base::Layered(layered) = &self.base else { return None };
        let Interface { eta, alpha, .. } = *layered.interface()?;
        let facets = Dielectric { eta: eta / beside, ..Dielectric::bare(alpha) };
        (!facets.is_smooth()).then_some(facets)
    }

    fn outside(&self, wo: Vec3) -> Bsdf {
        let mut bsdf = Bsdf::new(wo);
        let mu = bsdf.mu();
        bsdf.push(Lobe::PassThrough, Rgb::splat(1.0 - self.presence), Rgb::ONE);
        let mut weight = Rgb::splat(self.presence);
        if let Some(coat) = self.coat {
            bsdf.push(coat.specular.lobe(mu), weight * coat.weight, coat.specular.albedo(mu));
            weight *= coat.below(mu);
        }
        match &self.base {
            Base::Storm(storm) => storm.push(&mut bsdf, weight),
            Base::Layered(layered) => layered.push(&mut bsdf, weight),
            Base::Hair(hair) => hair.push(&mut bsdf, weight),
        }
        bsdf.normalized()
    }

    fn inside(&self, wo: Vec3, interior: Interior) -> Bsdf {
        let mut bsdf = Bsdf::new(wo);
        let lobe = match (interior.boundary, &self.base) {
            (Boundary::Diffuse, _) => return Bsdf::exit(wo),
            (Boundary::Dielectric, Base::Layered(layered)) => {
                layered.interface().map(|i| Lobe::Interface(i.inside(bsdf.mu())))
            }
            _ => None,
        };
        bsdf.push(lobe.unwrap_or(Lobe::IndexMatched), Rgb::ONE, Rgb::ONE);
        bsdf.leaves = self.scatters_within;
        bsdf.normalized()
    }
}
