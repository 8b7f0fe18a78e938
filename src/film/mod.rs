//! The film: per-pixel sums of what samples brought, kept in tiles so that threads never share a pixel.

pub mod cryptomatte;
mod lobes;
mod planes;
mod sample;
mod saved;
mod spread;
mod walks;

pub use lobes::Lobe;
pub use planes::Plane;
pub use sample::{FirstHit, NO_DEPTH, OnSurface, Sample};
pub use walks::FirstWalk;

use crate::camera::{DataWindow, View};
use crate::error::{Error, Result};
use crate::flat::{GUIDE_AOVS, LIGHT_AOV, LOBE_AOVS, PRIMVAR_AOV, parts_of};
use crate::math::Rgb;
use cryptomatte::ObjectSums;
use glam::{DVec3, Vec2, Vec3};
use lobes::LobeSums;
use spread::Spread;
use std::sync::Mutex;
use walks::WalkSums;

/// Side of a tile in pixels.
const TILE: u32 = 16;

/// Planes beside the beauty that a render was asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Planes {
    /// depth, normal, position, primId: of the nearest sample of a pixel, unfiltered.
    pub geometry: bool,
    /// Of the same sample.
    pub motion: bool,
    pub albedo: bool,
    /// direct, indirect, subsurface.
    pub buckets: bool,
    /// emission; firstBounce needs the direct light, too.
    pub straight: bool,
    /// Second moments, for the variance AOV or a noise threshold.
    pub variance: bool,
    /// Of the first walk behind the camera ray.
    pub walks: bool,
    /// Coverage of a pixel by objects.
    pub objects: bool,
    /// How many primvars of the first surface.
    pub primvars: usize,
    /// AOVs of lights.
    pub lights: usize,
    /// Light by the lobe of the first surface.
    pub lobes: bool,
}

impl Planes {
    /// Planes for the AOVs in `names`.
    fn from_names(names: &[String]) -> Self {
        let parts: Vec<&str> = names.iter().flat_map(|name| parts_of(name).unwrap_or(vec![name])).collect();
        let has = |wanted: &[&str]| parts.iter().any(|part| wanted.contains(part));
        Self {
            geometry: has(&planes::GEOMETRY),
            motion: has(&[planes::MOTION]),
            albedo: has(&["albedo"]),
            buckets: has(&["direct", "indirect", "subsurface", "firstBounce"]),
            straight: has(&["emission", "firstBounce"]),
            variance: has(&["variance"]),
            walks: has(&GUIDE_AOVS),
            objects: has(&["cryptoObject"]),
            primvars: names.iter().filter(|name| name.starts_with(PRIMVAR_AOV)).count(),
            lights: names.iter().filter(|n| n.starts_with(LIGHT_AOV)).count(),
            lobes: has(&LOBE_AOVS),
        }
    }
}

/// A block of pixels with its sums; planes that nobody asked for are empty.
#[derive(Debug, Clone, Default)]
pub struct Tile {
    pub x0: i32,
    pub y0: i32,
    pub width: u32,
    pub height: u32,
    samples: Vec<u32>,
    color: Vec<DVec3>,
    alpha: Vec<f32>,
    squares: Vec<DVec3>,
    buckets: Vec<[Rgb; 3]>,
    straight: Vec<Rgb>,
    albedo: Vec<Rgb>,
    first: Vec<FirstHit>,
    motion: Vec<Vec2>,
    walks: Vec<WalkSums>,
    objects: Vec<ObjectSums>,
    /// By pixel, then by primvar.
    primvars: Vec<Vec3>,
    /// Per pixel, of each AOV of lights.
    lights: Vec<Rgb>,
    lobes: Vec<LobeSums>,
    /// `None`: samples are their own pixel's alone.
    spread: Option<Spread>,
}

