//! The vertex at a surface: the light that it is sent, and what becomes of the path there.

use super::direct::Rival;
use super::nest::{hides, side_of};
use super::{Bucket, Path, Previous};
use crate::bsdf::{Boundary, Bsdf, BsdfSample, Event, Response, Side, Surface};
use crate::film::{FirstHit, OnSurface};
use crate::guiding::LightsAt;
use crate::interaction::Interaction;
use crate::math::mean;
use crate::sampling::sampler::Sampler;
use crate::scene::{Coating, SurfaceHit};
use glam::Vec3;

impl Path<'_> {
    /// The vertex at the end of a segment.
    pub(super) fn meet_surface(&mut self, hit: &SurfaceHit, sampler: &mut Sampler) -> Option<()> {
        let mut si = self.scene.interaction(hit, self.d, side_of(&self.inside, hit.instance));
        let coating = self.scene.shade(&mut si, self.cone.width);
        let before = self.sample.direct;
        self.meet_surface_emission(&si, &coating);
        self.note_straight(before);
        if self.depth > self.settings.max_depth {
            return None;
        }
        if hides(self.scene, &self.inside, hit.instance, &coating) {
            self.inside = self.crossed(&si, &coating)?;
            return self.pass_through(&si);
        }
        self.scatter(hit, &si, &coating, sampler)
    }

    /// Next-event estimation and a new direction at a surface.
    fn scatter(&mut self, hit: &SurfaceHit, si: &Interaction, coating: &Coating, sampler: &mut Sampler) -> Option<()> {
        let surface = &coating.surface;
        let recolored = si.display_color.and_then(|color| surface.with_display_color(color));
        let surface = recolored.as_ref().unwrap_or(surface);
        let bsdf = surface.bsdf_beside(si.local(si.wo), si.side, self.inside.index_beside(si.instance));
        let parted = self.parted(hit, si, &bsdf);
        let (bsdf, entry) = parted.map_or((bsdf, None), |(reflecting, entry)| (reflecting, Some(entry)));
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d());
        self.record_seen(si, surface, chosen.as_ref());
        if self.depth > 0 && self.bucket == Bucket::Direct {
            self.bucket = Bucket::Indirect;
        }
        let lights = if self.depth == 0 { self.guide.first_hit_choice() } else { self.lights_at(si, coating) };
        self.next_event(si, &bsdf, lights, Rival::Nothing, sampler);
        if let Some(entry) = entry {
            // The path goes on with numbers of its own, whatever the walk takes.
            let beside = sampler.parted();
            let mut walked = std::mem::replace(sampler, beside);
            self.enter_first(hit, si, coating, &entry, lights, &mut walked);
        }
        self.follow(hit, si, coating, &bsdf, chosen, lights, sampler)
    }

    /// Goes on in the direction that was `chosen`.
    pub(super) fn follow(
        &mut self,
        hit: &SurfaceHit,
        si: &Interaction,
        coating: &Coating,
        bsdf: &Bsdf,
        chosen: Option<BsdfSample>,
        lights: LightsAt,
        sampler: &mut Sampler,
    ) -> Option<()> {
        let chosen = chosen?;
        let wi = si.frame.to_world(chosen.wi);
        let by = self.response(bsdf, chosen.wi, chosen.f, chosen.delta);
        self.throughput *= chosen.f / chosen.pdf;
        let passes = matches!(chosen.event, Event::PassThrough | Event::EnterSubsurface);
        if self.beside.is_some() && self.depth > 0 && !passes {
            self.survive(sampler.next_1d())?;
        }
        match chosen.event {
            Event::PassThrough => self.pass_through(si),
            Event::Reflect => {
                (wi.dot(si.ng) * outside_sign(si.side) > 0.0).then_some(())?;
                self.bounce(si, wi, chosen.delta, chosen.pdf, lights, by)?;
                self.roulette(sampler)
            }
            Event::Scatter => {
                self.bounce(si, wi, chosen.delta, chosen.pdf, lights, by)?;
                self.roulette(sampler)
            }
            Event::Transmit => {
                (wi.dot(si.ng) * outside_sign(si.side) < 0.0).then_some(())?;
                self.transmit(hit, si, coating, wi, chosen.delta, chosen.pdf, lights, by, sampler)
            }
            Event::EnterSubsurface => self.enter_medium(hit, si, coating, below(wi, si.ng), sampler),
        }
    }

    /// How lights are sampled at a surface that is not the first.
    fn lights_at(&self, si: &Interaction, coating: &Coating) -> LightsAt {
        let leaves = matches!(si.side, Side::Inside) && coating.interior.is_some_and(|i| i.medium.scatters());
        let origin = self.scene.placed(si.instance).translation;
        if leaves { self.guide.exit_choice(si.instance, si.p - origin, si.ng) } else { LightsAt::One }
    }

    /// Opacity let the path straight through: nothing is crossed, nothing is sampled anew.
    pub(super) fn pass_through(&mut self, si: &Interaction) -> Option<()> {
        self.cross()?;
        self.continue_from(si, self.d);
        Some(())
    }

    /// Through a dielectric or index-matched boundary, into or out of what the surface encloses.
    fn transmit(
        &mut self,
        hit: &SurfaceHit,
        si: &Interaction,
        coating: &Coating,
        wi: Vec3,
        delta: bool,
        pdf: f32,
        lights: LightsAt,
        by: Option<Response>,
        sampler: &mut Sampler,
    ) -> Option<()> {
        let nest = self.crossed(si, coating)?;
        let entering = matches!(si.side, Side::Outside);
        let scattering = nest.scattering().filter(|body| entering && body.instance == si.instance);
        if scattering.is_some() && self.scene.is_alone(si.instance) {
            return self.enter_medium(hit, si, coating, wi, sampler);
        }
        self.inside = nest;
        match coating.interior {
            // Shadow rays pass it too, so what MIS knows of the segment's start still holds.
            Some(interior) if interior.boundary == Boundary::IndexMatched => self.pass_through(si),
            // Passing a medium that scatters counts where it is left.
            _ if scattering.is_some() => self.turn(si, wi, delta, pdf, lights, by),
            _ => self.bounce(si, wi, delta, pdf, lights, by),
        }
    }

    /// Sets up the next segment along `wi`, sampled at `si`.
    pub(super) fn bounce(
        &mut self,
        si: &Interaction,
        wi: Vec3,
        delta: bool,
        pdf: f32,
        lights: LightsAt,
        by: Option<Response>,
    ) -> Option<()> {
        if matches!(si.side, Side::Inside) && self.inside.contains(si.instance) {
            self.cross()?;
        } else {
            self.depth += 1;
        }
        self.turn(si, wi, delta, pdf, lights, by)
    }

    /// The same without counting it.
    pub(super) fn turn(
        &mut self,
        si: &Interaction,
        wi: Vec3,
        delta: bool,
        pdf: f32,
        lights: LightsAt,
        by: Option<Response>,
    ) -> Option<()> {
        self.turned(by);
        self.previous =
            if delta { Previous::Delta } else { Previous::Sampled { p: si.p, n: si.horizon(), pdf, lights } };
        (self.receiver, self.drawn) = (si.instance, true);
        if !delta {
            self.looks = false;
            self.cone.scattered(pdf);
        }
        self.continue_from(si, wi);
        Some(())
    }

    /// What the camera sees of a surface: alpha and albedo by what the surface holds up, whatever lobe was `chosen`, the rest
    /// by the first sample that does not pass.
    fn record_seen(&mut self, si: &Interaction, surface: &Surface, chosen: Option<&BsdfSample>) {
        if self.seen == 0.0 {
            return;
        }
        let held = self.seen * (1.0 - mean(surface.transparency(si.local(si.wo).z.abs())));
        self.sample.alpha += held;
        self.sample.albedo += held * surface.albedo();
        if let Some(passed) = chosen.filter(|chosen| chosen.event == Event::PassThrough) {
            self.seen *= mean(passed.f / passed.pdf);
            return;
        }
        self.seen = 0.0;
        let scene = self.scene;
        self.sample.first = FirstHit {
            depth: scene.camera.depth(si.p, scene.time),
            normal: si.frame.n,
            position: (si.p.as_dvec3() + scene.camera.origin).as_vec3(),
            prim_id: scene.instances[si.instance as usize].prim_id,
        };
        let surface = OnSurface { instance: si.instance, triangle: si.triangle, barycentric: si.barycentric };
        self.sample.surface = Some(surface);
    }
}

/// +1 where the outward normal is on the side of `wo`, -1 inside.
fn outside_sign(side: Side) -> f32 {
    match side {
        Side::Outside => 1.0,
        Side::Inside => -1.0,
    }
}

/// `w` mirrored at the tangent plane if need be, so that it points below a surface whose shading normal
/// says so: the energy of the lobe is kept.
fn below(w: Vec3, ng: Vec3) -> Vec3 {
    let cos = w.dot(ng);
    if cos > 0.0 { w - 2.0 * cos * ng } else { w }
}
