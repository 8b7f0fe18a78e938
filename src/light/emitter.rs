//! A point of a light as a target in its own right: what a connection that bends on its way there needs to know.
//!
//! The density of a target is that with which a receiver at `p`, without a normal, draws it looking straight.

use super::{
    Choice, Light, Lights, LightsAt, ShapeHit,
    motion::{Pose, to_frame},
    shape::Shape,
};
use crate::math::Rgb;
use glam::{Vec2, Vec3};

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// On an area light; `normal` unit, outward.
    Point { y: Vec3, hit: ShapeHit, normal: Vec3 },
    /// Unit, towards an infinite light.
    Direction(Vec3),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Emitter {
    pub light: u32,
    pub place: Place,
    /// Choice of the light included: per area of a point, per solid angle of a direction, of a `delta` one the
    /// probability of the choice.
    pub density: f32,
    /// The same per solid angle at p as it looks straight; infinite if `delta`.
    pub straight: f32,
    /// A single direction: no other sampler can find it.
    pub delta: bool,
}

impl Emitter {
    /// A target of the frame where it is at a time.
    fn moved(self, pose: Option<Pose>) -> Self {
        let Some(pose) = pose else { return self };
        let place = match self.place {
            Place::Point { y, hit, normal } => Place::Point { y: pose.point(y), hit, normal: pose.vector(normal) },
            Place::Direction(wi) => Place::Direction(pose.vector(wi)),
        };
        Self { place, ..self }
    }
}

impl LightsAt<'_> {
    /// A target drawn for `p`; `None`: this sample contributes nothing.
    pub fn sample_emitter(&self, p: Vec3, u_choice: f32, u: Vec2) -> Option<Emitter> {
        let (light, chosen) = self.draws(p, None, Choice::ONE).choose(u_choice)?;
        let infinite = |(wi, pdf): (Vec3, f32), delta| {
            let density = chosen * pdf;
            let straight = if delta { f32::INFINITY } else { density };
            Emitter { light, place: Place::Direction(wi), density, straight, delta }
        };
        let (of_frame, pose, p, _) = self.seen(light, p, None);
        let emitter = match of_frame {
            Light::Area(area) => {
                let s = area.shape.sample(p, u)?;
                point(&area.shape, light, p, s.wi, &s.hit, chosen * s.pdf)
            }
            Light::Distant(distant) => Some(infinite(distant.sample(u), distant.is_delta())),
            Light::Dome(dome) => Some(infinite(dome.sample(p, None, u)?, false)),
        };
        emitter.map(|emitter| emitter.moved(pose))
    }

    /// The point `y`, met at `hit` from wherever, as a target of `p`; `None` where `p` would not draw it.
    pub fn emitter_at(&self, light: u32, p: Vec3, y: Vec3, hit: &ShapeHit) -> Option<Emitter> {
        let (Light::Area(area), pose, at, _) = self.seen(light, p, None) else { return None };
        let t = (y - p).length();
        let wi = (y - p).try_normalize()?;
        let hit = ShapeHit { t, ..*hit };
        if !area.shape.faces(at) {
            return None;
        }
        let pdf = self.pdf_hit(light, p, None, Choice::ONE, wi, &hit);
        let emitter = point(&area.shape, light, at, to_frame(pose.as_ref(), wi), &hit, pdf)?;
        Some(emitter.moved(pose))
    }

    /// The direction `wi` of an infinite light as a target of `p`; `None` where `p` would not draw it.
    pub fn emitter_towards(&self, light: u32, p: Vec3, wi: Vec3) -> Option<Emitter> {
        let density = self.pdf_escaped(light, p, None, Choice::ONE, wi);
        let place = Place::Direction(wi);
        (density > 0.0).then_some(Emitter { light, place, density, straight: density, delta: false })
    }

    /// Radiance that arrives along `wi` from a target; irradiance of a surface facing it if `delta`.
    pub fn radiance_of(&self, emitter: &Emitter, wi: Vec3) -> Rgb {
        let (light, pose) = self.light(emitter.light);
        let wi = to_frame(pose.as_ref(), wi);
        match (light, &emitter.place) {
            (Light::Area(area), Place::Point { hit, .. }) => area.radiance(wi, hit),
            (Light::Distant(distant), _) => distant.sampled_radiance(wi),
            (Light::Dome(dome), _) => dome.radiance(wi),
            (Light::Area(_), Place::Direction(_)) => Rgb::ZERO,
        }
    }
}

impl Lights {
    /// Whether some light is small as seen from anywhere: it has a shape, an angle, or no size at all.
    pub fn has_small(&self) -> bool {
        self.lights.iter().any(|light| match light {
            Light::Area(_) | Light::Distant(_) => true,
            Light::Dome(dome) => dome.has_suns(),
        })
    }
}

/// A point seen from p along `wi` at `hit`, drawn with `pdf` per solid angle there; `None` on the far side of the light.
fn point(shape: &Shape, light: u32, p: Vec3, wi: Vec3, hit: &ShapeHit, pdf: f32) -> Option<Emitter> {
    let normal = shape.normal(hit).try_normalize()?;
    let density = pdf * -wi.dot(normal) / (hit.t * hit.t);
    let place = Place::Point { y: p + wi * hit.t, hit: *hit, normal };
    (density > 0.0 && density.is_finite()).then_some(Emitter { light, place, density, straight: pdf, delta: false })
}
