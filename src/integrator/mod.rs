//! The path integrator: camera ray in, radiance out. One unidirectional path with next-event estimation
//! and multiple importance sampling at surfaces, at exits of media, and at collisions where light gets in.

mod bent;
mod beside;
mod collision;
mod conditional;
mod direct;
mod entry;
mod footprint;
mod leave;
mod lobes;
mod log;
mod manifold;
mod medium;
mod nest;
mod probe;
mod reuse;
mod rough;
mod shadow;
mod suns;
mod surface;
mod wade;
mod watch;

pub use log::WalkLog;
pub use probe::{LIGHTS as PROBED_LIGHTS, beams_at, probe};
pub use reuse::Shared;

use crate::bsdf::Response;
use crate::camera::CameraRay;
use crate::film::Sample;
use crate::guiding::onward::{RAY_COST, SHADOW_RAY_COST};
use crate::guiding::{Guide, LightsAt};
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{Coating, Moment, NOBODY, Origin};
use crate::subsurface::steps::WalkStats;
use bent::{Aim, Refracted};
use beside::Beside;
use bytemuck::{Pod, Zeroable};
use footprint::Cone;
use glam::{Vec2, Vec3};
use leave::Begun;
use lobes::By;
use nest::{Nest, crossed};

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
    /// The reflection at the first surface that it is now, if a walk was followed beside it.
    beside: Option<Beside>,
    begun: Option<Begun>,
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
    path.finish_beside();
    path.set_apart();
    let finite = path.is_finite();
    let sample = path.sample;
    if !finite {
        path.stats.non_finite += 1;
        path.set_nothing_apart();
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
            beside: None,
            begun: None,
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
    /// What this path and those before it cost.
    fn cost(&self) -> u64 {
        self.stats.walk.steps + RAY_COST * self.stats.rays + SHADOW_RAY_COST * self.stats.shadow_rays
    }

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
        self.survive(sampler.random())
    }

    /// Goes on as often as the throughput is worth.
    fn survive(&mut self, u: f32) -> Option<()> {
        let survival = self.throughput.max_element().min(1.0);
        if u >= survival {
            return None;
        }
        self.throughput /= survival;
        Some(())
    }

    /// Adds light of `source`, a light or GLOW, that the segment has met.
    fn add(&mut self, source: u32, light: Rgb) {
        self.add_by(self.by.last, source, light);
    }

    /// Adds what belongs to no light: a known expectation, of which the path brings or takes the rest.
    fn add_unlit(&mut self, bucket: Bucket, light: Rgb) {
        add_to(&mut self.sample, bucket, light);
        self.scene.lights.share_out(self.groups, light);
        self.by.lay(bucket, None, light, self.lobes);
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

fn add_to(sample: &mut Sample, bucket: Bucket, light: Rgb) {
    match bucket {
        Bucket::Direct => sample.direct += light,
        Bucket::Indirect => sample.indirect += light,
        Bucket::Subsurface => sample.subsurface += light,
    }
}
