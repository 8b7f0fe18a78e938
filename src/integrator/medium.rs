//! Passing an object's inside: sub-walks from boundary to boundary until the light gets out.

use super::bent::{Bent, Refracted};
use super::collision::{Bends, CollisionLight, Into};
use super::conditional::away;
use super::direct::Rival;
use super::entry::Notes;
use super::leave::Begun;
use super::nest::Nest;
use super::rough::{CameFrom, Rough};
use super::suns::FirstWay;
use super::{Path, Previous};
use crate::bsdf::{Boundary, Event, Response, Side, Surface};
use crate::guiding::look::shares_by_kind;
use crate::guiding::plan::{Looks, Plan, Walk};
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, Coating, InstanceEnclosure, SurfaceHit};
use crate::subsurface::mixture::{Visitor, walk_mixture};
use crate::subsurface::steps::{Enclosure, Start, WalkEnd};
use crate::subsurface::technique::{Densities, GuidedMedium};
use crate::subsurface::walk::{Collision, Role};
use glam::Vec3;

/// The last collision of a walk and the solid-angle pdf with which it went on, as in [`WalkEnd::Boundary`].
pub(super) type Scattered = Option<(Vec3, f32)>;

/// The medium that a path is in.
pub(super) struct Passage<'a> {
    pub enclosure: InstanceEnclosure<'a>,
    pub instance: u32,
    /// The boundary, where it bends light that is sampled through it.
    pub bends: Option<Bends<'a>>,
    pub plan: &'a Plan,
    pub medium: &'a GuidedMedium,
    /// No boundary was met yet.
    pub first: bool,
    /// Its walks note their vertices for the pixels around.
    pub noted: bool,
}

impl Passage<'_> {
    /// What looks through a rough boundary compete with where a walk meets it at `p` (walk space) along `d`, if they do.
    fn came_from(&self, scattered: Scattered, entry: Vec3, p: Vec3, d: Vec3) -> Option<CameFrom<'_>> {
        let Some(Bends::Rough(rough)) = &self.bends else { return None };
        let (x, _) = scattered?;
        Some(CameFrom { rough, enclosure: &self.enclosure, instance: self.instance, entry, x, d, t: (p - x).length() })
    }
}

