//! Light at a point of a boundary: irradiance, which fills the boundary cache, and beams that enter.

use super::nest::Nest;
use super::shadow::visibility;
use super::{Path, PathSettings, PathStats, Previous};
use crate::bsdf::{Boundary, Side, fresnel};
use crate::guiding::beams::Beam;
use crate::guiding::cache::{Incident, LightRecord, Record};
use crate::guiding::{Guide, LightsAt};
use crate::interaction::Interaction;
use crate::light::Choice;
use crate::math::{PI, Rgb, mean};
use crate::medium::Medium;
use crate::sampling::cosine_hemisphere;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, InstanceEnclosure, Moment};
use crate::subsurface::steps::Enclosure;
use glam::{Vec2, Vec3};

/// Bounces of the light that a probe follows: further ones hardly say where light comes from.
const BOUNCES: u32 = 2;

/// Most lights that a probe asks one by one; of more it draws as many.
pub const LIGHTS: usize = 8;

/// A boundary point that looks for light.
struct Probe<'a> {
    scene: Moment<'a>,
    si: Interaction,
    eta: Option<f32>,
    /// Bodies around it.
    around: Nest,
}

impl<'a> Probe<'a> {
    /// `None` where no light gets to: a part of a set within another.
    fn new(scene: Moment<'a>, enclosure: &InstanceEnclosure, hit: &BoundaryHit, outward: Vec3) -> Option<Self> {
        let mut si = scene.interaction(&enclosure.surface_hit(hit), -outward, Side::Outside);
        let coating = scene.shade(&mut si, 0.0);
        let eta = coating.interior.filter(|i| i.boundary == Boundary::Dielectric).and(coating.surface.interior());
        let around = if scene.needs.is_nested() { scene.around(si.p, si.instance) } else { Vec::new() };
        let covered = around.iter().any(|body| scene.is_opaque(body));
        (!covered).then(|| Self { scene, eta: eta.map(|i| i.eta), around: Nest::of(&scene, &around), si })
    }

    /// What a dielectric reflects does not enter.
    fn entering(&self, wi: Vec3) -> f32 {
        self.eta.map_or(1.0, |eta| 1.0 - fresnel::dielectric(wi.dot(self.si.ng).min(1.0), eta))
    }

    /// Lights that are `wanted`, the directions to them, and the irradiance of each that enters, with and without shadows.
    fn lights(
        &self,
        wanted: impl Fn(u32) -> bool,
        sampler: &mut Sampler,
        stats: &mut PathStats,
        mut seen: impl FnMut(u32, Vec3, Rgb, Rgb),
    ) {
        let (scene, si) = (self.scene, &self.si);
        let n = si.ng;
        let lights = scene.lights.len();
        let mut draws = scene.lights_for(si.instance).draws(si.p, Some(n), Choice::ONE);
        for i in 0..lights.min(LIGHTS) {
            let u = Vec2::new(sampler.random(), sampler.random());
            let sample = if lights <= LIGHTS {
                scene.lights().sample_light(i as u32, si.p, Some(n), u)
            } else {
                // One from each stratum of the choice.
                let u_choice = (i as f32 + sampler.random()) / LIGHTS as f32;
                draws.sample(u_choice, u)
            };
            let sample = sample.filter(|light| light.wi.dot(n) > 0.0 && light.pdf > 0.0);
            let Some(light) = sample.filter(|light| wanted(light.light)) else { continue };
            let share = if lights <= LIGHTS { 1.0 } else { 1.0 / LIGHTS as f32 };
            let unshadowed = light.radiance * (light.wi.dot(n) * self.entering(light.wi) * share / light.pdf);
            if !(unshadowed.is_finite() && mean(unshadowed) > 0.0 && scene.illuminates(light.light, si.instance)) {
                continue;
            }
            stats.shadow_rays += 1;
            let origin = Some((si.instance, si.triangle));
            let (o, reach) = (si.origin(light.wi), light.reach());
            let taken = unshadowed * scene.lights.response(light.light)[0];
            let visible = taken * visibility(scene, light.light, o, light.wi, reach, origin, &self.around);
            seen(light.light, light.wi, visible, unshadowed);
        }
    }
}