impl Tile {
    fn new(x0: i32, y0: i32, width: u32, height: u32, planes: Planes) -> Self {
        let n = (width * height) as usize;
        let on = |wanted: bool| if wanted { n } else { 0 };
        Self {
            x0,
            y0,
            width,
            height,
            samples: vec![0; n],
            color: vec![DVec3::ZERO; n],
            alpha: vec![0.0; n],
            squares: vec![DVec3::ZERO; on(planes.variance)],
            buckets: vec![[Rgb::ZERO; 3]; on(planes.buckets)],
            straight: vec![Rgb::ZERO; on(planes.straight)],
            albedo: vec![Rgb::ZERO; on(planes.albedo)],
            first: vec![FirstHit::NONE; on(planes.geometry)],
            motion: vec![Vec2::ZERO; on(planes.motion)],
            walks: vec![WalkSums::NONE; on(planes.walks)],
            objects: vec![ObjectSums::NONE; on(planes.objects)],
            primvars: vec![Vec3::ZERO; n * planes.primvars],
            lights: vec![Rgb::ZERO; n * planes.lights],
            lobes: vec![[Rgb::ZERO; LOBE_AOVS.len()]; on(planes.lobes)],
            spread: None,
        }
    }

    /// Whether an AOV shows how things move on the image.
    pub fn watches_motion(&self) -> bool {
        !self.motion.is_empty()
    }

    /// Adds a sample to pixel `i` (row-major in the tile).
    pub fn add(&mut self, i: usize, sample: &Sample) {
        let color = sample.color().as_dvec3();
        self.samples[i] += 1;
        self.color[i] += color;
        self.alpha[i] += sample.alpha;
        if let Some(squares) = self.squares.get_mut(i) {
            *squares += color * color;
        }
        if let Some(buckets) = self.buckets.get_mut(i) {
            buckets[0] += sample.direct;
            buckets[1] += sample.indirect;
            buckets[2] += sample.subsurface;
        }
        if let Some(straight) = self.straight.get_mut(i) {
            *straight += sample.straight;
        }
        if let Some(albedo) = self.albedo.get_mut(i) {
            *albedo += sample.albedo;
        }
        if let Some(first) = self.first.get_mut(i).filter(|first| sample.first.depth < first.depth) {
            *first = sample.first;
            if let Some(motion) = self.motion.get_mut(i) {
                *motion = sample.motion;
            }
        }
        if let Some(objects) = self.objects.get_mut(i) {
            objects.add(sample.first.prim_id);
        }
    }

    /// Whether an AOV shows a primvar.
    pub fn shows_primvars(&self) -> bool {
        !self.primvars.is_empty()
    }

    /// Adds primvars of the first surface of a sample of pixel `i`, in the order of their AOVs.
    pub fn add_primvars(&mut self, i: usize, values: impl ExactSizeIterator<Item = Vec3>) {
        let first = i * values.len();
        self.primvars[first..].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }

    /// AOVs of lights.
    pub fn light_aovs(&self) -> usize {
        self.lights.len() / self.samples.len()
    }

    /// Adds what a sample of pixel `i` shows of each AOV of lights.
    pub fn add_lights(&mut self, i: usize, sums: &[Rgb]) {
        let of_pixel = self.lights.iter_mut().skip(i * sums.len());
        of_pixel.zip(sums).for_each(|(sum, light)| *sum += *light);
    }

    /// Sums by lobe that a sample has to have.
    pub fn lobe_aovs(&self) -> usize {
        if self.lobes.is_empty() { 0 } else { LOBE_AOVS.len() }
    }

    /// Adds what a sample of pixel `i` shows by the lobe of the first surface.
    pub fn add_lobes(&mut self, i: usize, sums: &[Rgb]) {
        let of_pixel = self.lobes.get_mut(i).into_iter().flatten();
        of_pixel.zip(sums).for_each(|(sum, light)| *sum += *light);
    }

    /// Adds the first walk behind the camera ray of a sample of pixel `i`, whose first surface is at `depth`.
    pub fn add_walk(&mut self, i: usize, depth: f32, walk: &FirstWalk) {
        if let Some(walks) = self.walks.get_mut(i) {
            walks.add(depth, walk);
        }
    }

    /// Variance of the mean of pixel `i`, per channel; infinite below two samples.
    fn mean_variance(&self, i: usize) -> DVec3 {
        let n = f64::from(self.samples[i]);
        if n < 2.0 {
            return DVec3::INFINITY;
        }
        let mean = self.color[i] / n;
        (self.squares[i] / n - mean * mean).max(DVec3::ZERO) / (n - 1.0)
    }
}

