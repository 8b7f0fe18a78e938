//! Irradiance at a point of a boundary: what fills the boundary cache.

use super::nest::Nest;
use super::shadow::visibility;
use super::{Path, PathSettings, PathStats, Previous};
use crate::bsdf::{Boundary, Side, fresnel};
use crate::guiding::cache::{LightRecord, Record};
use crate::guiding::{Guide, LightsAt};
use crate::light::Choice;
use crate::math::{PI, Rgb, mean};
use crate::sampling::cosine_hemisphere;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, InstanceEnclosure, Moment};
use glam::{Vec2, Vec3};

/// Bounces of the light that a probe follows: further ones hardly say where light comes from.
const BOUNCES: u32 = 2;

/// Most lights that a probe asks one by one; of more it draws as many.
const LIGHTS: usize = 8;

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
    let mut si = scene.interaction(&enclosure.surface_hit(hit), -outward, Side::Outside);
    let coating = scene.shade(&mut si, 0.0);
    let eta = coating.interior.filter(|i| i.boundary == Boundary::Dielectric).and(coating.surface.interior());
    // What a dielectric reflects does not enter.
    let entering = |wi: Vec3| eta.map_or(1.0, |i| 1.0 - fresnel::dielectric(wi.dot(si.ng).min(1.0), i.eta));
    let n = si.ng;
    let around = if scene.needs.is_nested() { scene.around(si.p, si.instance) } else { Vec::new() };
    let mut record = Record {
        p: enclosure.point(hit),
        n,
        area,
        irradiance: Rgb::ZERO,
        lights: Vec::new(),
        directions: Vec::new(),
        indirect: None,
    };

    if around.iter().any(|body| scene.is_opaque(body)) {
        return record; // a part of a set within another: no light gets there
    }
    let around = Nest::of(&scene, &around);

    // From lights.
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
        let Some(light) = sample.filter(|light| light.wi.dot(n) > 0.0 && light.pdf > 0.0) else { continue };
        let share = if lights <= LIGHTS { 1.0 } else { 1.0 / LIGHTS as f32 };
        let unshadowed = light.radiance * (light.wi.dot(n) * entering(light.wi) * share / light.pdf);
        if !(unshadowed.is_finite() && mean(unshadowed) > 0.0 && scene.illuminates(light.light, si.instance)) {
            continue;
        }
        stats.shadow_rays += 1;
        let origin = Some((si.instance, si.triangle));
        let (o, reach) = (si.origin(light.wi), light.reach());
        let taken = unshadowed * scene.lights.response(light.light)[0];
        let visible = taken * visibility(scene, light.light, o, light.wi, reach, origin, &around);
        record.irradiance += visible;
        record.directions.push((light.wi, mean(visible)));
        record.lights.push(LightRecord { light: light.light, visible: mean(visible), unshadowed: mean(unshadowed) });
    }

    // By way of other surfaces.
    let wi = si.frame.to_world(cosine_hemisphere(Vec2::new(sampler.random(), sampler.random())));
    if wi.dot(n) > 0.0 {
        let settings = PathSettings { max_depth: BOUNCES, lights_visible_to_camera: false };
        let mut path = Path::new(scene, guide, settings, stats);
        path.depth = 1;
        path.inside = around;
        // Lights were asked for already: pdf 0 leaves nothing of those that the segment meets.
        path.previous = Previous::Sampled { p: si.p, n: Some(n), pdf: 0.0, lights: LightsAt::All };
        path.continue_from(&si, wi);
        path.receiver = si.instance;
        path.looks = false;
        while path.segment(sampler).is_some() {}
        let indirect = path.sample.color() * (PI * entering(wi));
        if indirect.is_finite() {
            record.irradiance += indirect;
            record.indirect = Some((wi, mean(indirect)));
        }
    }
    record
}
