//! The layered base of OpenPBR, Standard Surface, and UsdPreviewSurface with a medium:
//!
//! metal | dielectric interface with a medium | specular over (diffuse, stand-in, medium, nothing),
//!
//! where `|` is a mixture by area. Beneath the specular lobe everything has 1 - E(wo).

use super::Bsdf;
use super::curves::Curves;
use super::dielectric::Interface;
use super::diffuse::Diffuse;
use super::fresnel::Fresnel;
use super::ggx::Masking;
use super::interior::{Boundary, Interior, InteriorAlbedo};
use super::lobe::Lobe;
use super::specular::Specular;
use crate::math::Rgb;

/// A medium and the share of the dielectric base that leads into it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Medium {
    pub share: f32,
    pub interior: Interior,
    /// Colour of every crossing of a dielectric boundary.
    pub transmit_tint: Rgb,
}

/// Checked numbers of a shader, in common words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Description {
    /// GGX alpha of specular, metal and interface.
    pub alpha: f32,
    pub metalness: f32,
    pub metal: Fresnel,
    pub specular: Fresnel,
    /// Factor of the specular lobe that the layers below also feel.
    pub specular_weight: f32,
    /// Colour of the specular lobe that they do not feel.
    pub specular_tint: Rgb,
    pub diffuse: Diffuse,
    /// Share and colour of a Lambertian surface in place of a medium that is opaque.
    pub stand_in: (f32, Rgb),
    pub medium: Option<Medium>,
    /// 1 - the share of what is below the specular lobe that is absent.
    pub opacity: f32,
}

impl Description {
    /// Colour for the albedo AOV; a medium without an authored colour counts as white.
    pub fn color(&self) -> Rgb {
        let (share, medium) = self.medium.map_or((0.0, Rgb::ZERO), |m| match m.interior.albedo {
            InteriorAlbedo::Color(color) => (m.share, color),
            InteriorAlbedo::Single(_) => (m.share, m.transmit_tint),
        });
        let (stand_in, color) = self.stand_in;
        let base = self.diffuse.rho * (1.0 - share - stand_in).max(0.0) + medium * share + color * stand_in;
        base.lerp(self.metal.at(1.0), self.metalness)
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layered {
    metal: Option<(f32, Specular)>,
    interface: Option<(f32, Interface)>,
    specular: Option<Specular>,
    specular_weight: f32,
    specular_tint: Rgb,
    diffuse: Diffuse,
    diffuse_share: f32,
    stand_in: (f32, Rgb),
    /// Entry through `Boundary::Diffuse` or `Boundary::IndexMatched`.
    entry: Option<(f32, Lobe)>,
    through: f32,
}

impl Layered {
    pub fn new(d: &Description, curves: &mut Curves) -> Self {
        let share = d.medium.map_or(0.0, |m| m.share);
        let boundary = d.medium.map(|m| m.interior.boundary);
        let entry = match boundary {
            Some(Boundary::Diffuse) => Some((share, Lobe::Subsurface)),
            Some(Boundary::IndexMatched) => Some((share, Lobe::IndexMatched)),
            Some(Boundary::Dielectric) | None => None,
        };
        let interface = d.medium.filter(|m| m.interior.boundary == Boundary::Dielectric).map(|m| {
            let Interior { eta, alpha, .. } = m.interior;
            (m.share, Interface::new(eta, alpha, d.specular_tint, m.transmit_tint, curves))
        });
        // An interface everywhere leaves nothing to wear a lobe of its own.
        let bare =
            boundary == Some(Boundary::IndexMatched) || interface.is_some_and(|(share, _)| share * d.opacity == 1.0);
        let has_specular = d.specular_weight > 0.0 && !bare;
        Self {
            metal: (d.metalness > 0.0).then(|| (d.metalness, Specular::new(d.alpha, d.metal, Masking::Smith, curves))),
            interface,
            specular: has_specular.then(|| Specular::new(d.alpha, d.specular, Masking::Smith, curves)),
            specular_weight: d.specular_weight,
            specular_tint: d.specular_tint,
            diffuse: d.diffuse,
            diffuse_share: (1.0 - share - d.stand_in.0).max(0.0),
            stand_in: d.stand_in,
            entry,
            through: 1.0 - d.opacity,
        }
    }

    /// Adds the lobes seen from outside to `bsdf`; `weight` is what the layers above leave.
    pub fn push(&self, bsdf: &mut Bsdf, weight: Rgb) {
        let mu = bsdf.mu();
        if let Some((share, metal)) = self.metal {
            bsdf.push(metal.lobe(mu), weight * share, metal.albedo(mu));
        }
        let dielectric = weight * (1.0 - self.metalness());
        if let Some((share, interface)) = self.interface {
            bsdf.push(Lobe::Interface(interface.outside(mu)), dielectric * share * (1.0 - self.through), Rgb::ONE);
        }
        // Over an interface the specular lobe is part of it: only the other shares wear this one.
        let opaque = dielectric * self.opaque();
        if let Some(specular) = self.specular {
            let weight = opaque * self.specular_tint * self.specular_weight;
            bsdf.push(specular.lobe(mu), weight, specular.albedo(mu));
        }
        self.push_below(bsdf, dielectric * self.below_specular(mu));
    }

    /// Diffuse, stand-in, entry and what is absent, as shares of the dielectric base.
    fn push_below(&self, bsdf: &mut Bsdf, weight: Rgb) {
        let present = weight * (1.0 - self.through);
        let (share, color) = self.stand_in;
        bsdf.push(Lobe::Diffuse(self.diffuse), present * self.diffuse_share, self.diffuse.rho);
        bsdf.push(Lobe::Diffuse(Diffuse::lambert(color)), present * share, color);
        if let Some((share, lobe)) = self.entry {
            bsdf.push(lobe, present * share, Rgb::ONE);
        }
        bsdf.push(Lobe::PassThrough, weight * self.through, Rgb::ONE);
    }

    /// The same where the outside has the index `beside`, not 1: for the interface. Specular lobes over a diffuse boundary
    /// or an opaque base keep the reflectance that they have in air.
    pub fn beside(&self, beside: f32) -> Self {
        Self { interface: self.interface.map(|(share, interface)| (share, interface.beside(beside))), ..*self }
    }

    /// Share that goes straight through at the cosine `mu`.
    pub fn transparency(&self, mu: f32) -> Rgb {
        (1.0 - self.metalness()) * self.through * self.below_specular(mu)
    }

    /// The boundary from inside, for `Boundary::Dielectric`.
    pub fn interface(&self) -> Option<&Interface> {
        self.interface.as_ref().map(|(_, interface)| interface)
    }

    fn metalness(&self) -> f32 {
        self.metal.map_or(0.0, |(share, _)| share)
    }

    /// Share of the dielectric base that is not an interface.
    fn opaque(&self) -> f32 {
        1.0 - self.interface.map_or(0.0, |(share, _)| share) * (1.0 - self.through)
    }

    /// 1 - E of the specular lobe.
    fn below_specular(&self, mu: f32) -> Rgb {
        let reflected = self.specular.map_or(Rgb::ZERO, |s| s.albedo(mu));
        Rgb::ONE - self.specular_weight * reflected
    }
}