impl<'a> Path<'a> {
    /// Enters the medium behind `si` along `wi` and follows it to the outside. The medium and the boundary
    /// are those of `coating`, that of the entry, wherever the walk comes out; a bent normal is that of the exit.
    pub(super) fn enter_medium(
        &mut self,
        hit: &SurfaceHit,
        si: &Interaction,
        coating: &Coating,
        wi: Vec3,
        sampler: &mut Sampler,
    ) -> Option<()> {
        let scene = self.scene;
        let interior = coating.interior?;
        let boundary = interior.boundary;
        let (plan, medium) = self.guide.plan(si.surface)?;
        let here;
        let medium = if medium.medium == interior.medium {
            medium
        } else {
            here = plan.medium_at(interior.medium);
            &here
        };
        if boundary == Boundary::Diffuse {
            // By itself it scatters what passes it.
            self.bucket = self.bucket_of_media();
        }
        let enclosure = InstanceEnclosure::new(scene, si.instance);
        let beside = self.inside.index_beside(si.instance);
        let bends = match plan.looks {
            // The search knows the boundary in air.
            Looks::Smooth | Looks::Suns if beside == 1.0 => {
                let beams = self.guide.beams_in(si.instance).filter(|_| plan.looks == Looks::Smooth);
                Bent::new(self.guide, scene, si.instance, si.surface, beams).map(Bends::Smooth)
            }
            Looks::Rough => {
                Rough::new(self.guide, &coating.surface, interior.medium, beside, self.cone.width).map(Bends::Rough)
            }
            _ => None,
        };
        let (instance, first) = (si.instance, self.depth == 0);
        let mut passage = Passage { enclosure, instance, bends, plan, medium, first, noted: false };
        let around = match boundary {
            Boundary::IndexMatched => Some(self.crossed(si, coating)?),
            Boundary::Dielectric if passage.bends.is_some() => Some(self.inside),
            _ => None,
        };
        let entry = BoundaryHit::of(hit);
        let p = passage.enclosure.point(&entry);
        if let (Some(within), Boundary::IndexMatched, true) = (&around, boundary, scene.has_light_shapes()) {
            self.meet_lights_within(&passage.enclosure, p, wi, entry, within);
        }
        if boundary == Boundary::Diffuse {
            self.outlasts(instance, p, si.ng, sampler)?;
        }
        let mut start = Start { p, d: wi, normal: si.ng, hit: entry, weight: Rgb::ONE };
        if plan.shares && first {
            passage.noted = self.note_entry(si, start, medium, boundary);
        }
        let mut last = None;
        loop {
            let light = self.light_at_collisions(&passage, around.as_ref(), start.normal);
            let (at, d, scattered) = self.sub_walk(&passage, start, light, sampler)?;
            if let Some((p, pdf)) = scattered {
                self.be_scattered();
                if boundary == Boundary::IndexMatched {
                    self.collided(instance, passage.enclosure.to_render(p), pdf);
                }
            }
            passage.first = false;
            let mut exit = scene.interaction(&passage.enclosure.surface_hit(&at), d, Side::Inside);
            scene.bend(&mut exit, self.cone.width);
            match boundary {
                Boundary::IndexMatched => {
                    self.continue_from(&exit, d);
                    return self.cross();
                }
                Boundary::Diffuse => return self.leave_diffuse(&exit, passage.enclosure.point_of_hit(&at), sampler),
                Boundary::Dielectric => {
                    let p = passage.enclosure.point(&at);
                    last = self.way_from_light(&passage, scattered, last, p, d, start.p);
                    let from = passage.came_from(scattered, start.normal, p, d);
                    match self.meet_dielectric(&coating.surface, beside, &exit, p, from, sampler)? {
                        Some(reflected) => {
                            self.cross()?;
                            start = Start { p, d: reflected, normal: exit.ng, hit: at, weight: Rgb::ONE };
                        }
                        None => {
                            if let (Some(last), Some(Bends::Smooth(bent))) = (last, &passage.bends) {
                                self.previous = Previous::Refracted(last.out(bent, &exit));
                            }
                            return Some(());
                        }
                    }
                }
            }
        }
    }

    /// Light shapes inside a matched medium, as seen from the entry at `p` along `d`, by what passes without a collision:
    /// exactly, where the walk would have to get that far. After collisions next-event estimation has them alone.
    pub(super) fn meet_lights_within(
        &mut self,
        enclosure: &InstanceEnclosure,
        p: Vec3,
        d: Vec3,
        entry: BoundaryHit,
        within: &Nest,
    ) {
        let t_max = enclosure.cast(p, d, f32::INFINITY, Some(entry)).map_or(f32::INFINITY, |(t, _)| t);
        let before = self.sample.direct;
        self.meet_light_shapes_along(enclosure.to_render(p), d, t_max, within.medium());
        self.note_straight(before);
    }

    /// What MIS needs of a direction that a collision at `p` (render space) in `instance` drew, where it sampled light too:
    /// all of those with shadow rules, whose distances are from the collision.
    pub(super) fn collided(&mut self, instance: u32, p: Vec3, pdf: f32) {
        let lights = crate::guiding::LightsAt::One;
        self.previous = Previous::Sampled { p, n: None, pdf, lights };
        self.by.last = Some(Response::Scattered);
        self.receiver = instance;
    }

