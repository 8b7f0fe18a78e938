//! Lights: UsdLux' radiometry, sampled.
//!
//! `emission` and `shaping` say how bright, `shape` and its variants say where, `area`, `distant` and `dome`
//! join the two, `choice` picks one light out of few, or out of many with the help of a `tree` over their `bound`s, `compile`
//! makes them from the flattened scene.
//!
//! Space is render space: world translated, never rotated. Directions `wi` are unit and point from the
//! receiver to the light. All pdfs are per solid angle at the receiver.

mod area;
mod bound;
mod choice;
mod compile;
mod cylinder;
mod disk;
mod distant;
mod dome;
mod ellipsoid;
mod emission;
mod groups;
mod ies;
mod lanes;
mod latlong;
mod linking;
mod mesh;
mod motion;
mod patch;
mod portal;
mod rect;
mod shadow;
mod shape;
mod shaping;
mod small;
mod split;
#[cfg(test)]
mod tests;
mod texels;
mod tree;

pub use area::AreaLight;
pub use choice::{Choice, Draws, Parts};
pub use compile::MeshTriangles;
pub use distant::Distant;
pub use dome::Dome;
pub use groups::GLOW;
pub use linking::{Categories, Members};
pub use motion::LightsAt;
pub use shadow::Shadow;
pub use shape::{Shape, ShapeHit};

use crate::math::Rgb;
use glam::{Vec2, Vec3};
use motion::{to_frame, to_time};
use std::collections::BTreeMap;

#[derive(Debug, Clone)]
pub enum Light {
    Area(AreaLight),
    Distant(Distant),
    Dome(Dome),
}

impl Light {
    fn importance(&self, p: Vec3, n: Option<Vec3>) -> f32 {
        match self {
            Light::Area(light) => light.importance(p, n),
            Light::Distant(light) => light.importance(n),
            Light::Dome(light) => light.importance(),
        }
    }

    fn shines(&self) -> bool {
        match self {
            Light::Area(light) => light.shines(),
            Light::Distant(light) => light.shines(),
            Light::Dome(light) => light.shines(),
        }
    }
}

/// Light arriving at a point from a sampled direction, without shadows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightSample {
    pub light: u32,
    pub wi: Vec3,
    /// To the light; infinite for domes and distant lights.
    pub distance: f32,
    /// Of a `delta` light: irradiance of a surface facing it. May be zero (shaping, dark texels).
    pub radiance: Rgb,
    /// Per solid angle, times the probability of having chosen this light; the latter alone if `delta`.
    pub pdf: f32,
    /// A single direction: no other sampler can find it.
    pub delta: bool,
}

/// Solid-angle pdf of a light's sample from which the light there is a sun: a hundredth of a steradian, seven degrees.
pub const SUN_PDF: f32 = 100.0;

/// Shadow rays to a point on a mesh light stop short of it by this share of the distance, so that
/// the light's own triangle does not shadow it; f32 positions resolve no finer.
pub const SHORT: f32 = 1.0 - 1e-4;

impl LightSample {
    /// How far a shadow ray has to be free.
    pub fn reach(&self) -> f32 {
        self.distance * SHORT
    }
}

/// All lights of a scene that emit anything.
#[derive(Debug, Clone, Default)]
pub struct Lights {
    /// At the frame.
    lights: Vec<Light>,
    /// By light; empty where none moves.
    motions: Vec<Option<motion::Motion>>,
    paths: Vec<String>,
    camera_visible: Vec<bool>,
    /// Domes and distant lights of positive angle.
    infinite: Vec<u32>,
    /// Distant lights of a single direction.
    single: Vec<u32>,
    /// Lights that are weighed one by one: all of few, else those that are not in the tree.
    beside: Vec<u32>,
    tree: Option<tree::Tree>,
    /// Mesh key to light.
    meshes: BTreeMap<String, u32>,
    /// Category of what each lights; `None`: everything. Empty where all light everything.
    links: Vec<Option<u32>>,
    /// By set of categories, the lights that are for its things. Empty as `links` is.
    linked_to: Vec<linking::Linked>,
    /// Of each that casts other shadows than those of everything. Empty where none does.
    shadows: Vec<Option<Shadow>>,
    groups: groups::Groups,
    /// What each is to diffuse lobes and media, and to the others (`inputs:diffuse`, `inputs:specular`). Empty where all
    /// are 1.
    responses: Vec<[f32; 2]>,
}

impl Lights {
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// Prim path.
    pub fn path(&self, light: u32) -> &str {
        &self.paths[light as usize]
    }

    pub fn camera_visible(&self, light: u32) -> bool {
        self.camera_visible[light as usize]
    }

    /// Whether each is a dome or a distant light.
    pub fn are_infinite(&self) -> bool {
        self.lights.iter().all(|light| matches!(light, Light::Dome(_) | Light::Distant(_)))
    }

    /// Whether surfaces of the scene are the light's.
    pub fn is_mesh(&self, light: u32) -> bool {
        matches!(self.lights[light as usize], Light::Area(AreaLight { shape: Shape::Mesh(_), .. }))
    }

    /// The light that the mesh of this key is.
    pub fn mesh_light(&self, mesh: &str) -> Option<u32> {
        self.meshes.get(mesh).copied()
    }

    /// Area lights that rays meet by [`LightsAt::intersect`], each with the box (min, max) of all its places.
    pub fn shapes(&self) -> impl Iterator<Item = (u32, (Vec3, Vec3))> {
        self.lights.iter().enumerate().filter_map(|(i, light)| match light {
            Light::Area(AreaLight { shape: Shape::Mesh(_), .. }) | Light::Distant(_) | Light::Dome(_) => None,
            Light::Area(area) => {
                let (motion, still) = (self.motions.get(i).and_then(Option::as_ref), area.shape.bounds());
                Some((i as u32, motion.map_or(still, |motion| motion.swept(still))))
            }
        })
    }