/// Beams of light that enter the smooth boundary of `enclosure` at `hit`, which stands for `area`; `outward` unit, render
/// space.
pub fn beams_at(
    scene: Moment,
    enclosure: &InstanceEnclosure,
    medium: &Medium,
    hit: &BoundaryHit,
    outward: Vec3,
    area: f32,
    sampler: &mut Sampler,
    stats: &mut PathStats,
) -> Vec<Beam> {
    let mut beams = Vec::new();
    let Some(probe) = Probe::new(scene, enclosure, hit, outward) else { return beams };
    let (Some(eta), n) = (probe.eta, probe.si.frame.n) else { return beams };
    let mut entering = Vec::new();
    probe.lights(
        |light| scene.lights.is_met(light),
        sampler,
        stats,
        |_, wi, visible, _| {
            let power = area * mean(visible);
            let d = (power > 0.0 && wi.dot(n) > 0.0).then(|| fresnel::refract(wi, n, eta)).flatten();
            entering.extend(d.map(|d| (d, power)));
        },
    );
    for (d, power) in entering {
        follow(scene, enclosure, medium, eta, *hit, d, power, sampler, &mut beams);
    }
    beams
}

/// Reflections of a beam.
const REFLECTIONS: u32 = 3;

/// Adds the beam from `hit` along `d`, and what the boundary reflects of it.
fn follow(
    scene: Moment,
    enclosure: &InstanceEnclosure,
    medium: &Medium,
    eta: f32,
    mut hit: BoundaryHit,
    mut d: Vec3,
    mut power: f32,
    sampler: &mut Sampler,
    beams: &mut Vec<Beam>,
) {
    for _ in 0..=REFLECTIONS {
        let p = enclosure.point(&hit);
        let Some((length, next)) = enclosure.cast(p, d, f32::INFINITY, Some(hit)) else { return };
        beams.push(Beam { p, towards: -d, length, power });
        let exit = scene.interaction(&enclosure.surface_hit(&next), d, Side::Inside);
        let reflected = fresnel::dielectric(d.dot(exit.frame.n).clamp(0.0, 1.0), 1.0 / eta);
        d = fresnel::reflect(-d, exit.frame.n);
        if sampler.random() >= reflected || d.dot(exit.ng) >= 0.0 {
            return;
        }
        power *= mean(medium.transmittance(length));
        hit = next;
    }
}

/// Light that enters the boundary of `enclosure` at `hit`, which stands for `area`; `outward` unit, render space.
/// Walks inside media are classical: nothing is known yet.
pub fn probe(
    scene: Moment,
    guide: &Guide,
    enclosure: &InstanceEnclosure,
    hit: &BoundaryHit,
    outward: Vec3,
    area: f32,
    sampler: &mut Sampler,
    stats: &mut PathStats,
) -> Record {
    let mut record = Record {
        p: enclosure.point(hit),
        n: outward,
        area,
        irradiance: Rgb::ZERO,
        lights: Vec::new(),
        directions: Vec::new(),
        indirect: None,
    };
    let Some(probe) = Probe::new(scene, enclosure, hit, outward) else { return record };
    let (si, n) = (&probe.si, probe.si.ng);
    record.n = n;
    probe.lights(
        |_| true,
        sampler,
        stats,
        |light, wi, visible, unshadowed| {
            record.irradiance += visible;
            record.directions.push(Incident { wi, irradiance: mean(visible) });
            record.lights.push(LightRecord { light, visible: mean(visible), unshadowed: mean(unshadowed) });
        },
    );

    // By way of other surfaces.
    let wi = si.frame.to_world(cosine_hemisphere(Vec2::new(sampler.random(), sampler.random())));
    if wi.dot(n) > 0.0 {
        let settings = PathSettings { max_depth: BOUNCES, lights_visible_to_camera: false };
        let mut path = Path::new(scene, guide, settings, stats);
        path.depth = 1;
        path.inside = probe.around;
        // Lights were asked for already: pdf 0 leaves nothing of those that the segment meets.
        path.previous = Previous::Sampled { p: si.p, n: Some(n), pdf: 0.0, lights: LightsAt::All };
        path.continue_from(si, wi);
        path.receiver = si.instance;
        path.looks = false;
        while path.segment(sampler).is_some() {}
        let indirect = path.sample.color() * (PI * probe.entering(wi));
        if indirect.is_finite() {
            record.irradiance += indirect;
            record.indirect = Some(Incident { wi, irradiance: mean(indirect) });
        }
    }
    record
}
