//! The path integrator: camera ray in, radiance out. One unidirectional path with next-event estimation
//! and multiple importance sampling at surfaces, at exits of media, and at collisions where light gets in.

mod bent;
mod collision;
mod direct;
mod lobes;
mod log;
mod manifold;
mod medium;
mod nest;
mod probe;
mod shadow;
mod wade;
mod watch;

pub use log::WalkLog;
pub use probe::{beams_at, probe};

use crate::bsdf::{Boundary, BsdfSample, Event, Response, Side, Surface};
use crate::camera::CameraRay;
use crate::film::{FirstHit, OnSurface, Sample};
use crate::guiding::{Guide, LightsAt};
use crate::interaction::Interaction;
use crate::math::{Rgb, mean};
use crate::sampling::sampler::Sampler;
use crate::scene::{Coating, Moment, NOBODY, Origin, SurfaceHit};
use crate::subsurface::steps::WalkStats;
use bent::{Aim, Refracted};
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use lobes::By;
use nest::{Inside, Nest};

/// Counts of one or many paths, for the statistics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct PathStats {
    pub rays: u64,
    pub shadow_rays: u64,
    pub walk: WalkStats,
    /// Samples that were not finite; they count as black.
    pub non_finite: u64,
    /// Paths ended by a safety net: reflections trapped inside a dielectric, or a ray through a stack of
    /// transparent surfaces that does not end.
    pub trapped: u64,
}

impl PathStats {
    pub fn add(&mut self, other: &PathStats) {
        self.rays += other.rays;
        self.shadow_rays += other.shadow_rays;
        self.walk.add(&other.walk);
        self.non_finite += other.non_finite;
        self.trapped += other.trapped;
    }
}

/// Limits of a path.
#[derive(Debug, Clone, Copy)]
pub struct PathSettings {
    /// Surface bounces after the first hit; passing a medium counts as one.
    pub max_depth: u32,
    pub lights_visible_to_camera: bool,
}

/// Bounces after which roulette may end a path.
const ROULETTE_DEPTH: u32 = 3;

/// Safety net against rays that neither scatter nor leave (a perfect light trap, stacked transparent
/// faces); counted as `trapped`.
const MAX_CROSSINGS: u32 = 4096;

/// How the current segment was sampled: what MIS needs when it meets a light.
#[derive(Debug, Clone, Copy)]
enum Previous {
    Camera,
    /// By a delta lobe, or with nothing else that could have sampled it.
    Delta,
    /// At `p` with solid-angle pdf `pdf`. Light was sampled there too, on the side of `n` if there is one.
    Sampled {
        p: Vec3,
        n: Option<Vec3>,
        pdf: f32,
        lights: LightsAt,
    },
    /// Out of a smooth dielectric, after a collision that sampled light too.
    Refracted(Refracted),
}

/// AOV that light found next belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bucket {
    Direct,
    Indirect,
    Subsurface,
}

/// The footprint of a path, for the levels of images (after Igehy 1999 and Bekaert et al. 2003, with one width).
#[derive(Debug, Clone, Copy)]
struct Cone {
    /// Across the ray where it starts, stage units.
    width: f32,
    /// Growth of the width per stage unit.
    spread: f32,
}

impl Cone {
    /// Of a path that has scattered already.
    const WIDE: Self = Self { width: 0.0, spread: 0.5 };

    fn at(&self, t: f32) -> f32 {
        self.width + self.spread * t
    }

    /// After a direction of density `pdf` was drawn: the quarter of the solid angle that a sample stands for keeps what
    /// a few samples see sharp.
    fn scattered(&mut self, pdf: f32) {
        self.spread = self.spread.max(0.25 * pdf.max(1e-3).sqrt().recip()).min(Self::WIDE.spread);
    }
}

struct Path<'a> {
    scene: Moment<'a>,
    guide: &'a Guide,
    /// Where walks are logged; `None`: they have nothing to teach.
    log: Option<&'a mut WalkLog>,
    settings: PathSettings,
    stats: &'a mut PathStats,
    sample: Sample,
    throughput: Rgb,
    depth: u32,
    crossings: u32,
    bucket: Bucket,
    previous: Previous,
    /// Nothing but mirrors since the camera: what it meets, the camera sees.
    looks: bool,
    by: By,
    /// Of the last collision of a walk.
    aim: Option<Aim>,
    /// Share of the pixel that nothing has held up yet, over the probability of having come here; 0 once something has.
    seen: f32,
    inside: Nest,
    cone: Cone,
    // The next segment.
    o: Vec3,
    d: Vec3,
    t_max: f32,
    origin: Origin,
    /// What sent it on its way: lights are linked to that.
    receiver: u32,
    /// Its direction is drawn, not given by the one before it.
    drawn: bool,
    /// Barycentrics of `o` on it.
    at: Vec2,
    /// Sums of AOVs of lights; empty where none is asked for.
    groups: &'a mut [Rgb],
    /// By [`crate::flat::LOBE_AOVS`]; empty where none is asked for.
    lobes: &'a mut [Rgb],
}