    /// Light reaches collisions straight only where the boundary does not bend it. `around`: of bodies, where it does.
    fn light_at_collisions<'b>(
        &self,
        passage: &Passage<'b>,
        around: Option<&'b Nest>,
        entry: Vec3,
    ) -> Option<CollisionLight<'b>>
    where
        'a: 'b,
    {
        let (scene, instance, bends) = (self.scene, passage.instance, passage.bends);
        let (bucket, by) = (self.bucket_of_media(), self.by);
        Some(CollisionLight { scene, instance, around: around?, scale: 1.0, bucket, by, bends, entry })
    }

    /// What MIS needs where a path meets a light beyond a bent boundary: its way to `p` (walk space) along `d` since its last
    /// collision, or since `start` where a collision before that is the `last`.
    fn way_from_light(
        &self,
        passage: &Passage,
        scattered: Scattered,
        last: Option<Refracted>,
        p: Vec3,
        d: Vec3,
        start: Vec3,
    ) -> Option<Refracted> {
        let Some(Bends::Smooth(bent)) = &passage.bends else { return None };
        match scattered {
            Some((x, pdf)) => bent.from(d, pdf, self.aim, FirstWay { x, p }).further(bent, (p - x).length()),
            None => last?.further(bent, (p - start).length()),
        }
    }

    /// One walk to the next boundary point: where, in which direction it arrives, and its last collision with the pdf of
    /// that direction.
    pub(super) fn sub_walk(
        &mut self,
        passage: &Passage,
        mut start: Start<BoundaryHit>,
        light: Option<CollisionLight>,
        sampler: &mut Sampler,
    ) -> Option<(BoundaryHit, Vec3, Scattered)> {
        let scale = self.throughput.max_element();
        (scale > 0.0).then_some(())?;
        start.weight = self.throughput / scale;
        let end = match light {
            Some(light) => {
                let light = CollisionLight { scale, ..light };
                self.walk::<true>(passage, start, scale, Some(light), sampler)
            }
            None => self.walk::<false>(passage, start, scale, None, sampler),
        };
        sampler.end_walk();
        let WalkEnd::Boundary { hit, d, weight, scattered, .. } = end else { return None };
        self.throughput = scale * weight;
        Some((hit, d, scattered))
    }

    /// The walk that the plan says.
    fn walk<const LIT: bool>(
        &mut self,
        passage: &Passage,
        start: Start<BoundaryHit>,
        scale: f32,
        light: Option<CollisionLight>,
        sampler: &mut Sampler,
    ) -> WalkEnd<BoundaryHit> {
        if passage.first {
            self.begun = None; // that of a body which was passed before
        }
        if !passage.plan.exact {
            return self.conditional_walk(passage, start, scale * start.weight, light, sampler);
        }
        let kind = passage.plan.walk;
        let guide = self.guide.start(kind, passage.instance, start.p, start.normal);
        let u = if self.guide.stratify { sampler.next_1d() } else { sampler.random() };
        let logs = self.log.is_some() && guide.region.is_some();
        let throughput = scale * start.weight;
        let (before, segments, spent) = (self.sample, self.stats.walk.steps, self.cost());
        if passage.first {
            let throughput = throughput.max_element();
            self.begun = guide.onward.map(|onward| Begun { onward, throughput, logged: None });
        }
        if let Some(entry) = self.entry(passage.first && passage.noted) {
            entry.know(guide.onward.as_ref());
        }
        let mut visitor: Collisions<'_, LIT> = Collisions {
            passage,
            light,
            cp: kind == Walk::Cp,
            notes: self.log.as_mut().filter(|_| passage.noted).and_then(|log| log.notes(throughput, passage.first)),
            late: None,
            into: Into::new(&mut self.sample, &mut *self.groups, &mut *self.lobes),
            shadow_rays: 0,
        };
        let stats = &mut self.stats.walk;
        let techniques = guide.techniques;
        let end = walk_mixture(&passage.enclosure, passage.medium, techniques, start, u, sampler, stats, &mut visitor);
        let (late, shadow_rays) = (visitor.late, visitor.shadow_rays);
        if let (Some(notes), WalkEnd::Boundary { hit, d, .. }) = (&mut visitor.notes, end.end) {
            let at = (passage.enclosure.point(&hit), passage.enclosure.normal(&hit));
            notes.exit(at, d, end.densities.weight(), end.densities.ratios(), &visitor.into);
        }
        self.aim = visitor.into.aim;
        self.stats.shadow_rays += shadow_rays;
        if logs {
            let ratios = end.densities.ratios();
            let before = before.color();
            let logged = self.log_walk(guide.region, guide.controls, ratios, throughput, before, spent, passage.first);
            if let (true, Some(begun)) = (passage.first, &mut self.begun) {
                begun.logged = logged;
            }
        }
        if passage.first && self.guide.watched() {
            let normal = |lane| if kind == Walk::Cp { late } else { Some(techniques.normal(lane)) };
            let shares = shares_by_kind(&techniques, kind.has_entry(guide.region.is_some()));
            let segments = self.stats.walk.steps - segments;
            self.watch(passage.instance, &start, segments, end.technique.lane.and_then(normal), shares);
        }
        end.end
    }

    /// A dielectric boundary seen from inside at `p`, walk space: `Some(Some(wi))` reflected back in along wi,
    /// `Some(None)` out.
    fn meet_dielectric(
        &mut self,
        surface: &Surface,
        beside: f32,
        exit: &Interaction,
        p: Vec3,
        from: Option<CameFrom>,
        sampler: &mut Sampler,
    ) -> Option<Option<Vec3>> {
        let bsdf = surface.bsdf_beside(exit.local(exit.wo), Side::Inside, beside);
        let lights = self.guide.exit_choice(exit.instance, p, exit.ng);
        self.next_event(exit, &bsdf, lights, from.map_or(Rival::Nothing, Rival::Looks), sampler);
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d())?;
        let wi = exit.frame.to_world(chosen.wi);
        let by = self.response(&bsdf, chosen.wi, chosen.f, chosen.delta);
        self.throughput *= chosen.f / chosen.pdf;
        let outward = wi.dot(exit.ng) > 0.0;
        match chosen.event {
            Event::Reflect => (!outward).then_some(Some(wi)),
            _ => {
                outward.then_some(())?;
                self.bounce(exit, wi, chosen.delta, chosen.pdf, lights, by)?;
                Some(None)
            }
        }
    }
}

