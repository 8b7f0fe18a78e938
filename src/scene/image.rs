//! Images of materials, as their file has them, with a pyramid of coarser levels: in memory, or in tiles of a scratch file
//! (`paged`) where all together are more than may be in memory.
//!
//! Texels are decoded where they are read; filters work on linear values. A level is the box filter of the one
//! before it: its area mean.

use super::paged::{Residency, Scratch, release};
use crate::error::Warning;
use crate::flat::{self, Prims, Texels, Wrap};
use glam::{Vec2, Vec4};
use half::f16;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Arc, LazyLock};

/// Compiled images by key; an edit removes the entries that it makes stale.
pub type ImageCache = BTreeMap<String, Arc<Image>>;

pub struct Image {
    channels: usize,
    srgb: bool,
    /// Finest first.
    levels: Vec<Level>,
    /// Where the levels are; `None`: in memory.
    scratch: Option<Arc<Scratch>>,
}

struct Level {
    width: usize,
    height: usize,
    texels: Texels,
    /// Tiles per row of tiles; 0: rows of texels.
    tiles: usize,
    /// First byte in the scratch file.
    start: usize,
}

/// Side of a tile, texels: its bytes are a chunk of pages at most, or a few.
const TILE: usize = 64;
/// Of arrays in a map.
const ALIGNMENT: usize = 64;

impl Level {
    /// Where a texel is among the texels.
    fn index(&self, x: usize, y: usize) -> usize {
        match self.tiles {
            0 => y * self.width + x,
            tiles => ((y / TILE) * tiles + x / TILE) * (TILE * TILE) + (y % TILE) * TILE + x % TILE,
        }
    }
}

/// How a lookup treats an image.
#[derive(Debug, Clone, Copy)]
pub struct Sampling {
    pub wrap_s: Wrap,
    pub wrap_t: Wrap,
    pub border: Vec4,
    pub closest: bool,
}

/// IEC 61966-2-1, of 8-bit values.
static SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0)));

fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn linear_to_srgb(v: f32) -> f32 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

impl Image {
    /// In memory; `None` where there are no texels.
    pub fn compile(image: &flat::Image) -> Option<Self> {
        let (width, height) = (image.width as usize, image.height as usize);
        (!image.texels.is_empty()).then_some(())?;
        let mut levels = vec![Level { width, height, texels: image.texels.clone(), tiles: 0, start: 0 }];
        coarser(image, |width, height, texels| levels.push(Level { width, height, texels, tiles: 0, start: 0 }));
        Some(Self { channels: image.channels as usize, srgb: image.srgb, levels, scratch: None })
    }

    /// In tiles, in a scratch file; of an image with texels.
    ///
    /// # Errors
    /// What the file system says.
    fn paged(image: &flat::Image, residency: &Arc<Residency>) -> io::Result<Self> {
        let channels = image.channels as usize;
        let mut levels = Vec::new();
        let mut end = 0;
        let scratch = Scratch::create(residency, |file| {
            // Level 0 of the description, rows as they are: what is saved or compiled again comes from there.
            file.write_all(image.texels.bytes())?;
            end = image.texels.bytes().len();
            let mut put = |width: usize, height: usize, texels: &Texels| {
                let tiles = if width.max(height) > TILE { width.div_ceil(TILE) } else { 0 };
                let start = end.next_multiple_of(ALIGNMENT);
                file.write_all(&[0; ALIGNMENT][..start - end])?;
                end = start + write_level(file, texels, [width, height], channels * texels.size(), tiles)?;
                levels.push((width, height, tiles, start, (end - start) / texels.size()));
                Ok(())
            };
            let mut written = put(image.width as usize, image.height as usize, &image.texels);
            coarser(image, |width, height, texels| {
                if written.is_ok() {
                    written = put(width, height, &texels);
                }
            });
            written
        })?;
        if let Some((map, offset, len)) = image.texels.map() {
            release(map, offset, len);
        }
        let level = |(width, height, tiles, start, len)| Level {
            width,
            height,
            texels: image.texels.mapped(scratch.map(), start, len),
            tiles,
            start,
        };
        let levels = levels.into_iter().map(level).collect();
        Ok(Self { channels, srgb: image.srgb, levels, scratch: Some(scratch) })
    }

