//! Surfaces: what happens to light at a boundary.
//!
//! A [`Surface`] is a compiled material. At a vertex it gives a [`Bsdf`]: a mixture of lobes, seen from one
//! direction, that can be evaluated, sampled, and asked for its pdf. Behind a surface there may be an [`Interior`].
//!
//! Layers are combined by albedo scaling: what is below a lobe gets 1 - E(wo), E being the lobe's directional
//! albedo. White layers reflect exactly everything; the mixture is not reciprocal (as in production renderers).

mod albedo;
mod check;
mod curves;
mod dielectric;
mod diffuse;
pub mod fresnel;
mod ggx;
mod hair;
mod interior;
mod layered;
mod lobe;
mod openpbr;
mod preview;
mod response;
mod specular;
mod standard;
mod surface;
mod translucent;

pub use dielectric::Dielectric;
pub use interior::{Boundary, Interior, InteriorAlbedo};
pub use response::Response;
pub use surface::{NotedCurves, OfMesh, Surface};

use crate::math::{Rgb, mean};
use glam::{Vec2, Vec3};
use lobe::Lobe;

/// Which side of the boundary `wo` is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Outside,
    /// In the medium behind the surface.
    Inside,
}

/// What happened; decides what the path does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    Reflect,
    /// Crossed the boundary of the medium, into it or out of it.
    Transmit,
    /// Lambertian entry into a medium with `Boundary::Diffuse`: the walk starts below.
    EnterSubsurface,
    /// By a strand of hair, to any side of it; nothing is crossed.
    Scatter,
    /// Straight through where the surface is absent (opacity): same direction, nothing crossed.
    PassThrough,
}

/// A sampled direction. The weight of the path is always `f / pdf`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BsdfSample {
    /// Unit, away from the vertex, same frame as `wo`.
    pub wi: Vec3,
    /// f * |cos|: of the whole mixture, or of the one lobe if `delta`. Transmission carries radiance (1 / eta^2).
    pub f: Rgb,
    /// Per solid angle, of the whole mixture; if `delta` the probability of this lobe and direction instead
    /// (for `EnterSubsurface` times the cosine density, which cancels in f / pdf).
    pub pdf: f32,
    pub event: Event,
    /// No next-event estimation stands for this direction: `eval` and `pdf` are 0 there. Set for mirror, smooth
    /// refraction, index-matched and opacity, and for `EnterSubsurface`.
    pub delta: bool,
}

/// Most lobes of any surface: opacity, coat, metal, interface, specular, diffuse, stand-in, entry, opacity below.
const MAX_LOBES: usize = 9;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Component {
    lobe: Lobe,
    weight: Rgb,
    /// Of choosing this lobe.
    probability: f32,
}

/// How a surface scatters light at one vertex, for one `wo`.
#[derive(Debug, Clone, Copy)]
pub struct Bsdf {
    /// Turned so that z > 0.
    wo: Vec3,
    /// -1 if it was turned: lobes live in the hemisphere of `wo`.
    turn: f32,
    components: [Component; MAX_LOBES],
    len: usize,
    /// It is seen from within a medium that scatters.
    leaves: bool,
}

impl Bsdf {
    /// No lobes yet: black.
    fn new(wo: Vec3) -> Self {
        let turn = if wo.z < 0.0 { -1.0 } else { 1.0 };
        // Exactly grazing sight has no projected area to divide by; 1e-5 keeps f32 quotients finite.
        let wo = Vec3::new(wo.x * turn, wo.y * turn, (wo.z * turn).max(1e-5)).normalize();
        let none = Component { lobe: Lobe::PassThrough, weight: Rgb::ZERO, probability: 0.0 };
        Self { wo, turn, components: [none; MAX_LOBES], len: 0, leaves: false }
    }

    /// Adds a lobe whose directional albedo is about `albedo`; probabilities are proportional to what lobes return.
    fn push(&mut self, lobe: Lobe, weight: Rgb, albedo: Rgb) {
        let share = mean(weight * albedo);
        if share > 0.0 {
            self.components[self.len] = Component { lobe, weight, probability: share };
            self.len += 1;
        }
    }

    /// Turns shares into probabilities.
    fn normalized(mut self) -> Self {
        let total: f32 = self.lobes().iter().map(|c| c.probability).sum();
        let len = self.len;
        self.components[..len].iter_mut().for_each(|c| c.probability /= total);
        self
    }

