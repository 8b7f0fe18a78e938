//! Light: what a segment meets, and next-event estimation towards what it might have met.

use super::nest::Nest;
use super::rough::CameFrom;
use super::shadow::visibility;
use super::{Path, Previous};
use crate::bsdf::{Bsdf, Side};
use crate::guiding::LightsAt;
use crate::guiding::exit::Exit;
use crate::interaction::Interaction;
use crate::light::{Choice, GLOW, LightSample, ShapeHit};
use crate::math::Rgb;
use crate::medium::Medium;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{Coating, Moment};
use glam::{Vec2, Vec3};

/// Generator of the R2 sequence (Roberts 2018): inverse powers of the plastic number.
pub(super) const R2: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);

/// What else finds the light that is sampled at a surface, beside its BSDF.
#[derive(Clone, Copy)]
pub(super) enum Rival<'a> {
    Nothing,
    /// Directions are drawn from a mixture of the BSDF and this.
    Guide(&'a Exit),
    /// Looks of the walk's last collision.
    Looks(CameFrom<'a>),
}

impl Path<'_> {
    /// Adds the light shapes crossed before `t_max`.
    pub(super) fn meet_light_shapes(&mut self, t_max: f32) {
        if self.scene.has_light_shapes() {
            self.meet_light_shapes_along(self.o, self.d, t_max, self.inside.medium());
        }
    }

    /// Adds the light shapes crossed along (o, d) before `t_max`, in `medium`. They occlude nothing, so all of them count.
    pub(super) fn meet_light_shapes_along(&mut self, o: Vec3, d: Vec3, t_max: f32, medium: Option<Medium>) {
        let scene = self.scene;
        scene.light_shapes(o, d, t_max, |light, hit| {
            let radiance = scene.lights().radiance_hit(light, d, hit);
            if radiance == Rgb::ZERO || self.asked(light) {
                return;
            }
            let weight = self.weight_of_hit(light, o, d, hit);
            self.see_light(light, weight * medium.map_or(Rgb::ONE, |m| m.transmittance(hit.t)) * radiance);
        });
    }

    pub(super) fn meet_infinite_lights(&mut self) {
        let scene = self.scene;
        let d = self.d;
        for &light in scene.lights.infinite() {
            let radiance = scene.lights().escaped(light, d);
            if radiance == Rgb::ZERO || self.asked(light) {
                continue;
            }
            let weight = self.weight_of_escaped(light, d);
            self.see_light(light, weight * self.inside.transmittance(f32::INFINITY) * radiance);
        }
    }

    /// Emission of the surface material, and of the light that the mesh is.
    pub(super) fn meet_surface_emission(&mut self, si: &Interaction, coating: &Coating) {
        let scene = self.scene;
        let glow = if matches!(si.side, Side::Outside) { coating.surface.emission() } else { Rgb::ZERO };
        let Some((light, first)) = scene.instances[si.instance as usize].light else {
            self.add(GLOW, glow);
            return;
        };
        if glow != Rgb::ZERO && self.looks {
            // Who looks at a mesh light sees its material glow (light:materialSyncMode); the light is for the others.
            self.add(GLOW, glow);
            return;
        }
        if !si.front || self.asked(light) {
            return;
        }
        let (o, d) = (self.o, self.d);
        let hit = ShapeHit::on_mesh((si.p - o).dot(d), first + si.triangle);
        let radiance = scene.lights().radiance_hit(light, d, &hit);
        let weight = match self.previous {
            // The mesh is there for the camera to see, lit up.
            Previous::Camera => Rgb::ONE,
            _ => self.weight_of_hit(light, o, d, &hit),
        };
        self.add(light, weight * radiance);
    }

    /// MIS weight of an area light met at `hit` along (o, d).
    pub(super) fn weight_of_hit(&self, light: u32, o: Vec3, d: Vec3, hit: &ShapeHit) -> Rgb {
        let lights = self.scene.lights_for(self.receiver);
        self.light_weight(|p, n, choice| lights.pdf_hit(light, p, n, choice, d, &seen_from(p, o, d, hit)), light)
    }

    /// MIS weight of an infinite light met along `d`.
    pub(super) fn weight_of_escaped(&self, light: u32, d: Vec3) -> Rgb {
        let lights = self.scene.lights_for(self.receiver);
        self.light_weight(|p, n, choice| lights.pdf_escaped(light, p, n, choice, d), light)
    }

    /// MIS weight of a light met by the segment; 0 where the camera must not see it, or the light is not for what sent
    /// the path this way.
    fn light_weight(&self, light_pdf: impl Fn(Vec3, Option<Vec3>, Choice) -> f32, light: u32) -> Rgb {
        if !self.scene.illuminates(light, self.receiver) {
            return Rgb::ZERO;
        }
        match self.previous {
            Previous::Delta => Rgb::ONE,
            // No collision looks for the light of meshes.
            Previous::Refracted(_) if self.scene.lights.is_mesh(light) => Rgb::ONE,
            Previous::Refracted(last) => Rgb::splat(last.weight(self.scene, self.guide, light, self.d)),
            Previous::Camera => {
                let visible = self.settings.lights_visible_to_camera || self.scene.lights.camera_visible(light);
                Rgb::splat(if visible { 1.0 } else { 0.0 })
            }
            // Next-event estimation looks to the outside only: what was refracted the other way is ours alone.
            Previous::Sampled { n: Some(n), .. } if self.d.dot(n) <= 0.0 => Rgb::ONE,
            Previous::Sampled { p, n, pdf, lights } => {
                Rgb::splat(power_heuristic(pdf, light_pdf(p, n, self.guide.choice(lights))))
            }
        }
    }

    pub(super) fn see_light(&mut self, source: u32, light: Rgb) {
        if light == Rgb::ZERO {
            return;
        }
        if matches!(self.previous, Previous::Camera) {
            self.sample.alpha += self.seen;
            self.seen = 0.0;
        }
        self.add(source, light);
    }

    /// Light sampled at a surface, weighted against what else could have found it.
    pub(super) fn next_event(
        &mut self,
        si: &Interaction,
        bsdf: &Bsdf,
        lights: LightsAt,
        rival: Rival,
        sampler: &mut Sampler,
    ) {
        if bsdf.is_delta_only() {
            sampler.skip_1d();
            sampler.skip_2d();
        } else if matches!(si.side, Side::Inside) && self.inside.contains(si.instance) {
            let beyond = self.inside.left(si.instance);
            self.next_event_amid(si, bsdf, lights, rival, Some(&beyond), sampler);
        } else {
            self.next_event_amid(si, bsdf, lights, rival, None, sampler);
        }
    }

    /// The same, `beyond`: the bodies on the far side of the surface, where they are others than those around the path.
    fn next_event_amid(
        &mut self,
        si: &Interaction,
        bsdf: &Bsdf,
        lights: LightsAt,
        rival: Rival,
        beyond: Option<&Nest>,
        sampler: &mut Sampler,
    ) {
        let (all, choice) = (self.scene.lights_for(si.instance), self.guide.choice(lights));
        let (count, n) = (choice.count(), si.horizon());
        // A sample's points on a light are a lattice (Roberts' R2), shifted by its stratified first.
        let lattice = |first: Vec2, i: u32| (first + i as f32 * R2).fract();
        if let Choice::Drawn { .. } = choice {
            let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
            let mut draws = all.draws(si.p, n, choice);
            for i in 0..count {
                // Strata of the choice: neighbours in the tree are neighbours in space.
                let u_choice = (u_choice + i as f32) / count as f32;
                let u = lattice(u, i);
                self.add_light(si, bsdf, rival, beyond, draws.draw(u_choice, u), u);
            }
            return;
        }
        sampler.skip_1d();
        if all.is_empty() {
            sampler.skip_2d();
        }
        for light in 0..all.len() as u32 {
            if !(all.reaches(light, si.p, n) && self.scene.illuminates(light, si.instance)) {
                sampler.skip_2d();
                continue;
            }
            let first = sampler.next_2d();
            for i in 0..count {
                let u = lattice(first, i);
                let sample = all.sample_light(light, si.p, n, u);
                self.add_light(si, bsdf, rival, beyond, sample.map(|sample| (sample, count as f32)), u);
            }
        }
    }

    /// `sampled`: with the numbers `u`, one of as many as are expected of that light.
    fn add_light(
        &mut self,
        si: &Interaction,
        bsdf: &Bsdf,
        rival: Rival,
        beyond: Option<&Nest>,
        sampled: Option<(LightSample, f32)>,
        u: Vec2,
    ) {
        let Some((sample, expected)) = sampled else { return };
        let light = LightSample { pdf: sample.pdf * expected, ..sample };
        let inside = beyond.unwrap_or(&self.inside);
        let guide = if let Rival::Guide(guide) = rival { Some(guide) } else { None };
        let Some(arriving) = arriving(self.scene, si, bsdf, guide, inside, &light) else { return };
        self.stats.shadow_rays += 1;
        if arriving.light == Rgb::ZERO {
            return; // in shadow: what looks would have made of it takes two rays
        }
        let weight = if let Rival::Looks(from) = rival { from.weight(self.scene, &sample, u) } else { 1.0 };
        let by = self.response(bsdf, si.local(light.wi), arriving.f, false);
        self.add_by(by, light.light, weight * arriving.light);
    }
}