/// Bytes of a pixel.
fn bytes_of(planes: Planes) -> usize {
    let on = |wanted: bool, bytes: usize| if wanted { bytes } else { 0 };
    size_of::<DVec3>()
        + 2 * size_of::<f32>()
        + on(planes.variance, size_of::<DVec3>())
        + on(planes.buckets, size_of::<[Rgb; 3]>())
        + on(planes.straight, size_of::<Rgb>())
        + on(planes.albedo, size_of::<Rgb>())
        + on(planes.geometry, size_of::<FirstHit>())
        + on(planes.motion, size_of::<Vec2>())
        + on(planes.walks, size_of::<WalkSums>())
        + on(planes.objects, size_of::<ObjectSums>())
        + planes.primvars * size_of::<Vec3>()
        + planes.lights * size_of::<Rgb>()
        + on(planes.lobes, size_of::<LobeSums>())
}

/// Asks for a film's memory once, whole, so that an image that is too large is an error and not an abort.
fn check_memory(data_window: DataWindow, per_pixel: usize) -> Result<()> {
    let (width, height) = (data_window.width(), data_window.height());
    let bytes = width as usize * height as usize * per_pixel;
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| {
        let gib = bytes as f64 / f64::from(1 << 30);
        Error::Other(format!(
            "resolution: {width} x {height} pixels need {gib:.1} GiB of memory: render crops, or fewer AOVs"
        ))
    })
}

/// Sums over the pixels of a tile and their channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileNoise {
    pub pixels: f64,
    /// Of one sample.
    pub variance: f64,
    /// Of the mean.
    pub square: f64,
}

#[derive(Debug)]
pub struct Film {
    pub data_window: DataWindow,
    planes: Planes,
    /// AOVs to resolve beside the beauty; a plane may hold more than was asked for.
    aovs: Vec<String>,
    pub tiles: Vec<Mutex<Tile>>,
    /// Factor on radiance when resolved (camera exposure).
    exposure: f32,
    /// For depths and eye-space vectors.
    view: Option<View>,
    /// Cryptomatte ids by `primId`.
    object_ids: Vec<f32>,
}

impl Film {
    /// `noise`: keep second moments even if no AOV shows them.
    ///
    /// # Errors
    /// Where the memory for the planes is not to be had.
    pub fn new(data_window: DataWindow, aovs: &[String], noise: bool, exposure: f32) -> Result<Self> {
        let mut planes = Planes::from_names(aovs);
        planes.variance |= noise;
        check_memory(data_window, bytes_of(planes))?;
        let mut tiles = Vec::new();
        for y0 in (data_window.y0..data_window.y1).step_by(TILE as usize) {
            for x0 in (data_window.x0..data_window.x1).step_by(TILE as usize) {
                let (width, height) = (TILE.min(data_window.x1.abs_diff(x0)), TILE.min(data_window.y1.abs_diff(y0)));
                tiles.push(Mutex::new(Tile::new(x0, y0, width, height, planes)));
            }
        }
        Ok(Self { data_window, planes, aovs: aovs.to_vec(), tiles, exposure, view: None, object_ids: Vec::new() })
    }

    /// Where the camera stands.
    pub fn seen_by(self, view: View) -> Self {
        Self { view: Some(view), ..self }
    }

