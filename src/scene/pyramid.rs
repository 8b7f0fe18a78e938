//! Levels of an image: each is the box filter of the one before it, its area mean, taken of linear values.

use crate::flat::{self, Texels};
use half::f16;
use rayon::prelude::*;
use std::sync::LazyLock;

/// IEC 61966-2-1, of 8-bit values.
pub static SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0)));

pub fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn linear_to_srgb(v: f32) -> f32 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
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
pub fn coarser(image: &flat::Image, mut take: impl FnMut(usize, usize, Texels)) {
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
