//! The closed set of lobes a surface is a mixture of. Local directions with `wo.z > 0`.

use super::dielectric::Dielectric;
use super::diffuse::Diffuse;
use super::fresnel::Fresnel;
use super::ggx::Glossy;
use super::hair::Strand;
use super::{BsdfSample, Event};
use crate::math::{FRAC_1_PI, Rgb};
use crate::sampling::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};

/// One way a surface scatters; the weight it has in a surface is kept beside it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lobe {
    Diffuse(Diffuse),
    /// Lambert times 1 - F(wo . h), the diffuse term of Storm's `previewSurface.glslfx`. Reciprocal.
    StormDiffuse {
        rho: Rgb,
        fresnel: Fresnel,
    },
    Glossy(Glossy),
    Mirror(Fresnel),
    /// A dielectric boundary, rough or smooth.
    Interface(Dielectric),
    Strand(Strand),
    /// Lambertian entry into a medium with `Boundary::Diffuse`.
    Subsurface,
    /// Lambertian exit from one.
    Exit,
    /// The boundary of an index-matched medium.
    IndexMatched,
    /// What the surface is absent for (opacity).
    PassThrough,
}

impl Lobe {
    /// True where `eval` and `pdf` are 0 although light passes: single directions, and the entry into a walk.
    pub fn is_delta(&self) -> bool {
        match self {
            Self::Diffuse(_) | Self::StormDiffuse { .. } | Self::Glossy(_) | Self::Strand(_) | Self::Exit => false,
            Self::Interface(interface) => interface.is_smooth(),
            Self::Mirror(_) | Self::Subsurface | Self::IndexMatched | Self::PassThrough => true,
        }
    }

    /// Whether it is a diffuse one of a surface to layers and lights that tell lobes apart.
    pub fn is_diffuse(&self) -> bool {
        matches!(self, Self::Diffuse(_) | Self::StormDiffuse { .. })
    }

    /// Whether all of it stays on the side of `wo`.
    pub fn reflects(&self) -> bool {
        matches!(self, Self::Diffuse(_) | Self::StormDiffuse { .. } | Self::Glossy(_) | Self::Mirror(_))
    }

    /// f * |cos|.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Rgb {
        match self {
            Self::Diffuse(diffuse) => diffuse.eval(wo, wi),
            Self::StormDiffuse { rho, fresnel } => {
                let h = (wo + wi).try_normalize().unwrap_or(Vec3::Z); // wi = -wo has cosine pdf 0
                *rho * (Rgb::ONE - fresnel.at(wo.dot(h))) * cosine_hemisphere_pdf(wi.z)
            }
            Self::Glossy(glossy) => glossy.eval(wo, wi),
            Self::Interface(interface) => interface.eval(wo, wi),
            Self::Strand(strand) => Rgb::splat(strand.pdf(wi)),
            Self::Exit => Rgb::splat(cosine_hemisphere_pdf(-wi.z)),
            Self::Mirror(_) | Self::Subsurface | Self::IndexMatched | Self::PassThrough => Rgb::ZERO,
        }
    }

    /// Per solid angle, given that this lobe was chosen.
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        match self {
            Self::Diffuse(_) | Self::StormDiffuse { .. } => cosine_hemisphere_pdf(wi.z),
            Self::Glossy(glossy) => glossy.pdf(wo, wi),
            Self::Interface(interface) => interface.pdf(wo, wi),
            Self::Strand(strand) => strand.pdf(wi),
            Self::Exit => cosine_hemisphere_pdf(-wi.z),
            Self::Mirror(_) | Self::Subsurface | Self::IndexMatched | Self::PassThrough => 0.0,
        }
    }

    /// A direction by [`Lobe::pdf`], for lobes that are not delta.
    pub fn sample(&self, wo: Vec3, u_choice: f32, u: Vec2) -> Option<Vec3> {
        match self {
            Self::Diffuse(_) | Self::StormDiffuse { .. } => Some(cosine_hemisphere(u)),
            Self::Glossy(glossy) => glossy.sample(wo, u),
            Self::Interface(interface) => interface.sample(wo, u_choice, u),
            Self::Strand(strand) => Some(strand.sample(u_choice, u)),
            Self::Exit => Some(-cosine_hemisphere(u)),
            Self::Mirror(_) | Self::Subsurface | Self::IndexMatched | Self::PassThrough => None,
        }
    }

    /// The whole sample of a delta lobe: pdf is the probability of the direction (for [`Lobe::Subsurface`] the
    /// cosine density), and f / pdf its weight.
    pub fn sample_delta(&self, wo: Vec3, u_choice: f32, u: Vec2) -> Option<BsdfSample> {
        let sample = |wi, f, pdf, event| Some(BsdfSample { wi, f, pdf, event, delta: true });
        match self {
            Self::Mirror(fresnel) => sample(Vec3::new(-wo.x, -wo.y, wo.z), fresnel.at(wo.z), 1.0, Event::Reflect),
            Self::Interface(interface) => {
                let (wi, f, pdf) = interface.sample_smooth(wo, u_choice)?;
                sample(wi, f, pdf, if wi.z > 0.0 { Event::Reflect } else { Event::Transmit })
            }
            Self::Subsurface => {
                let wi = -cosine_hemisphere(u);
                let pdf = (-wi.z * FRAC_1_PI).max(f32::MIN_POSITIVE); // exactly grazing has density 0
                sample(wi, Rgb::splat(pdf), pdf, Event::EnterSubsurface)
            }
            Self::IndexMatched => sample(-wo, Rgb::ONE, 1.0, Event::Transmit),
            Self::PassThrough => sample(-wo, Rgb::ONE, 1.0, Event::PassThrough),
            Self::Diffuse(_) | Self::StormDiffuse { .. } | Self::Glossy(_) | Self::Strand(_) | Self::Exit => None,
        }
    }
}
