//! One pass over a tile: a sample of every pixel after the other, handed out where pixels share their paths.

use crate::film::{Sample, Tile};
use crate::flat::{PRIMVAR_AOV, RenderSettings};
use crate::guiding::Guide;
use crate::guiding::statistics::Statistics;
use crate::integrator::{PathSettings, PathStats, Shared, WalkLog, trace};
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::Scene;
use glam::{Vec2, Vec3};
use std::ops::Range;

/// Random numbers that move the groups of pixels, apart from those of paths.
const GROUP_SEED: u32 = 0x6772_6f75;

/// What renders samples of a tile.
pub(super) struct TilePass<'a> {
    scene: &'a Scene,
    guide: &'a Guide,
    settings: PathSettings,
    seed: u32,
    tile: &'a mut Tile,
    /// Names of the primvars that AOVs show.
    primvars: Vec<&'a str>,
    stats: PathStats,
    log: WalkLog,
    /// By pixel, of the sample under way.
    samples: Vec<Sample>,
    /// Where it is in its pixel, from the centre.
    offsets: Vec<Vec2>,
    /// By pixel, then by AOV of lights.
    lights: Layers,
    /// By pixel, then by lobe.
    lobes: Layers,
    shared: Shared,
}

/// Layers of pixels.
struct Layers {
    each: usize,
    sums: Vec<Rgb>,
}

impl Layers {
    fn new(pixels: usize, each: usize) -> Self {
        Self { each, sums: vec![Rgb::ZERO; pixels * each] }
    }

    fn of(&mut self, pixel: usize) -> &mut [Rgb] {
        &mut self.sums[pixel * self.each..(pixel + 1) * self.each]
    }

    fn add(&mut self, pixel: usize, light: &[Rgb]) {
        self.of(pixel).iter_mut().zip(light).for_each(|(sum, light)| *sum += *light);
    }
}

impl<'a> TilePass<'a> {
    pub fn new(
        scene: &'a Scene,
        guide: &'a Guide,
        settings: &'a RenderSettings,
        seed: u32,
        tile: &'a mut Tile,
    ) -> Self {
        let path =
            PathSettings { max_depth: settings.max_depth, lights_visible_to_camera: settings.lights_visible_to_camera };
        // A pilot has none.
        let shown = settings.aovs.iter().filter(|_| tile.shows_primvars());
        let primvars = shown.filter_map(|aov| aov.strip_prefix(PRIMVAR_AOV)).collect();
        let pixels = (tile.width * tile.height) as usize;
        let (lights, lobes) = (Layers::new(pixels, tile.light_aovs()), Layers::new(pixels, tile.lobe_aovs()));
        let mut log = WalkLog::default();
        log.shares = guide.shares();
        Self {
            scene,
            guide,
            settings: path,
            seed,
            tile,
            primvars,
            stats: PathStats::default(),
            log,
            samples: Vec::with_capacity(pixels),
            offsets: Vec::with_capacity(pixels),
            lights,
            lobes,
            shared: Shared::default(),
        }
    }

    pub fn render(mut self, samples: Range<u32>) -> (PathStats, Statistics) {
        for sample in samples {
            self.sample(sample);
        }
        (self.stats, self.log.statistics)
    }

    /// The sample of this number of all pixels.
    fn sample(&mut self, number: u32) {
        self.samples.clear();
        self.offsets.clear();
        self.shared.clear(self.lights.each + self.lobes.each);
        for pixel in 0..(self.tile.width * self.tile.height) as usize {
            self.trace(pixel, number);
        }
        if self.log.shares {
            self.hand_out(number);
        }
        for (pixel, sample) in self.samples.iter().enumerate() {
            self.tile.add(pixel, sample);
            let (lights, lobes) = (self.lights.of(pixel), self.lobes.of(pixel));
            self.tile.spread(pixel, self.offsets[pixel], sample, lights, lobes);
            self.tile.add_lights(pixel, self.lights.of(pixel));
            self.tile.add_lobes(pixel, self.lobes.of(pixel));
        }
    }

    fn trace(&mut self, pixel: usize, number: u32) {
        let (scene, tile) = (self.scene, &mut *self.tile);
        let at = [tile.x0 + (pixel as u32 % tile.width) as i32, tile.y0 + (pixel as u32 / tile.width) as i32];
        // A crop renders the pixels of the whole.
        let mut sampler = Sampler::new(self.seed, scene.camera.pixel_number(at[0], at[1]), number);
        let u_filter = sampler.next_2d();
        let u_lens = if scene.camera.has_depth_of_field() { sampler.next_2d() } else { sampler.skip_2d() };
        let offset = Vec2::new(tent(u_filter.x), tent(u_filter.y));
        self.offsets.push(offset);
        let raster = Vec2::new(at[0] as f32 + 0.5, at[1] as f32 + 0.5) + offset;
        let time = scene.frozen.unwrap_or_else(|| sampler.time());
        let ray = scene.camera.ray(raster, u_lens, time);
        let (lights, lobes) = (self.lights.of(pixel), self.lobes.of(pixel));
        let (stats, log) = (&mut self.stats, &mut self.log);
        let mut sample = trace(scene.at(time), self.guide, self.settings, ray, &mut sampler, stats, log, lights, lobes);
        if let Some(surface) = sample.surface.filter(|_| tile.watches_motion()) {
            sample.motion = scene.motion_vector(&surface);
        }
        if let Some(surface) = sample.surface.filter(|_| !self.primvars.is_empty()) {
            tile.add_primvars(pixel, self.primvars.iter().map(|name| scene.primvar_at(&surface, name)));
        }
        if let Some(walk) = self.log.first.take() {
            tile.add_walk(pixel, sample.first.depth, &walk);
        }
        if let Some(entry) = self.log.entry.take() {
            self.shared.push(pixel, at, entry, &self.log.rows);
        }
        self.samples.push(sample);
    }

    /// Gives pixels their part of the paths around them. Nothing moves where paths are shared.
    fn hand_out(&mut self, number: u32) {
        let Self { scene, seed, stats, samples, lights, lobes, shared, tile, .. } = self;
        let corner = scene.camera.pixel_number(tile.x0, tile.y0);
        let mut random = Sampler::new(!*seed ^ GROUP_SEED, corner, number);
        let mut sampler = Sampler::new(*seed ^ GROUP_SEED, 0, number);
        let shift = Vec3::new(sampler.random(), sampler.random(), sampler.random());
        shared.hand_out(scene.middle(), shift, &mut random, stats, |pixel, shown, unlit, aovs| {
            samples[pixel].subsurface += shown;
            let (of_lights, of_lobes) = aovs.split_at(lights.each);
            lights.add(pixel, of_lights);
            scene.lights.share_out(lights.of(pixel), unlit);
            lobes.add(pixel, of_lobes);
        });
    }
}

/// Pixel filter by importance sampling: a tent of radius 1 pixel, so that samples stay in their pixel's sum.
fn tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}