    /// Names of the objects by `primId`, for Cryptomatte.
    pub fn named<'a>(self, objects: impl Iterator<Item = &'a str>) -> Self {
        let object_ids = if self.planes.objects { objects.map(cryptomatte::id).collect() } else { Vec::new() };
        Self { object_ids, ..self }
    }

    /// Whether an AOV shows the first walk behind the camera ray.
    pub fn watches_walks(&self) -> bool {
        self.planes.walks
    }

    /// Calls `f` with every tile in order.
    fn for_each_tile(&self, mut f: impl FnMut(&Tile)) {
        for tile in &self.tiles {
            // A panic while a tile was locked left sums that are still sums.
            f(&tile.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
        }
    }

    /// Mean samples per pixel.
    pub fn samples_per_pixel(&self) -> f64 {
        let mut sum = 0_u64;
        self.for_each_tile(|tile| sum += tile.samples.iter().map(|&n| u64::from(n)).sum::<u64>());
        sum as f64 / (f64::from(self.data_window.width()) * f64::from(self.data_window.height()))
    }

    /// Pixels that a time limit or a stop left without any sample.
    pub fn unsampled_pixels(&self) -> u64 {
        let mut count = 0;
        self.for_each_tile(|tile| count += tile.samples.iter().filter(|&&n| n == 0).count() as u64);
        count
    }

    /// Tiles per row of tiles.
    pub fn tiles_across(&self) -> usize {
        self.data_window.width().div_ceil(TILE) as usize
    }

    /// How noisy each tile is, as its own samples say; needs second moments.
    pub fn tile_noise(&self) -> Vec<TileNoise> {
        let mut noise = Vec::with_capacity(self.tiles.len());
        self.for_each_tile(|tile| {
            let mut sums = TileNoise { pixels: tile.samples.len() as f64, variance: 0.0, square: 0.0 };
            for (i, &n) in tile.samples.iter().enumerate().filter(|(_, n)| **n > 1) {
                let (mean, variance) = (tile.color[i] / f64::from(n), tile.mean_variance(i).element_sum());
                sums.variance += variance * f64::from(n);
                // The square of a noisy mean is too large by its variance.
                sums.square += (mean.length_squared() - variance).max(0.0);
            }
            noise.push(sums);
        });
        noise
    }

    /// Samples of every pixel, where all have as many.
    pub fn uniform_samples(&self) -> Option<u32> {
        let (mut least, mut most) = (u32::MAX, 0);
        self.for_each_tile(|tile| {
            least = tile.samples.iter().fold(least, |a, &b| a.min(b));
            most = tile.samples.iter().fold(most, |a, &b| a.max(b));
        });
        (least == most).then_some(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_resolve_to_means_at_their_pixels() {
        let window = DataWindow { x0: 3, y0: 5, x1: 40, y1: 27 };
        let aovs = ["depth", "direct", "subsurface", "variance"].map(String::from);
        let film = Film::new(window, &aovs, false, 2.0).expect("memory");
        for tile in &film.tiles {
            let mut tile = tile.lock().unwrap();
            for i in 0..tile.samples.len() {
                let x = (tile.x0 as usize + i % tile.width as usize) as f32;
                for value in [x, x + 2.0] {
                    let first = FirstHit { depth: value, ..FirstHit::NONE };
                    tile.add(i, &Sample { direct: Rgb::splat(value), alpha: 1.0, first, ..Sample::BLACK });
                }
            }
        }
        let planes = film.resolve();
        let at = |name: &str, x: usize| {
            let plane = planes.iter().find(|p| p.name == name).unwrap();
            plane.values[(7 * 37 + x) * plane.channels]
        };
        assert_eq!((at("color", 0), at("color", 36)), (8.0, 80.0));
        assert_eq!((at("depth", 0), at("direct", 1), at("subsurface", 1)), (3.0, 10.0, 0.0));
        assert_eq!(at("variance", 4), 4.0); // exposure^2 (population variance 1) / (n - 1)
        assert_eq!(
            planes.iter().map(|p| &*p.name).collect::<Vec<_>>(),
            ["color", "depth", "direct", "subsurface", "variance"]
        );
        assert_eq!(film.samples_per_pixel(), 2.0);
    }

    #[test]
    fn variance_beyond_single_precision_is_finite() {
        let film =
            Film::new(DataWindow { x0: 0, y0: 0, x1: 1, y1: 1 }, &["variance".into()], false, 1.0).expect("memory");
        for value in [0.0, 1e30] {
            let sample = Sample { direct: Rgb::splat(value), alpha: 1.0, ..Sample::BLACK };
            film.tiles[0].lock().unwrap().add(0, &sample);
        }
        let planes = film.resolve();
        assert_eq!(planes[1].name, "variance");
        assert_eq!(planes[1].values[0], f32::MAX);
    }
}
