//! Light at collisions behind a smooth dielectric: looked for where beams of it are known to come from.
//!
//! A look is a direction drawn from the [`Beams`] of the collision's cell, followed to the boundary and out, or on inside as
//! far as reflections take it. A path that scatters by chance and leaves without another collision could have been such a
//! look, whose density is known in closed form: both share the light by the power heuristic. Chance alone has what the beams
//! do not know, and what is met after further collisions is theirs.
//!
//! Suns, whose beams are too narrow for that, are searched for (`suns`), but for those that are reflected inside.

use super::collision::{CollisionLight, Into};
use super::manifold::Window;
use super::shadow::visibility;
use super::suns::{FirstWay, Search, Suns};
use crate::bsdf::{Side, fresnel::reflect};
use crate::guiding::Guide;
use crate::guiding::beams::Beams;
use crate::interaction::Interaction;
use crate::light::SHORT;
use crate::math::{PI, Rgb, mean};
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::{Collision, Role};
use glam::{Vec2, Vec3};

/// Looks of a collision of throughput 1 that sees as much light as is usual in the body. These are optima on
/// `bunny_smooth` (docs/performance.md, "Smooth dielectrics").
const LOOKS: f32 = 1.2;

/// Times as many of the one that stands for the first segment from a boundary: where pixels share paths, what is behind it comes
/// from more walks than one, what it finds does not.
const FIRST: f32 = 2.0;

/// Most looks of another collision.
const MOST_LOOKS: f32 = 4.0;

/// Segments of a look: between them it is reflected.
const MOST_LEGS: u32 = 4;

/// By what a look is worth: between constant and in proportion, since dim corners are pictures, too.
fn looks(worth: f32) -> f32 {
    let looks = (LOOKS * worth.sqrt()).min(MOST_LOOKS);
    if looks.is_finite() { looks } else { 0.0 }
}

/// Light that a boundary bends on its way to collisions in `medium`.
#[derive(Clone, Copy)]
pub(super) struct Bent<'a> {
    instance: u32,
    surface: u32,
    window: Window<'a>,
    medium: Medium,
    /// `None`: there are none.
    suns: Option<Suns<'a>>,
    /// `None`: none are known.
    beams: Option<&'a Beams>,
}

/// A collision's looks for light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    cell: u32,
    /// Expected number of looks, over the probability of the collision where it stands for a segment.
    density: f32,
}

/// The way of a path since the last collision, which looked for light, too.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refracted {
    instance: u32,
    surface: u32,
    /// Drawn by the collision.
    d: Vec3,
    /// Solid-angle pdf of `d`, times the probability to get here. That of reflections is not in it, nor in those of looks.
    pdf: f32,
    /// `None`: it asked no beams.
    aim: Option<Aim>,
    first: FirstWay,
    legs: u32,
}

impl Refracted {
    /// A `way` without a collision further.
    pub fn further(self, bent: &Bent, way: f32) -> Option<Self> {
        let on = Self { pdf: self.pdf * mean(bent.medium.transmittance(way)), legs: self.legs + 1, ..self };
        (on.legs <= MOST_LEGS).then_some(on)
    }

    /// Out at `exit`.
    pub fn out(self, bent: &Bent, exit: &Interaction) -> Self {
        let transmitted = bent.window.refracted(exit).map_or(0.0, |(_, transmitted)| transmitted);
        Self { pdf: self.pdf * transmitted, ..self }
    }

    /// MIS weight of having met `light` by chance, along `v`.
    pub fn weight(&self, scene: Moment, guide: &Guide, light: u32, v: Vec3) -> f32 {
        let beams = || Some((guide.beams_in(self.instance)?, self.aim?));
        let by_beams =
            || beams().map_or(1.0, |(beams, aim)| power_heuristic(self.pdf, aim.density * beams.pdf(aim.cell, self.d)));
        let suns = || Bent::new(guide, scene, self.instance, self.surface, None)?.suns;
        let sun = (self.legs == 1).then(suns).flatten().and_then(|suns| Some((suns, suns.pdf(light, v)?)));
        sun.map_or_else(by_beams, |(suns, pdf)| {
            suns.weight(&InstanceEnclosure::new(scene, self.instance), &self.first, light, v, pdf)
        })
    }
}

impl<'a> Bent<'a> {
    /// `None` unless `surface` makes a smooth dielectric boundary of `instance`, and there is light to look for.
    pub fn new(
        guide: &Guide,
        scene: Moment<'a>,
        instance: u32,
        surface: u32,
        beams: Option<&'a Beams>,
    ) -> Option<Self> {
        let error = InstanceEnclosure::new(scene, instance).position_error();
        let window = Window::new(scene, instance, surface, error)?;
        let medium = scene.surfaces[surface as usize].interior?.medium;
        let suns = guide.suns.then(|| Suns::new(scene, instance, window, medium));
        (suns.is_some() || beams.is_some()).then_some(Self { instance, surface, window, medium, suns, beams })
    }

    /// The start of a path's way from a collision that drew `d` with solid-angle pdf `pdf` and looked for light by `aim`.
    pub fn from(&self, d: Vec3, pdf: f32, aim: Option<Aim>, first: FirstWay) -> Refracted {
        Refracted { instance: self.instance, surface: self.surface, d, pdf, aim, first, legs: 0 }
    }

