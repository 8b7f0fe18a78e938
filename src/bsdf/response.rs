//! By which lobes light goes on its way: what layers of an image and lights with `inputs:diffuse` or `inputs:specular`
//! tell apart.

use super::Bsdf;
use super::lobe::Lobe;
use crate::math::Rgb;
use glam::Vec3;

/// How a vertex has turned light into the direction that it goes on in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Response {
    /// The share of the diffuse lobes, per channel; the rest is that of glossy ones, mirrors and hair.
    Reflected { diffuse: Rgb },
    /// Through the boundary of what does not scatter.
    Transmitted,
    /// Out of a medium that scatters, or from one of its collisions.
    Scattered,
}

impl Response {
    /// What of a light it takes that shines `diffuse` on diffuse lobes and media and `specular` on the others, and how what
    /// it takes has come.
    pub fn to(self, [diffuse, specular]: [f32; 2]) -> (Rgb, Self) {
        match self {
            Self::Reflected { diffuse: share } => {
                let by_diffuse = diffuse * share;
                let whole = by_diffuse + specular * (Rgb::ONE - share);
                (whole, Self::Reflected { diffuse: part(by_diffuse, whole) })
            }
            Self::Transmitted => (Rgb::splat(specular), self),
            Self::Scattered => (Rgb::splat(diffuse), self),
        }
    }
}

/// `some` of `whole`; where there is nothing, nothing of it.
fn part(some: Rgb, whole: Rgb) -> Rgb {
    Rgb::select(whole.cmpgt(Rgb::ZERO), some / whole, Rgb::ZERO)
}

impl Bsdf {
    /// By what `f` (f * |cos| of all lobes, or of a `delta` sample) has come from `wi`, in the frame of `wo`. Of opacity
    /// and of entries into media there is no response.
    pub fn response(&self, wi: Vec3, f: Rgb, delta: bool) -> Response {
        let wi = wi * self.turn;
        let crosses = wi.z < 0.0 && !self.lobes().iter().any(|c| matches!(c.lobe, Lobe::Strand(_)));
        match crosses {
            true if self.leaves => Response::Scattered,
            true => Response::Transmitted,
            false if delta => Response::Reflected { diffuse: Rgb::ZERO },
            false => {
                let diffuse = self.lobes().iter().filter(|c| c.lobe.is_diffuse());
                let sum = diffuse.map(|c| c.weight * c.lobe.eval(self.wo, wi)).sum();
                Response::Reflected { diffuse: part(sum, f) }
            }
        }
    }
}