/// Radiance along a camera ray. Estimates may be negative where control variates are on; `log` takes what the walks
/// have to teach, `groups` what each AOV of lights shows of the sample, `lobes` what each of [`crate::flat::LOBE_AOVS`] does
/// (empty: none is wanted).
pub fn trace(
    scene: Moment,
    guide: &Guide,
    settings: PathSettings,
    ray: CameraRay,
    sampler: &mut Sampler,
    stats: &mut PathStats,
    log: &mut WalkLog,
    groups: &mut [Rgb],
    lobes: &mut [Rgb],
) -> Sample {
    groups.fill(Rgb::ZERO);
    lobes.fill(Rgb::ZERO);
    let (width, spread) = scene.camera.footprint();
    let cone = Cone { width, spread };
    let mut path = Path::new(scene, guide, settings, stats);
    (path.o, path.d, path.t_max, path.cone) = (ray.o, ray.d, ray.t_max, cone);
    path.log = Some(log);
    path.groups = groups;
    path.by.told |= !lobes.is_empty();
    path.lobes = lobes;
    if !scene.camera_within.is_empty() {
        path.inside = Nest::of(&scene, &scene.camera_within);
        // Radiance over the square of the index is what comes out of a medium: a sensor is not wet, its housing is.
        path.throughput /= path.inside.index_beside(u32::MAX).powi(2);
    }
    while path.segment(sampler).is_some() {}
    path.finish_walks();
    let sample = path.sample;
    if !sample.color().is_finite() {
        path.stats.non_finite += 1;
        path.groups.fill(Rgb::ZERO);
        path.lobes.fill(Rgb::ZERO);
        return Sample { direct: Rgb::ZERO, straight: Rgb::ZERO, indirect: Rgb::ZERO, subsurface: Rgb::ZERO, ..sample };
    }
    sample
}

impl<'a> Path<'a> {
    /// A path at the camera that goes nowhere yet.
    #[inline(always)] // half a kilobyte that is made in place
    fn new(scene: Moment<'a>, guide: &'a Guide, settings: PathSettings, stats: &'a mut PathStats) -> Self {
        Self {
            scene,
            guide,
            log: None,
            settings,
            stats,
            sample: Sample::BLACK,
            throughput: Rgb::ONE,
            depth: 0,
            crossings: 0,
            bucket: Bucket::Direct,
            previous: Previous::Camera,
            looks: true,
            by: By::nothing(scene.lights.has_responses()),
            aim: None,
            seen: 1.0,
            inside: Nest::OUTSIDE,
            cone: Cone::WIDE,
            o: Vec3::ZERO,
            d: Vec3::Z,
            t_max: f32::INFINITY,
            origin: None,
            receiver: NOBODY,
            drawn: false,
            at: Vec2::ZERO,
            groups: &mut [],
            lobes: &mut [],
        }
    }
}

