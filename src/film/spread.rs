//! Samples given to every pixel under the filter, not to their own alone (`pixelFilterMode` `weighted`).
//!
//! A pixel draws its samples by the filter w about it. One at s could have been drawn by any pixel under whose filter it lies, so that
//! pixel P takes the share w(s - P) / sum_Q w(s - Q) of it, Q over the pixels of the data window: the balance heuristic (Veach and
//! Guibas 1995, equation 9). Its expectation is that of P's own samples; of tents the sum is 1 but at the edges of the window. Each
//! tile keeps what it gives to the pixels around it, so that threads share none.

use super::{Film, Tile};
use crate::camera::DataWindow;
use crate::error::Result;
use crate::flat::LOBE_AOVS;
use crate::math::Rgb;
use glam::{DVec3, Vec2};
use std::sync::{Mutex, PoisonError};

/// Sums of a pixel: shares, then what samples show by their shares, colour, alpha and the layers that are kept; at last its moments.
const COLOR: usize = 1;
const ALPHA: usize = 4;
const LAYERS: usize = 5;

/// For the variance: squares of shares, these times the colour, these times the squares of the colour.
const MOMENTS: usize = 7;

/// A tile's sums for its pixels and for one row and column beyond on each side.
#[derive(Debug, Clone)]
pub(super) struct Spread {
    window: DataWindow,
    x0: i32,
    y0: i32,
    across: usize,
    /// Of a pixel.
    each: usize,
    /// Where its moments are; `each`: nobody asks for them.
    moments: usize,
    pub sums: Vec<f64>,
    /// What a sample shows, made anew for each.
    shown: Vec<f32>,
}

impl Spread {
    fn new(window: DataWindow, tile: &Tile) -> Self {
        let across = tile.width as usize + 2;
        let moments = LAYERS + tile.layers();
        let each = moments + if tile.squares.is_empty() { 0 } else { MOMENTS };
        let sums = vec![0.0; across * (tile.height as usize + 2) * each];
        Self { window, x0: tile.x0 - 1, y0: tile.y0 - 1, across, each, moments, sums, shown: Vec::new() }
    }

    /// Adds what is `shown` by a sample of the pixel at `(x, y)`, `offset` pixels from its centre.
    fn add(&mut self, x: i32, y: i32, offset: Vec2) {
        let beside = |offset: f32| if offset < 0.0 { -1 } else { 1 };
        let (i, j) = (beside(offset.x), beside(offset.y));
        let under = [(0, 0), (i, 0), (0, j), (i, j)].map(|(i, j)| {
            let w = tent(offset.x - i as f32) * tent(offset.y - j as f32);
            (x + i, y + j, if self.window.contains(x + i, y + j) { w } else { 0.0 })
        });
        let sum: f32 = under.iter().map(|(_, _, w)| w).sum();
        for (x, y, w) in under.into_iter().filter(|(_, _, w)| *w > 0.0) {
            self.give(x, y, f64::from(w / sum));
        }
    }

    fn give(&mut self, x: i32, y: i32, share: f64) {
        let at = (y - self.y0) as usize * self.across + (x - self.x0) as usize;
        let sums = &mut self.sums[at * self.each..(at + 1) * self.each];
        sums[0] += share;
        sums[COLOR..].iter_mut().zip(&self.shown).for_each(|(sum, value)| *sum += share * f64::from(*value));
        if let [squares, of_color @ ..] = &mut sums[self.moments..] {
            let square = share * share;
            *squares += square;
            for (channel, color) in self.shown[..3].iter().map(|c| f64::from(*c)).enumerate() {
                of_color[channel] += square * color;
                of_color[3 + channel] += square * color * color;
            }
        }
    }
}

/// What the tiles have for each pixel of a window, in its order; as in [`Spread`].
struct Sums {
    each: usize,
    moments: usize,
    sums: Vec<f64>,
}

/// Weight of the pixel filter along one axis, `x` pixels from the centre.
fn tent(x: f32) -> f32 {
    (1.0 - x.abs()).max(0.0)
}

impl Tile {
    /// Numbers that a sample shows beside its color.
    fn layers(&self) -> usize {
        let on = |there: bool, channels: usize| if there { channels } else { 0 };
        on(!self.buckets.is_empty(), 9)
            + on(!self.straight.is_empty(), 3)
            + 3 * self.light_aovs()
            + on(!self.lobes.is_empty(), 3 * LOBE_AOVS.len())
    }

    /// Gives a sample of pixel `i`, `offset` pixels from its centre, with its sums of AOVs of lights and by lobe, to the pixels
    /// around it.
    pub fn spread(&mut self, i: usize, offset: Vec2, sample: &super::Sample, lights: &[Rgb], lobes: &[Rgb]) {
        let Some(spread) = &mut self.spread else { return };
        let (x, y) = (self.x0 + (i as u32 % self.width) as i32, self.y0 + (i as u32 / self.width) as i32);
        let (buckets, straight) = (!self.buckets.is_empty(), !self.straight.is_empty());
        let shown = &mut spread.shown;
        shown.clear();
        shown.extend(sample.color().to_array());
        shown.push(sample.alpha);
        let layers = [sample.direct, sample.indirect, sample.subsurface];
        shown.extend(layers.iter().filter(|_| buckets).flat_map(|layer| layer.to_array()));
        shown.extend(straight.then_some(sample.straight).iter().flat_map(|layer| layer.to_array()));
        shown.extend(lights.iter().chain(lobes).flat_map(|layer| layer.to_array()));
        spread.add(x, y, offset);
    }