/// Light of a sample that a surface sends on.
pub(super) struct Arriving {
    /// f |cos|.
    pub f: Rgb,
    /// f / pdf of it, weighted against the sampling of the same direction by the BSDF, or by a mixture of it and a guide.
    pub light: Rgb,
}

/// What arrives of a light sample, `inside` the bodies around its way. `None`: nothing could, and no shadow ray was cast.
pub(super) fn arriving(
    scene: Moment,
    si: &Interaction,
    bsdf: &Bsdf,
    guide: Option<&Exit>,
    inside: &Nest,
    light: &LightSample,
) -> Option<Arriving> {
    (light.pdf > 0.0 && light.pdf.is_finite()).then_some(())?;
    let wi = si.local(light.wi);
    let f = bsdf.eval(wi);
    // Towards the outside only, and shading and geometric normal must agree which side that is.
    let hidden = si.horizon().is_some_and(|n| light.wi.dot(n) <= 0.0 || wi.z <= 0.0);
    if f == Rgb::ZERO || light.radiance == Rgb::ZERO || hidden {
        return None;
    }
    let origin = Some((si.instance, si.triangle));
    let (o, reach) = (si.origin(light.wi), light.reach());
    let visible = visibility(scene, light.light, o, light.wi, reach, origin, inside);
    let pdf = || guide.map_or(bsdf.pdf(wi), |guide| guide.pdf(bsdf.pdf(wi), light.wi));
    let weight = if light.delta { 1.0 } else { power_heuristic(light.pdf, pdf()) };
    Some(Arriving { f, light: f * visible * light.radiance * (weight / light.pdf) })
}

/// A hit as the light's pdf wants it: its distance from `p`, where the direction was sampled. A segment that
/// passed transparent boundaries begins later on the same line.
fn seen_from(p: Vec3, o: Vec3, d: Vec3, hit: &ShapeHit) -> ShapeHit {
    ShapeHit { t: hit.t + (o - p).dot(d), ..*hit }
}
