//! Images of materials, as their file has them, with a pyramid of coarser levels: in memory, or in tiles of a scratch file
//! (`page_out`) where all together are more than may be in memory.
//!
//! Texels are decoded where they are read; filters work on linear values.

use super::paged::Scratch;
use super::pyramid::{SRGB, coarser, srgb_to_linear};
use crate::flat::{self, Prims, Texels, Wrap};
use glam::{Vec2, Vec4};
use half::f16;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Compiled images by key; an edit removes the entries that it makes stale.
pub type ImageCache = BTreeMap<String, Arc<Image>>;

pub struct Image {
    pub(super) channels: usize,
    pub(super) srgb: bool,
    /// Finest first.
    pub(super) levels: Vec<Level>,
    /// Where the levels are; `None`: in memory.
    pub(super) scratch: Option<Arc<Scratch>>,
}

pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    pub texels: Texels,
    /// Tiles per row of tiles; 0: rows of texels.
    pub tiles: usize,
    /// First byte in the scratch file.
    pub start: usize,
}

/// Side of a tile, texels: its bytes are a chunk of pages at most, or a few.
pub(super) const TILE: usize = 64;

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

impl Image {
    /// In memory; `None` where there are no texels.
    pub fn compile(image: &flat::Image) -> Option<Self> {
        let (width, height) = (image.width as usize, image.height as usize);
        (!image.texels.is_empty()).then_some(())?;
        let mut levels = vec![Level { width, height, texels: image.texels.clone(), tiles: 0, start: 0 }];
        coarser(image, |width, height, texels| levels.push(Level { width, height, texels, tiles: 0, start: 0 }));
        Some(Self { channels: image.channels as usize, srgb: image.srgb, levels, scratch: None })
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

/// Compiles what is not in the cache, and forgets what is gone.
pub fn build_images(images: &Prims<flat::Image>, cache: &mut ImageCache) {
    cache.retain(|key, _| images.contains_key(key));
    for (key, image) in images {
        if !cache.contains_key(key)
            && let Some(image) = Image::compile(image)
        {
            cache.insert(key.clone(), Arc::new(image));
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn image(width: u32, channels: u32, srgb: bool, texels: Texels) -> flat::Image {
        let height = texels.len() as u32 / (width * channels);
        flat::Image { file: "a.png".into(), width, height, channels, srgb, texels, ..flat::Image::default() }
    }

    pub fn how(wrap: Wrap) -> Sampling {
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
}