    /// A copy but for what it gives to other pixels, which is most of it.
    fn without_spread(&mut self) -> Self {
        let spread = self.spread.take();
        let copy = self.clone();
        self.spread = spread;
        copy
    }

    /// Puts `sums` of pixel `i` in the place of those of its own samples, as if as many of these had brought them.
    fn take(&mut self, i: usize, sums: &[f64], moments: usize) {
        let n = f64::from(self.samples[i]);
        let mean = |k: usize| sums[k] / sums[0];
        let rgb = |k: usize| DVec3::new(mean(k), mean(k + 1), mean(k + 2));
        let color = rgb(COLOR);
        if let Some(squares) = self.squares.get_mut(i) {
            // Of a mean with weights that do not depend on the values: sum w^2 (value - mean)^2 / (sum w)^2.
            let (squares_of, times, shares) = (rgb(moments + 4), rgb(moments + 1), mean(moments));
            let spread = (squares_of - 2.0 * color * times + color * color * shares) / sums[0];
            // `mean_variance` is to find n / (n - 1) of that.
            *squares = n * (n * spread + color * color);
        }
        self.color[i] = n * color;
        self.alpha[i] = (n * mean(ALPHA)) as f32;
        let mut at = LAYERS;
        let mut next = || {
            at += 3;
            (n * rgb(at - 3)).as_vec3()
        };
        self.buckets.get_mut(i).into_iter().flatten().for_each(|layer| *layer = next());
        self.straight.get_mut(i).into_iter().for_each(|layer| *layer = next());
        let each = self.lights.len() / self.samples.len();
        self.lights[i * each..(i + 1) * each].iter_mut().for_each(|layer| *layer = next());
        self.lobes.get_mut(i).into_iter().flatten().for_each(|layer| *layer = next());
    }
}

impl Film {
    /// Gives samples to every pixel under the filter. Geometry, albedo, primvars, walks and coverage by objects stay with their own
    /// pixel, whose samples are drawn by the same filter.
    ///
    /// # Errors
    /// Where the memory is not to be had.
    pub fn spreading(mut self) -> Result<Self> {
        let window = self.data_window;
        let each = self.tiles.first_mut().map_or(0, |tile| Spread::new(window, locked(tile)).each);
        super::check_memory(window, size_of::<f64>() * each)?;
        for tile in &mut self.tiles {
            let tile = locked(tile);
            tile.spread = Some(Spread::new(window, tile));
        }
        Ok(self)
    }

    /// Per sample of a pixel; `None`: samples are their own pixel's.
    fn spread_sums(&self) -> Option<Sums> {
        let (width, height) = (self.data_window.width() as usize, self.data_window.height() as usize);
        let mut all: Option<Sums> = None;
        self.for_each_tile(|tile| {
            let (Some(spread), n) = (&tile.spread, f64::from(tile.samples[0])) else { return };
            let Spread { each, moments, .. } = *spread;
            let all = all.get_or_insert_with(|| Sums { each, moments, sums: vec![0.0; width * height * each] });
            for (i, of_pixel) in spread.sums.chunks_exact(each).enumerate().filter(|_| n > 0.0) {
                let (x, y) = (spread.x0 + (i % spread.across) as i32, spread.y0 + (i / spread.across) as i32);
                if !self.data_window.contains(x, y) {
                    continue;
                }
                let at = y.abs_diff(self.data_window.y0) as usize * width + x.abs_diff(self.data_window.x0) as usize;
                let into = &mut all.sums[at * each..(at + 1) * each];
                // All pixels of a tile have as many samples; squares of shares go with the square of their number.
                let scale = |k: usize| if k < moments { n } else { n * n };
                into.iter_mut().zip(of_pixel).enumerate().for_each(|(k, (into, sum))| *into += sum / scale(k));
            }
        });
        all
    }

    /// The film as every pixel sees the samples around it, to be resolved; `None`: as it is.
    pub(super) fn gathered(&self) -> Option<Self> {
        let Sums { each, moments, sums } = self.spread_sums()?;
        let width = self.data_window.width() as usize;
        let mut tiles = Vec::with_capacity(self.tiles.len());
        for tile in &self.tiles {
            let mut tile = tile.lock().unwrap_or_else(PoisonError::into_inner).without_spread();
            for i in 0..tile.samples.len() {
                let x = tile.x0.abs_diff(self.data_window.x0) as usize + i % tile.width as usize;
                let y = tile.y0.abs_diff(self.data_window.y0) as usize + i / tile.width as usize;
                let of_pixel = &sums[(y * width + x) * each..][..each];
                if of_pixel[0] > 0.0 {
                    tile.take(i, of_pixel, moments);
                }
            }
            tiles.push(Mutex::new(tile));
        }
        let (aovs, object_ids) = (self.aovs.clone(), self.object_ids.clone());
        Some(Self { tiles, aovs, object_ids, ..*self })
    }
}

/// A panic while a tile was locked left sums that are still sums.
fn locked(tile: &mut Mutex<Tile>) -> &mut Tile {
    tile.get_mut().unwrap_or_else(PoisonError::into_inner)
}
