//! The path integrator: camera ray in, radiance out. One unidirectional path with next-event estimation
//! and multiple importance sampling at surfaces, at exits of media, and at collisions where light gets in.

mod collision;
mod direct;
mod log;
mod manifold;
mod medium;
mod nest;
mod probe;
mod shadow;
mod watch;

pub use log::WalkLog;
pub use probe::probe;

use crate::bsdf::{Boundary, BsdfSample, Event, Side, Surface};
use crate::camera::CameraRay;
use crate::film::{FirstHit, OnSurface, Sample};
use crate::guiding::{Guide, LightsAt};
use crate::interaction::Interaction;
use crate::math::{Rgb, mean};
use crate::sampling::sampler::Sampler;
use crate::scene::{Coating, NOBODY, Origin, Scene, SurfaceHit};
use crate::subsurface::steps::WalkStats;
use bytemuck::{Pod, Zeroable};
use collision::Refracted;
use glam::Vec3;
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
    scene: &'a Scene,
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
}

/// Radiance along a camera ray. Estimates may be negative where control variates are on; `log` takes what the walks
/// have to teach.
pub fn trace(
    scene: &Scene,
    guide: &Guide,
    settings: PathSettings,
    ray: CameraRay,
    sampler: &mut Sampler,
    stats: &mut PathStats,
    log: &mut WalkLog,
) -> Sample {
    let (width, spread) = scene.camera.footprint();
    let cone = Cone { width, spread };
    let mut path = Path { o: ray.o, d: ray.d, t_max: ray.t_max, cone, ..Path::new(scene, guide, settings, stats) };
    path.log = Some(log);
    while path.segment(sampler).is_some() {}
    path.finish_walks();
    let sample = path.sample;
    if !sample.color().is_finite() {
        path.stats.non_finite += 1;
        return Sample { direct: Rgb::ZERO, indirect: Rgb::ZERO, subsurface: Rgb::ZERO, ..sample };
    }
    sample
}

impl<'a> Path<'a> {
    /// A path at the camera that goes nowhere yet.
    fn new(scene: &'a Scene, guide: &'a Guide, settings: PathSettings, stats: &'a mut PathStats) -> Self {
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
            seen: 1.0,
            inside: Nest::OUTSIDE,
            cone: Cone::WIDE,
            o: Vec3::ZERO,
            d: Vec3::Z,
            t_max: f32::INFINITY,
            origin: None,
            receiver: NOBODY,
            drawn: false,
        }
    }
}