    /// The texels of a paged image as they were described.
    fn finest(&self) -> Texels {
        let level = &self.levels[0];
        match &self.scratch {
            Some(scratch) => level.texels.mapped(scratch.map(), 0, level.width * level.height * self.channels),
            None => level.texels.clone(),
        }
    }

    pub fn is_paged(&self) -> bool {
        self.scratch.is_some()
    }

    pub fn memory(&self) -> usize {
        self.levels.iter().map(|level| level.texels.len() * level.texels.size()).sum()
    }

    /// Red, green, blue, alpha at `st`, whose offsets across the footprint are `across`; `None`: the whole image.
    /// Trilinear, by the narrower side of the footprint: what is left of the longer one the samples of a pixel average.
    pub fn at(&self, st: Vec2, across: Option<[Vec2; 2]>, how: &Sampling) -> Vec4 {
        let last = self.levels.len() - 1;
        let Some(across) = across else { return self.level(last, st, how) };
        if how.closest {
            return self.level(0, st, how);
        }
        let size = Vec2::new(self.levels[0].width as f32, self.levels[0].height as f32);
        let [a, b] = across.map(|offset| (offset * size).length());
        // 1e-9: a point has a footprint of 0, whose logarithm is infinite. NaN becomes level 0.
        let level = a.min(b).max(1e-9).log2().clamp(0.0, last as f32);
        let finer = (level as usize).min(last);
        let value = self.level(finer, st, how);
        if level <= finer as f32 || finer == last {
            return value;
        }
        lerp(value, self.level(finer + 1, st, how), level - finer as f32)
    }

    fn level(&self, level: usize, st: Vec2, how: &Sampling) -> Vec4 {
        let level = &self.levels[level];
        let srgb = self.srgb;
        let color = |v: f32| if srgb { srgb_to_linear(v) } else { v };
        match &level.texels {
            Texels::U8(values) => {
                let (values, curve) = (&values[..], &*SRGB);
                let alpha = |v: u8| f32::from(v) / 255.0;
                let color = |v: u8| if srgb { curve[usize::from(v)] } else { alpha(v) };
                self.filter(level, st, how, |i| color(values[i]), |i| alpha(values[i]))
            }
            Texels::U16(values) => {
                let values = &values[..];
                let alpha = |i: usize| f32::from(values[i]) / 65535.0;
                self.filter(level, st, how, |i| color(alpha(i)), alpha)
            }
            Texels::Half(values) => {
                let values = &values[..];
                let alpha = |i: usize| f16::from_bits(values[i]).to_f32();
                self.filter(level, st, how, |i| color(alpha(i)), alpha)
            }
            Texels::Float(values) => {
                let values = &values[..];
                self.filter(level, st, how, |i| color(values[i]), |i| values[i])
            }
        }
    }