    /// The lobes that reflect, the probability with which one of them would be chosen, and the entry into a medium with
    /// [`Boundary::Diffuse`], where there is nothing but those two: together they are what the mixture is.
    pub fn parted(&self) -> Option<(Self, f32, Self)> {
        let enters = |c: &&Component| c.lobe == Lobe::Subsurface;
        let reflects = |c: &&Component| c.lobe.reflects();
        let is_either = |c: &Component| enters(&c) || reflects(&c);
        let chance: f32 = self.lobes().iter().filter(reflects).map(|c| c.probability).sum();
        let both = chance > 0.0 && self.lobes().iter().any(|c| enters(&c)) && self.lobes().iter().all(is_either);
        both.then(|| (self.of(reflects), chance, self.of(enters)))
    }

    /// The lobes of a kind alone.
    fn of(&self, kind: impl Fn(&&Component) -> bool) -> Self {
        let mut bsdf = Self { len: 0, ..*self };
        for component in self.lobes().iter().filter(kind) {
            bsdf.components[bsdf.len] = *component;
            bsdf.len += 1;
        }
        bsdf.normalized()
    }

    fn lobes(&self) -> &[Component] {
        &self.components[..self.len]
    }

    /// Cosine of `wo` to the normal.
    fn mu(&self) -> f32 {
        self.wo.z
    }

    /// Lambertian exit from a medium with `Boundary::Diffuse`: cosine hemisphere about +z, albedo 1.
    pub fn lambert_exit() -> Self {
        Self::exit(-Vec3::Z)
    }

    fn exit(wo: Vec3) -> Self {
        let mut bsdf = Self::new(wo);
        bsdf.push(Lobe::Exit, Rgb::ONE, Rgb::ONE);
        bsdf.leaves = true;
        bsdf.normalized()
    }

    /// f * |cos| of all lobes that are not delta; `wi` unit, in the frame of `wo`.
    pub fn eval(&self, wi: Vec3) -> Rgb {
        let wi = wi * self.turn;
        self.lobes().iter().map(|c| c.weight * c.lobe.eval(self.wo, wi)).sum()
    }

    /// Per solid angle: the mixture over the lobes that are not delta, with their probabilities. Integrates to the
    /// share of samples that go there (less than 1 with delta lobes, or where facets block).
    pub fn pdf(&self, wi: Vec3) -> f32 {
        let wi = wi * self.turn;
        self.lobes().iter().map(|c| c.probability * c.lobe.pdf(self.wo, wi)).sum()
    }

    /// A direction and what it is worth; `None` where it is absorbed. `u_lobe` chooses the lobe, its rest between
    /// reflection and refraction.
    pub fn sample(&self, u_lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let (chosen, u_choice) = self.choose(u_lobe)?;
        if chosen.lobe.is_delta() {
            let s = chosen.lobe.sample_delta(self.wo, u_choice, u)?;
            let (f, pdf) = (chosen.weight * s.f, chosen.probability * s.pdf);
            return (pdf > 0.0).then_some(BsdfSample { wi: s.wi * self.turn, f, pdf, ..s });
        }
        let local = chosen.lobe.sample(self.wo, u_choice, u)?;
        let wi = local * self.turn;
        let (f, pdf) = (self.eval(wi), self.pdf(wi));
        let event = match chosen.lobe {
            Lobe::Strand(_) => Event::Scatter,
            _ if local.z > 0.0 => Event::Reflect,
            _ => Event::Transmit,
        };
        // Grazing facets can round to density 0, or overflow: nothing to carry on with.
        (pdf > 0.0 && pdf.is_finite()).then_some(BsdfSample { wi, f, pdf, event, delta: false })
    }

    /// The lobe at `u` of the cumulated probabilities, and `u` rescaled to [0, 1) within it.
    fn choose(&self, u: f32) -> Option<(&Component, f32)> {
        let mut below = 0.0;
        let last = self.len.checked_sub(1)?;
        for component in &self.lobes()[..last] {
            if u < below + component.probability {
                return Some((component, (u - below) / component.probability));
            }
            below += component.probability;
        }
        let component = &self.components[last];
        // Rounding of the cumulated sum may leave the last share a little short.
        Some((component, ((u - below) / component.probability).clamp(0.0, 1.0 - f32::EPSILON)))
    }

    /// True where next-event estimation cannot contribute.
    pub fn is_delta_only(&self) -> bool {
        self.lobes().iter().all(|c| c.lobe.is_delta())
    }
}