impl Path<'_> {
    /// One segment and the vertex at its end; `None` when the path is over.
    fn segment(&mut self, sampler: &mut Sampler) -> Option<()> {
        self.stats.rays += 1;
        if std::mem::take(&mut self.drawn) && self.scene.lights.has_shadow_rules() {
            self.meet_ruled_lights();
        }
        let hit = self.scene.closest(self.o, self.d, self.t_max, self.origin);
        self.meet_light_shapes(hit.as_ref().map_or(self.t_max, |hit| hit.t));
        let Some(hit) = hit else {
            self.meet_infinite_lights();
            return None;
        };
        self.throughput *= self.inside.transmittance(hit.t);
        self.cone.width = self.cone.at(hit.t);
        let mut si = self.scene.interaction(&hit, self.d, self.side_of(&hit));
        let coating = self.scene.shade(&mut si, self.cone.width);
        self.meet_surface_emission(&si, &coating);
        if self.depth > self.settings.max_depth {
            return None;
        }
        self.scatter(&hit, &si, &coating, sampler)
    }

    fn side_of(&self, hit: &SurfaceHit) -> Side {
        if self.inside.contains(hit.instance) { Side::Inside } else { Side::Outside }
    }

    /// Next-event estimation and a new direction at a surface.
    fn scatter(&mut self, hit: &SurfaceHit, si: &Interaction, coating: &Coating, sampler: &mut Sampler) -> Option<()> {
        let surface = &coating.surface;
        let recolored = si.display_color.and_then(|color| surface.with_display_color(color));
        let surface = recolored.as_ref().unwrap_or(surface);
        let bsdf = surface.bsdf(si.local(si.wo), si.side);
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d());
        self.record_seen(si, surface, chosen.as_ref());
        if self.depth > 0 && self.bucket == Bucket::Direct {
            self.bucket = Bucket::Indirect;
        }
        let lights = if self.depth == 0 { self.guide.first_hit_choice() } else { LightsAt::One };
        self.next_event(si, &bsdf, lights, None, sampler);

        let chosen = chosen?;
        let wi = si.frame.to_world(chosen.wi);
        self.throughput *= chosen.f / chosen.pdf;
        match chosen.event {
            Event::PassThrough => self.pass_through(si),
            Event::Reflect => {
                (wi.dot(si.ng) * outside_sign(si.side) > 0.0).then_some(())?;
                self.bounce(si, wi, chosen.delta, chosen.pdf, lights)?;
                self.roulette(sampler)
            }
            Event::Scatter => {
                self.bounce(si, wi, chosen.delta, chosen.pdf, lights)?;
                self.roulette(sampler)
            }
            Event::Transmit => {
                (wi.dot(si.ng) * outside_sign(si.side) < 0.0).then_some(())?;
                self.transmit(hit, si, coating, wi, chosen.delta, chosen.pdf, lights, sampler)
            }
            Event::EnterSubsurface => self.enter_medium(hit, si, coating, below(wi, si.ng), sampler),
        }
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
        sampler: &mut Sampler,
    ) -> Option<()> {
        let interior = coating.interior;
        let entering = matches!(si.side, Side::Outside);
        if entering && interior.is_some_and(|interior| interior.medium.scatters()) {
            return self.enter_medium(hit, si, coating, wi, sampler);
        }
        self.inside = if entering {
            self.enter(Inside { instance: si.instance, medium: interior.map(|i| i.medium) })?
        } else {
            self.inside.left(si.instance)
        };
        match interior {
            // Shadow rays pass it too, so what MIS knows of the segment's start still holds.
            Some(interior) if interior.boundary == Boundary::IndexMatched => self.pass_through(si),
            _ => self.bounce(si, wi, delta, pdf, lights),
        }
    }

    /// Sets up the next segment along `wi`, sampled at `si`.
    fn bounce(&mut self, si: &Interaction, wi: Vec3, delta: bool, pdf: f32, lights: LightsAt) -> Option<()> {
        self.previous =
            if delta { Previous::Delta } else { Previous::Sampled { p: si.p, n: si.horizon(), pdf, lights } };
        (self.receiver, self.drawn) = (si.instance, true);
        if !delta {
            self.cone.scattered(pdf);
        }
        if matches!(si.side, Side::Inside) && self.inside.contains(si.instance) {
            self.cross()?;
        } else {
            self.depth += 1;
        }
        self.continue_from(si, wi);
        Some(())
    }

    fn continue_from(&mut self, si: &Interaction, wi: Vec3) {
        self.o = si.origin(wi);
        self.d = wi;
        self.t_max = f32::INFINITY;
        self.origin = Some((si.instance, si.triangle));
    }

    /// The objects around the path once it is inside `object` too.
    fn enter(&mut self, object: Inside) -> Option<Nest> {
        let nest = self.inside.entered(object);
        self.stats.trapped += u64::from(nest.is_none());
        nest
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
            depth: scene.camera.depth(si.p),
            normal: si.frame.n,
            position: (si.p.as_dvec3() + scene.camera.origin).as_vec3(),
            prim_id: scene.instances[si.instance as usize].prim_id,
        };
        let surface = OnSurface { instance: si.instance, triangle: si.triangle, barycentric: si.barycentric };
        self.sample.surface = Some(surface);
    }

    fn add(&mut self, light: Rgb) {
        add_to(&mut self.sample, self.bucket, self.throughput * light);
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