impl Path<'_> {
    /// One segment and the vertex at its end; `None` when the path is over.
    fn segment(&mut self, sampler: &mut Sampler) -> Option<()> {
        if let Some(body) = self.inside.scattering() {
            return self.wade(*body, sampler);
        }
        self.stats.rays += 1;
        self.meet_ruled_lights_once();
        let hit = self.scene.closest(self.o, self.d, self.t_max, self.origin);
        let before = self.sample.direct;
        self.meet_light_shapes(hit.as_ref().map_or(self.t_max, |hit| hit.t));
        if hit.is_none() {
            self.meet_infinite_lights();
        }
        self.note_straight(before);
        let hit = hit?;
        self.throughput *= self.inside.transmittance(hit.t);
        self.cone.width = self.cone.at(hit.t);
        self.meet_surface(&hit, sampler)
    }

    /// Those of a direction that was drawn at the start of a segment.
    fn meet_ruled_lights_once(&mut self) {
        if std::mem::take(&mut self.drawn) && self.scene.lights.has_shadow_rules() {
            self.meet_ruled_lights();
        }
    }

    /// The vertex at the end of a segment.
    fn meet_surface(&mut self, hit: &SurfaceHit, sampler: &mut Sampler) -> Option<()> {
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

    /// What a segment has met since the direct light was `before` came straight to the camera, if nothing bent its path.
    fn note_straight(&mut self, before: Rgb) {
        if matches!(self.previous, Previous::Camera) {
            self.sample.straight += self.sample.direct - before;
        }
    }

    /// The bodies around the path beyond the boundary at `si`.
    fn crossed(&mut self, si: &Interaction, coating: &Coating) -> Option<Nest> {
        let nest = crossed(self.scene, &self.inside, si, coating);
        self.stats.trapped += u64::from(nest.is_none());
        nest
    }

    /// Next-event estimation and a new direction at a surface.
    fn scatter(&mut self, hit: &SurfaceHit, si: &Interaction, coating: &Coating, sampler: &mut Sampler) -> Option<()> {
        let surface = &coating.surface;
        let recolored = si.display_color.and_then(|color| surface.with_display_color(color));
        let surface = recolored.as_ref().unwrap_or(surface);
        let bsdf = surface.bsdf_beside(si.local(si.wo), si.side, self.inside.index_beside(si.instance));
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d());
        self.record_seen(si, surface, chosen.as_ref());
        if self.depth > 0 && self.bucket == Bucket::Direct {
            self.bucket = Bucket::Indirect;
        }
        let lights = if self.depth == 0 { self.guide.first_hit_choice() } else { self.lights_at(si, coating) };
        self.next_event(si, &bsdf, lights, None, sampler);

        let chosen = chosen?;
        let wi = si.frame.to_world(chosen.wi);
        let by = self.response(&bsdf, chosen.wi, chosen.f, chosen.delta);
        self.throughput *= chosen.f / chosen.pdf;
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
    fn pass_through(&mut self, si: &Interaction) -> Option<()> {
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
    fn bounce(
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
    fn turn(
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

    /// A medium has scattered the path.
    fn be_scattered(&mut self) {
        self.bucket = self.bucket_of_media();
        self.looks = false;
    }

    /// AOV of what media scatter into the path.
    fn bucket_of_media(&self) -> Bucket {
        match self.bucket {
            _ if self.depth == 0 => Bucket::Subsurface,
            Bucket::Direct => Bucket::Indirect,
            other => other,
        }
    }

    fn continue_from(&mut self, si: &Interaction, wi: Vec3) {
        self.o = si.origin(wi);
        self.d = wi;
        self.t_max = f32::INFINITY;
        self.origin = Some((si.instance, si.triangle));
        self.at = si.barycentric;
    }

    fn cross(&mut self) -> Option<()> {
        self.crossings += 1;
        if self.crossings < MAX_CROSSINGS {
            return Some(());
        }
        self.stats.trapped += 1;
        None
    }

    fn roulette(&mut self, sampler: &mut Sampler) -> Option<()> {
        if self.depth + self.crossings < ROULETTE_DEPTH {
            return Some(());
        }
        let survival = self.throughput.max_element().min(1.0);
        if sampler.random() >= survival {
            return None;
        }
        self.throughput /= survival;
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

    /// Adds light of `source`, a light or GLOW, that the segment has met.
    fn add(&mut self, source: u32, light: Rgb) {
        self.add_by(self.by.last, source, light);
    }

    /// Adds light that a vertex has sent this way.
    fn add_by(&mut self, by: Option<Response>, source: u32, light: Rgb) {
        let mut light = self.throughput * light;
        if self.by.told {
            light = self.by.sorted(&self.scene, self.bucket, by, source, light, self.lobes);
        }
        add_to(&mut self.sample, self.bucket, light);
        if !self.groups.is_empty() {
            self.scene.lights.sort(self.groups, source, light);
        }
    }
}

fn side_of(inside: &Nest, instance: u32) -> Side {
    if inside.contains(instance) { Side::Inside } else { Side::Outside }
}

/// Whether a surface of `instance` is not there, for a path amid the bodies `inside`.
fn hides(scene: Moment, inside: &Nest, instance: u32, coating: &Coating) -> bool {
    let Some(interior) = coating.interior.filter(|_| !inside.is_empty()) else { return false };
    let priority = scene.instances[instance as usize].priority;
    interior.boundary != Boundary::Diffuse && inside.hides(instance, priority, interior.boundary)
}

/// The bodies beyond the boundary at `si` for a path amid `inside`; `None` where they are too many.
fn crossed(scene: Moment, inside: &Nest, si: &Interaction, coating: &Coating) -> Option<Nest> {
    match si.side {
        Side::Inside => Some(inside.left(si.instance)),
        Side::Outside => {
            let priority = scene.instances[si.instance as usize].priority;
            inside.entered(Inside::new(si.instance, si.surface, priority, coating.interior))
        }
    }
}

fn add_to(sample: &mut Sample, bucket: Bucket, light: Rgb) {
    match bucket {
        Bucket::Direct => sample.direct += light,
        Bucket::Indirect => sample.indirect += light,
        Bucket::Subsurface => sample.subsurface += light,
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