    /// Bilinear, or the nearest texel; `color` and `alpha` decode a value by its index.
    fn filter(
        &self,
        level: &Level,
        st: Vec2,
        how: &Sampling,
        color: impl Fn(usize) -> f32,
        alpha: impl Fn(usize) -> f32,
    ) -> Vec4 {
        let n = self.channels;
        let texel = |x: i64, y: i64| {
            let (Some(x), Some(y)) = (wrapped(x, level.width, how.wrap_s), wrapped(y, level.height, how.wrap_t)) else {
                return how.border;
            };
            let i = level.index(x, y) * n;
            if let Some(scratch) = &self.scratch {
                scratch.touch(level.start + i * level.texels.size());
            }
            match n {
                1 => Vec4::splat(color(i)).with_w(1.0),
                2 => Vec4::splat(color(i)).with_w(alpha(i + 1)),
                3 => Vec4::new(color(i), color(i + 1), color(i + 2), 1.0),
                _ => Vec4::new(color(i), color(i + 1), color(i + 2), alpha(i + 3)),
            }
        };
        // Rows run down, t runs up.
        let x = folded(st.x, how.wrap_s) * level.width as f32;
        let y = (1.0 - folded(st.y, how.wrap_t)) * level.height as f32;
        if how.closest {
            return texel(x.floor() as i64, (y.ceil() as i64) - 1);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (i, j, fx, fy) = (x0 as i64, y0 as i64, x - x0, y - y0);
        lerp(lerp(texel(i, j), texel(i + 1, j), fx), lerp(texel(i, j + 1), texel(i + 1, j + 1), fx), fy)
    }
}

/// Exact where both ends are the same.
fn lerp(a: Vec4, b: Vec4, x: f32) -> Vec4 {
    a + (b - a) * x
}

/// A coordinate brought near the image, so that its digits are those within it.
fn folded(s: f32, wrap: Wrap) -> f32 {
    match wrap {
        Wrap::Repeat => s - s.floor(),
        Wrap::Mirror => s - 2.0 * (0.5 * s).floor(),
        Wrap::Clamp => s.clamp(0.0, 1.0),
        // Beyond one image from the border, one border texel is like another.
        Wrap::Black => s.clamp(-2.0, 3.0),
    }
}

/// Index of the texel that stands at `i` of `n`; `None`: the border.
fn wrapped(i: i64, n: usize, wrap: Wrap) -> Option<usize> {
    let last = n as i64 - 1;
    let at = match wrap {
        Wrap::Repeat => i.rem_euclid(n as i64),
        Wrap::Clamp => i.clamp(0, last),
        Wrap::Mirror => {
            let i = i.rem_euclid(2 * n as i64);
            i.min(2 * n as i64 - 1 - i)
        }
        Wrap::Black => return (0..=last).contains(&i).then_some(i as usize),
    };
    Some(at as usize)
}

fn is_color(channel: usize, channels: usize) -> bool {
    channels % 2 == 1 || channel + 1 < channels
}

fn decode(texels: &Texels, i: usize, srgb: bool) -> f32 {
    let value = match texels {
        Texels::U8(values) => f32::from(values[i]) / 255.0,
        Texels::U16(values) => f32::from(values[i]) / 65535.0,
        Texels::Half(values) => f16::from_bits(values[i]).to_f32(),
        Texels::Float(values) => values[i],
    };
    if srgb { srgb_to_linear(value) } else { value }
}

/// In the format of `like`.
fn encode(like: &Texels, linear: &[f32], channels: usize, srgb: bool) -> Texels {
    let curve = |i: usize| {
        let value = linear[i];
        if srgb && is_color(i % channels, channels) { linear_to_srgb(value) } else { value }
    };
    let all = 0..linear.len();
    match like {
        Texels::U8(_) => Texels::U8(all.map(|i| (curve(i) * 255.0).round() as u8).collect::<Vec<_>>().into()),
        Texels::U16(_) => Texels::U16(all.map(|i| (curve(i) * 65535.0).round() as u16).collect::<Vec<_>>().into()),
        Texels::Half(_) => Texels::Half(all.map(|i| f16::from_f32(curve(i)).to_bits()).collect::<Vec<_>>().into()),
        Texels::Float(_) => Texels::Float(all.map(curve).collect::<Vec<_>>().into()),
    }
}

/// The levels behind the finest, each with its size.
fn coarser(image: &flat::Image, mut take: impl FnMut(usize, usize, Texels)) {
    let channels = image.channels as usize;
    let mut from = [image.width as usize, image.height as usize];
    let mut linear: Option<Vec<f32>> = None;
    while from[0] > 1 || from[1] > 1 {
        let to = from.map(|n| (n / 2).max(1));
        let decoded = |i: usize, c: usize| match &linear {
            Some(linear) => linear[i * channels + c],
            None => decode(&image.texels, i * channels + c, image.srgb && is_color(c, channels)),
        };
        let coarser = shrink(from, to, channels, decoded);
        take(to[0], to[1], encode(&image.texels, &coarser, channels, image.srgb));
        (linear, from) = (Some(coarser), to);
    }
}

/// Writes texels of `size` bytes in rows, or in `tiles` per row of tiles; how many bytes.
fn write_level(
    file: &mut impl Write,
    texels: &Texels,
    [width, height]: [usize; 2],
    size: usize,
    tiles: usize,
) -> io::Result<usize> {
    let bytes = texels.bytes();
    if tiles == 0 {
        file.write_all(bytes)?;
        return Ok(bytes.len());
    }
    let mut tile = vec![0; TILE * TILE * size];
    let rows = height.div_ceil(TILE);
    for (ty, tx) in (0..rows).flat_map(|ty| (0..tiles).map(move |tx| (ty, tx))) {
        let across = TILE.min(width - tx * TILE) * size;
        for y in 0..TILE.min(height - ty * TILE) {
            let from = ((ty * TILE + y) * width + tx * TILE) * size;
            tile[y * TILE * size..][..across].copy_from_slice(&bytes[from..from + across]);
        }
        // What is beyond the image is not looked at.
        file.write_all(&tile)?;
    }
    Ok(rows * tiles * tile.len())
}

/// Area means of `value(texel, channel)`.
fn shrink(
    [w, h]: [usize; 2],
    [to_w, to_h]: [usize; 2],
    channels: usize,
    value: impl Fn(usize, usize) -> f32 + Sync,
) -> Vec<f32> {
    let (columns, rows) = (shares(w, to_w), shares(h, to_h));
    let mut out = vec![0.0; to_w * to_h * channels];
    out.par_chunks_mut(to_w * channels).zip(&rows).for_each(|(row, above)| {
        for (texel, across) in row.chunks_mut(channels).zip(&columns) {
            for (c, sum) in texel.iter_mut().enumerate() {
                let line = |y: usize| across.iter().map(|&(x, share)| share * value(y * w + x, c)).sum::<f32>();
                *sum = above.iter().map(|&(y, share)| share * line(y)).sum();
            }
        }
    });
    out
}

/// For each of `to` equal parts of 0..n, the cells in it and their shares of it.
fn shares(n: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let width = n as f64 / to as f64;
    let part = |i: usize| {
        let (begin, end) = (i as f64 * width, (i + 1) as f64 * width);
        let cells = begin as usize..(end.ceil() as usize).min(n);
        let overlap = |x: usize| (end.min(x as f64 + 1.0) - begin.max(x as f64)) / width;
        cells.map(|x| (x, overlap(x) as f32)).filter(|(_, share)| *share > 0.0).collect()
    };
    (0..to).map(part).collect()
}

/// Compiles what is not in the cache, and forgets what is gone.
pub fn build_images(images: &Prims<flat::Image>, cache: &mut ImageCache) {
    cache.retain(|key, _| images.contains_key(key));
    for (key, image) in images {
        if !cache.contains_key(key) {
            if let Some(image) = Image::compile(image) {
                cache.insert(key.clone(), Arc::new(image));
            }
        }
    }
}

/// Bytes with all levels: a third more than the finest.
fn bytes(image: &flat::Image) -> usize {
    image.texels.len() * image.texels.size() / 3 * 4
}

/// Where all images together exceed `bound` bytes (0: none), moves those that are not there yet into scratch files, the
/// described texels included, and bounds what of the files is in memory.
///
/// An image that no file can be written for stays in memory, which is said.
pub fn page_out(
    images: &mut Prims<flat::Image>,
    cache: &mut ImageCache,
    residency: &Arc<Residency>,
    bound: usize,
) -> Vec<Warning> {
    residency.set_bound(bound);
    let mut warnings = Vec::new();
    if bound == 0 || images.values().map(bytes).sum::<usize>() <= bound {
        return warnings;
    }
    for (key, image) in images.iter_mut() {
        if image.texels.is_empty() || cache.get(key).is_some_and(|compiled| compiled.scratch.is_some()) {
            continue;
        }
        match Image::paged(image, residency) {
            Ok(compiled) => {
                image.texels = compiled.finest();
                cache.insert(key.clone(), Arc::new(compiled));
            }
            Err(error) => {
                let place = std::env::temp_dir();
                let message = format!(
                    "{}: textureMemory: no scratch file in {} ({error}); it is kept in memory: set TMPDIR",
                    image.file,
                    place.display()
                );
                warnings.push(Warning::new(key, message));
            }
        }
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, channels: u32, srgb: bool, texels: Texels) -> flat::Image {
        let height = texels.len() as u32 / (width * channels);
        flat::Image { file: "a.png".into(), width, height, channels, srgb, texels, ..flat::Image::default() }
    }

    fn how(wrap: Wrap) -> Sampling {
        Sampling { wrap_s: wrap, wrap_t: wrap, border: Vec4::splat(0.25), closest: false }
    }

    const POINT: Option<[Vec2; 2]> = Some([Vec2::ZERO; 2]);

    #[test]
    fn texels_stand_where_usd_puts_them() {
        // Rows from the top: 0 1 / 2 3; st from the lower left.
        let flat = image(2, 1, false, Texels::Float(vec![0.0, 1.0, 2.0, 3.0].into()));
        let image = Image::compile(&flat).unwrap();
        let at = |s, t| image.at(Vec2::new(s, t), POINT, &how(Wrap::Clamp)).x;
        assert_eq!([at(0.25, 0.75), at(0.75, 0.75), at(0.25, 0.25), at(0.75, 0.25)], [0.0, 1.0, 2.0, 3.0]);
        assert_eq!(at(0.5, 0.5), 1.5);
        let closest = Sampling { closest: true, ..how(Wrap::Clamp) };
        let nearest = |s, t| image.at(Vec2::new(s, t), POINT, &closest).x;
        assert_eq!(
            [nearest(0.49, 0.51), nearest(0.51, 0.49), nearest(0.0, 0.0), nearest(1.0, 1.0)],
            [0.0, 3.0, 2.0, 1.0]
        );
    }

    #[test]
    fn wraps() {
        let flat = image(4, 1, false, Texels::Float(vec![0.0, 1.0, 2.0, 3.0].into()));
        let image = Image::compile(&flat).unwrap();
        let at = |wrap, s| image.at(Vec2::new(s, 0.5), POINT, &how(wrap)).x;
        let middles = [-3.0 / 8.0, -1.0 / 8.0, 9.0 / 8.0, 11.0 / 8.0];
        assert_eq!(middles.map(|s| at(Wrap::Repeat, s)), [2.0, 3.0, 0.0, 1.0]);
        assert_eq!(middles.map(|s| at(Wrap::Mirror, s)), [1.0, 0.0, 3.0, 2.0]);
        assert_eq!(middles.map(|s| at(Wrap::Clamp, s)), [0.0, 0.0, 3.0, 3.0]);
        assert_eq!(middles.map(|s| at(Wrap::Black, s)), [0.25; 4]);
        assert_eq!([at(Wrap::Black, -1e9), at(Wrap::Clamp, 1e9), at(Wrap::Repeat, 0.0)], [0.25, 3.0, 1.5]);
    }

    #[test]
    fn levels_are_means_of_linear_values() {
        let flat = image(2, 4, true, Texels::U8(vec![0, 0, 255, 0, 255, 0, 255, 255].into()));
        let image = Image::compile(&flat).unwrap();
        let mean = image.at(Vec2::splat(0.3), None, &how(Wrap::Repeat));
        // Half of the light is 188 in sRGB; alpha is linear.
        let half = srgb_to_linear(188.0 / 255.0);
        assert_eq!(mean, Vec4::new(half, 0.0, 1.0, 128.0 / 255.0));
        let wide = image.at(Vec2::splat(0.3), Some([Vec2::X, Vec2::Y * 40.0]), &how(Wrap::Repeat));
        assert_eq!(wide, mean);
        // 1.5 texels: half way up in log2.
        let narrow = Some([Vec2::new(0.5 * 2.0_f32.sqrt(), 0.0), Vec2::new(0.0, 40.0)]);
        let between = image.at(Vec2::new(0.25, 0.5), narrow, &how(Wrap::Clamp));
        assert!((between.x - 0.5 * half).abs() < 1e-6, "{between}");
    }

    #[test]
    fn a_constant_stays_what_it_is_at_every_level_and_format() {
        let levels = [Texels::U8(vec![77; 7 * 5].into()), Texels::U16(vec![4711; 35].into())];
        let floats = [Texels::Half(vec![0x3555; 35].into()), Texels::Float(vec![0.1; 35].into())];
        for texels in levels.into_iter().chain(floats) {
            for srgb in [false, true] {
                let image = Image::compile(&image(7, 1, srgb, texels.clone())).unwrap();
                let value = image.at(Vec2::splat(0.5), POINT, &how(Wrap::Repeat)).x;
                for width in [0.0, 0.13, 0.4, 2.0] {
                    let across = Some([Vec2::splat(width); 2]);
                    let got = image.at(Vec2::new(0.123, 0.77), across, &how(Wrap::Mirror)).x;
                    assert!((got / value - 1.0).abs() < 1e-6, "{texels:?} {srgb} {width}: {got} {value}");
                }
            }
        }
    }

    #[test]
    fn paged_images_are_the_same_bit_for_bit() {
        let noise = |n: usize| (0..n).map(move |i| (i.wrapping_mul(2_654_435_761) >> 7) as u8);
        let half = |v: u8| f16::from_f32(f32::from(v) / 7.0).to_bits();
        let formats: [(u32, Texels); 4] = [
            (3, Texels::U8(noise(3 * 201 * 133).collect::<Vec<_>>().into())),
            (1, Texels::U16(noise(201 * 133).map(|v| 257 * u16::from(v)).collect::<Vec<_>>().into())),
            (2, Texels::Half(noise(2 * 201 * 133).map(half).collect::<Vec<_>>().into())),
            (4, Texels::Float(noise(4 * 201 * 133).map(f32::from).collect::<Vec<_>>().into())),
        ];
        for (channels, texels) in formats {
            let flat = image(201, channels, channels == 3, texels);
            let residency = Arc::new(Residency::default());
            let mut images: Prims<flat::Image> = [("a".into(), flat.clone())].into();
            let mut cache = ImageCache::new();
            // The smallest bound: a chunk.
            assert!(page_out(&mut images, &mut cache, &residency, 1).is_empty());
            assert_eq!(images["a"], flat);
            let (plain, paged) = (Image::compile(&flat).unwrap(), &cache["a"]);
            assert!(paged.is_paged() && paged.levels.len() == plain.levels.len());
            for i in 0..4000 {
                let st = Vec2::new(i as f32 * 0.618, i as f32 * 0.414);
                let across = Some([Vec2::splat(0.5_f32.powi(i % 9)), Vec2::Y]);
                for wrap in [Wrap::Repeat, Wrap::Mirror] {
                    assert_eq!(plain.at(st, across, &how(wrap)), paged.at(st, across, &how(wrap)));
                }
            }
        }
    }

    #[test]
    fn images_that_fit_stay_in_memory() {
        let small = image(10, 1, false, Texels::U8(vec![9; 100].into()));
        let mut images: Prims<flat::Image> = [("small".into(), small)].into();
        let (mut cache, residency) = (ImageCache::new(), Arc::new(Residency::default()));
        for bound in [0, 1_000_000] {
            assert!(page_out(&mut images, &mut cache, &residency, bound).is_empty() && cache.is_empty());
        }
    }
}