    /// Domes with portals.
    pub fn with_portals(&self) -> usize {
        self.lights.iter().filter(|light| matches!(light, Light::Dome(dome) if dome.has_portals())).count()
    }

    /// Whether some light shines on some lobes more than on others.
    pub fn has_responses(&self) -> bool {
        !self.responses.is_empty()
    }

    /// Lights that are another to diffuse lobes, or to the others, than they are to look at.
    pub fn with_responses(&self) -> usize {
        self.responses.iter().filter(|&&response| response != [1.0; 2]).count()
    }

    /// Factors of what `source`, a light or [`GLOW`], is to diffuse lobes and media, and to the others.
    pub fn response(&self, source: u32) -> [f32; 2] {
        self.responses.get(source as usize).copied().unwrap_or([1.0; 2])
    }

    /// Lights that a ray which leaves the scene may see.
    pub fn infinite(&self) -> &[u32] {
        &self.infinite
    }
}

impl LightsAt<'_> {
    /// A light drawn by its estimated contribution at `p`, as [`Draws::sample`] does. `n` is the normal of a receiver that takes
    /// light from its side only; without it light from all around counts.
    pub fn sample(&self, p: Vec3, n: Option<Vec3>, choice: Choice, u_choice: f32, u: Vec2) -> Option<LightSample> {
        self.draws(p, n, choice).sample(u_choice, u)
    }

    /// As [`Self::sample`] with the light given: the pdf is without the choice.
    pub fn sample_light(&self, light: u32, p: Vec3, n: Option<Vec3>, u: Vec2) -> Option<LightSample> {
        let infinite = |(wi, pdf): (Vec3, f32), radiance: Rgb, delta| LightSample {
            light,
            wi,
            distance: f32::INFINITY,
            radiance,
            pdf,
            delta,
        };
        let (of_frame, pose, p, n) = self.seen(light, p, n);
        let sample = match of_frame {
            Light::Area(area) => area.shape.sample(p, u).map(|s| LightSample {
                light,
                wi: s.wi,
                distance: s.hit.t,
                radiance: area.radiance(s.wi, &s.hit),
                pdf: s.pdf,
                delta: false,
            }),
            Light::Distant(distant) => {
                let s = distant.sample(u);
                Some(infinite(s, distant.sampled_radiance(s.0), distant.is_delta()))
            }
            Light::Dome(dome) => dome.sample(p, n, u).map(|s| infinite(s, dome.radiance(s.0), false)),
        };
        sample.map(|sample| LightSample { wi: to_time(pose.as_ref(), sample.wi), ..sample })
    }

    /// Solid-angle pdf with which [`Self::sample`] gives the direction `wi` that meets an area light at
    /// `hit`, choice included. Mesh lights: [`ShapeHit::on_mesh`].
    pub fn pdf_hit(&self, light: u32, p: Vec3, n: Option<Vec3>, choice: Choice, wi: Vec3, hit: &ShapeHit) -> f32 {
        let (Light::Area(area), pose, at, _) = self.seen(light, p, n) else { return 0.0 };
        area.shape.pdf(at, to_frame(pose.as_ref(), wi), hit) * self.choice_probability(light, p, n, choice)
    }

    /// Whether `light` may give anything at p.
    pub fn reaches(&self, light: u32, p: Vec3, n: Option<Vec3>) -> bool {
        let (light, _, p, n) = self.seen(light, p, n);
        light.importance(p, n) > 0.0
    }

    /// Radiance that arrives along `wi` from `hit` on an area light; zero from its dark side.
    pub fn radiance_hit(&self, light: u32, wi: Vec3, hit: &ShapeHit) -> Rgb {
        let (light, pose) = self.light(light);
        match light {
            Light::Area(area) => area.radiance(to_frame(pose.as_ref(), wi), hit),
            Light::Distant(_) | Light::Dome(_) => Rgb::ZERO,
        }
    }

    /// Nearest hit of the emitting side with t in (0, t_max), `d` unit. Dark sides let rays pass.
    pub fn intersect(&self, light: u32, o: Vec3, d: Vec3, t_max: f32) -> Option<ShapeHit> {
        let (light, pose, o, _) = self.seen(light, o, None);
        match light {
            Light::Area(area) => area.shape.intersect(o, to_frame(pose.as_ref(), d), t_max),
            Light::Distant(_) | Light::Dome(_) => None,
        }
    }

    /// Radiance of an infinite light from direction `wi`.
    pub fn escaped(&self, light: u32, wi: Vec3) -> Rgb {
        let (light, pose) = self.light(light);
        let wi = to_frame(pose.as_ref(), wi);
        match light {
            Light::Distant(distant) => distant.radiance(wi),
            Light::Dome(dome) => dome.radiance(wi),
            Light::Area(_) => Rgb::ZERO,
        }
    }

    /// Solid-angle pdf with which [`Self::sample`] gives direction `wi` to an infinite light, choice included.
    pub fn pdf_escaped(&self, light: u32, p: Vec3, n: Option<Vec3>, choice: Choice, wi: Vec3) -> f32 {
        let (of_frame, pose, at, turned) = self.seen(light, p, n);
        let of_wi = to_frame(pose.as_ref(), wi);
        let pdf = match of_frame {
            Light::Distant(distant) => distant.pdf(of_wi),
            Light::Dome(dome) => dome.pdf(at, turned, of_wi),
            Light::Area(_) => 0.0,
        };
        if pdf > 0.0 { pdf * self.choice_probability(light, p, n, choice) } else { 0.0 }
    }
}