    /// The sun that a collision at `x` searches for, if it does.
    pub fn search(&self, enclosure: &InstanceEnclosure, x: Vec3, sampler: &mut Sampler) -> Option<Search> {
        self.suns.as_ref()?.search(enclosure, x, sampler)
    }

    pub fn has_beams(&self) -> bool {
        self.beams.is_some()
    }

    /// Adds what a collision sees of the lights. Returns the shadow rays that took.
    pub fn add(
        &self,
        to: &CollisionLight,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        into.aim = self.aim(to, collision);
        if matches!(collision.role, Role::Counted(_)) {
            return 0;
        }
        let mut shadow_rays = 0;
        if let (Some(beams), Some(aim)) = (self.beams, into.aim) {
            let expected = aim.density * collision.role.share();
            for _ in 0..(expected + sampler.random()) as u32 {
                let u = Vec2::new(sampler.random(), sampler.random());
                let d = beams.sample(aim.cell, sampler.random(), u);
                shadow_rays += self.look(to, collision, aim, d, enclosure, sampler, into);
            }
        }
        if let Some((suns, search)) = self.suns.as_ref().zip(into.search.take()) {
            shadow_rays += suns.connect(to, &search, collision, into);
        }
        shadow_rays
    }

    /// How often, and by which cell, a collision looks for light: a function of where it is and what it carries.
    fn aim(&self, to: &CollisionLight, collision: &Collision) -> Option<Aim> {
        let beams = self.beams?;
        let cell = beams.find(collision.p)?;
        let light = beams.cell(cell);
        let (phase, _) = (collision.scatter)(light.towards.try_normalize()?);
        let more = if collision.role == Role::Own { 1.0 } else { FIRST };
        let expected = more * looks(4.0 * PI * phase * light.fluence * to.scale * mean(collision.weight));
        (expected > 0.0).then(|| Aim { cell, density: expected / collision.role.share() })
    }

    /// Looks along `d`, and on where the boundary reflects.
    fn look(
        &self,
        to: &CollisionLight,
        collision: &Collision,
        aim: Aim,
        mut d: Vec3,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        let (drawn, mut p, mut from, mut shadow_rays) = (d, collision.p, None, 0);
        let (mut passed, mut reached) = (Rgb::ONE, 1.0);
        for leg in 0..MOST_LEGS {
            let Some((t, hit)) = enclosure.cast(p, d, f32::INFINITY, from) else { break };
            let exit = to.scene.interaction(&enclosure.surface_hit(&hit), d, Side::Inside);
            passed *= self.medium.transmittance(t);
            reached *= mean(self.medium.transmittance(t));
            let refracted = self.window.refracted(&exit);
            let transmitted = refracted.map_or(0.0, |(_, transmitted)| transmitted);
            if let Some((v, _)) = refracted.filter(|(v, share)| *share > 0.0 && v.dot(exit.ng) > 0.0) {
                let value = || self.value(collision, aim, drawn, reached * transmitted);
                let passed = passed * self.window.radiance_of(transmitted);
                shadow_rays += self.see(to, collision.weight * passed, leg, &exit, v, value, into);
            }
            // As likely as a path would be.
            if sampler.random() < transmitted {
                break;
            }
            d = reflect(-d, exit.frame.n);
            if d.dot(exit.ng) >= 0.0 {
                break;
            }
            (p, from) = (enclosure.point(&hit), Some(hit));
        }
        shadow_rays
    }

    /// Phase function and MIS weight over the density of a look along `d`, where chance gets out with probability `out`.
    fn value(&self, collision: &Collision, aim: Aim, d: Vec3, out: f32) -> f32 {
        let (phase, by_chance) = (collision.scatter)(d);
        let pdf = self.beams.map_or(0.0, |beams| beams.pdf(aim.cell, d));
        let weight = power_heuristic(aim.density * pdf, by_chance * out);
        phase * weight / (aim.density * collision.role.share() * pdf)
    }

    /// Adds the lights that `v` meets beyond `exit`, after so many reflections, times `passed` and `value`, which is asked where
    /// there are some.
    fn see(
        &self,
        to: &CollisionLight,
        passed: Rgb,
        reflections: u32,
        exit: &Interaction,
        v: Vec3,
        value: impl Fn() -> f32,
        into: &mut Into,
    ) -> u64 {
        let (scene, lights) = (to.scene, to.scene.lights());
        let (o, origin) = (exit.origin(v), Some((exit.instance, exit.triangle)));
        let mut shadow_rays = 0;
        let mut meet = |light: u32, radiance: Rgb, reach: f32| {
            if radiance == Rgb::ZERO || !scene.illuminates(light, to.instance) {
                return;
            }
            let value = passed * radiance * value();
            if value.is_finite() && value != Rgb::ZERO {
                shadow_rays += 1;
                to.give(into, light, value * visibility(scene, light, o, v, reach, origin, to.around));
            }
        };
        scene.light_shapes(o, v, f32::INFINITY, |light, hit| {
            meet(light, lights.radiance_hit(light, v, hit), hit.t * SHORT);
        });
        for &light in scene.lights.infinite() {
            // Those are searched for.
            let is_sun = |suns: &Suns| reflections == 0 && suns.pdf(light, v).is_some();
            let radiance = lights.escaped(light, v);
            if radiance != Rgb::ZERO && !self.suns.as_ref().is_some_and(is_sun) {
                meet(light, radiance, f32::INFINITY);
            }
        }
        shadow_rays
    }
}