/// What a path does along a walk of the mixture: light at collisions, the closest point's normal.
struct Collisions<'a, const LIT: bool> {
    passage: &'a Passage<'a>,
    light: Option<CollisionLight<'a>>,
    cp: bool,
    /// Where the first collisions are noted for other pixels.
    notes: Option<Notes<'a>>,
    /// The closest point's normal, once known.
    late: Option<Vec3>,
    into: Into<'a>,
    shadow_rays: u64,
}

impl<const LIT: bool> Visitor for Collisions<'_, LIT> {
    const AT_COLLISIONS: bool = LIT;

    fn notes(&self) -> bool {
        self.notes.as_ref().is_some_and(Notes::has_room)
    }

    fn vertex(&mut self, p: Vec3, densities: &Densities, survived: f32) {
        if let Some(notes) = &mut self.notes {
            notes.collision(p, densities.weight() / survived, densities.ratios(), &self.into);
        }
    }

    fn leaked(&mut self, p: Vec3, densities: &Densities) {
        if let Some(notes) = &mut self.notes {
            notes.leak(p, densities.weight(), densities.ratios(), &self.into);
        }
    }

    fn late_normal(&mut self, p: Vec3) -> Option<Vec3> {
        if self.cp {
            self.late = away(p, self.passage.enclosure.closest_point(p)?);
        }
        self.late
    }

    fn looks(&mut self, p: Vec3, sampler: &mut Sampler) -> bool {
        let enclosure = &self.passage.enclosure;
        self.light.as_ref().is_some_and(|light| light.looks(p, Role::Own, enclosure, sampler, &mut self.into))
    }

    fn collide(&mut self, collision: &Collision, sampler: &mut Sampler) {
        let Some(light) = &self.light else { return };
        self.shadow_rays += light.add(collision, &self.passage.enclosure, sampler, &mut self.into);
    }
}
