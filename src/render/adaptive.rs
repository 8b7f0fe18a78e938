//! Sharing out samples over the tiles by their noise, without bias.
//!
//! Stopping where the samples so far look quiet favours those that came out low: the mean is too dark. Here samples of
//! a pilot, with random numbers of their own, decide how many a tile gets; they teach the guide and are then thrown
//! away. Given the pilot, each tile is the mean of a fixed number of samples: unbiased.
//!
//! The least samples for an error of the whole image go to tiles in proportion to their standard deviation (Neyman
//! 1934): with V_t the variances summed over the A_t pixels of a tile, sum n_t A_t is least under
//! sum V_t / n_t = e^2 sum mean^2 for n_t = sqrt(V_t / A_t) sum_s sqrt(V_s A_s) / (e^2 sum mean^2).

use crate::error::Result;
use crate::film::{Film, TileNoise};
use crate::scene::Scene;
use serde::{Deserialize, Serialize};

/// Samples per pixel of the pilot; also the least that a tile gets, for what the pilot did not see may be there.
pub const PILOT_SAMPLES: u32 = 16;

/// A pilot misses rare light in one tile that it saw in the next: a tile counts as at least this share of its
/// neighbours' mean variance.
const NEIGHBOURS: f64 = 0.5;

/// What was decided, for the statistics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Adaptive {
    pub pilot_samples: u32,
    pub least_samples: u32,
    pub most_samples: u32,
    pub mean_samples: f64,
    pub tiles: usize,
    /// Tiles that would need more than `samples`.
    pub tiles_at_limit: usize,
    /// Relative error of the image that the pilot foresees.
    pub predicted_error: f64,
}

/// A film that tells variances.
pub fn pilot_film(scene: &Scene) -> Result<Film> {
    Film::new(scene.camera.data_window, &["variance".to_owned()], true, scene.camera.exposure)
}

/// Samples per tile for a relative error `wanted` of the image, at most `most`.
pub fn share_out(pilot: &Film, wanted: f32, most: u32) -> (Vec<u32>, Adaptive) {
    let noise = smoothed(&pilot.tile_noise(), pilot.tiles_across());
    let square: f64 = noise.iter().map(|tile| tile.square).sum();
    let deviations: f64 = noise.iter().map(|tile| (tile.variance * tile.pixels).sqrt()).sum();
    let scale = deviations / (f64::from(wanted).powi(2) * square);
    let needed = |tile: &TileNoise| match square > 0.0 {
        true => (tile.variance / tile.pixels).sqrt() * scale,
        // The pilot saw nothing at all: it cannot tell.
        false => f64::INFINITY,
    };
    let budget: Vec<u32> = noise
        .iter()
        .map(|tile| (needed(tile).ceil().min(f64::from(most)) as u32).max(PILOT_SAMPLES.min(most)))
        .collect();
    let left: f64 = noise.iter().zip(&budget).map(|(tile, &n)| tile.variance / f64::from(n)).sum();
    let pixels: f64 = noise.iter().map(|tile| tile.pixels).sum();
    let adaptive = Adaptive {
        pilot_samples: PILOT_SAMPLES,
        least_samples: budget.iter().copied().min().unwrap_or(0),
        most_samples: budget.iter().copied().max().unwrap_or(0),
        mean_samples: noise.iter().zip(&budget).map(|(tile, &n)| tile.pixels * f64::from(n)).sum::<f64>() / pixels,
        tiles: budget.len(),
        tiles_at_limit: noise.iter().filter(|tile| needed(tile) > f64::from(most)).count(),
        predicted_error: if square > 0.0 { (left / square).sqrt() } else { f64::MAX },
    };
    (budget, adaptive)
}

/// No tile far below its eight neighbours.
fn smoothed(noise: &[TileNoise], across: usize) -> Vec<TileNoise> {
    let down = noise.len() / across;
    let around = |i: usize| {
        let (x, y) = (i % across, i / across);
        let rows = y.saturating_sub(1)..(y + 2).min(down);
        rows.flat_map(move |y| (x.saturating_sub(1)..(x + 2).min(across)).map(move |x| y * across + x))
            .filter(move |&j| j != i)
    };
    let smooth = |i: usize| {
        let (count, sum) =
            around(i).fold((0.0, 0.0), |(count, sum), j| (count + 1.0, sum + noise[j].variance / noise[j].pixels));
        let floor = NEIGHBOURS * sum / f64::max(count, 1.0) * noise[i].pixels;
        TileNoise { variance: noise[i].variance.max(floor), ..noise[i] }
    };
    (0..noise.len()).map(smooth).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::DataWindow;
    use crate::film::Sample;
    use crate::math::Rgb;
    use crate::sampling::sampler::Sampler;

    /// A row of tiles.
    fn film(tiles: i32) -> Film {
        let window = DataWindow { x0: 0, y0: 0, x1: 16 * tiles, y1: 1 };
        Film::new(window, &["variance".into()], true, 1.0).expect("memory")
    }

    /// Adds `range` of samples to every pixel of a tile: 1 / p with probability p, else 0.
    fn fill(film: &Film, tile: usize, p: f32, seed: u32, range: std::ops::Range<u32>) {
        let mut tile = film.tiles[tile].lock().unwrap();
        for i in 0..(tile.width * tile.height) as usize {
            for sample in range.clone() {
                let hit = Sampler::new(seed, i as u32, sample).random() < p;
                let direct = Rgb::splat(if hit { 1.0 / p } else { 0.0 });
                tile.add(i, &Sample { direct, ..Sample::BLACK });
            }
        }
    }

    #[test]
    fn noisy_tiles_get_more() {
        let film = film(4);
        (0..3).for_each(|tile| fill(&film, tile, 0.5, tile as u32, 0..64));
        fill(&film, 3, 0.1, 9, 0..64);
        let (budget, adaptive) = share_out(&film, 0.1, 10_000);
        // Variances 1 and 9 of means 1, so that 3 times the samples, and sum V / n = e^2 sum mean^2.
        let ratio = f64::from(budget[3]) / f64::from(budget[0]);
        assert!((2.4..3.6).contains(&ratio), "{budget:?}");
        assert!((adaptive.predicted_error - 0.1).abs() < 0.002, "{adaptive:?}");
        // What the neighbour saw counts by half: its variance is 9.
        let ratio = f64::from(budget[2]) / f64::from(budget[0]);
        assert!((1.3..1.8).contains(&ratio), "{budget:?}");
        let (capped, adaptive) = share_out(&film, 0.1, 100);
        assert_eq!((capped, adaptive.tiles_at_limit), (vec![100; 4], 4));
        assert!(adaptive.predicted_error > 0.1);
    }

    #[test]
    fn a_black_pilot_decides_nothing() {
        let film = film(2);
        fill(&film, 0, 1e-9, 1, 0..16);
        fill(&film, 1, 1e-9, 1, 0..16);
        assert_eq!(share_out(&film, 0.1, 500).0, [500, 500]);
    }

    /// The mean over many renders is that of the samples: with the pilot thrown away. Deliberate mistake: with the pilot
    /// kept, as when one goes on until it looks quiet, it is not.
    #[test]
    fn throwing_the_pilot_away_keeps_the_mean() {
        let (mut thrown, mut kept) = (Vec::new(), Vec::new());
        for seed in 0..10_000 {
            let pilot = film(2);
            fill(&pilot, 0, 0.02, 2 * seed, 0..16);
            fill(&pilot, 1, 0.5, 2 * seed + 1_000_000, 0..16);
            let n = share_out(&pilot, 1.0, 4096).0[0];
            let image = film(2);
            fill(&image, 0, 0.02, 2 * seed + 1, 0..n);
            thrown.push(mean_of_tile(&image));
            // The pilot's samples count among the n.
            let image = film(2);
            fill(&image, 0, 0.02, 2 * seed, 0..16);
            fill(&image, 0, 0.02, 2 * seed + 1, 16..n.max(16));
            kept.push(mean_of_tile(&image));
        }
        let z = |means: &[f64]| {
            let n = means.len() as f64;
            let mean = means.iter().sum::<f64>() / n;
            let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
            (mean - 1.0) / (variance / n).sqrt()
        };
        assert!(z(&thrown).abs() < 4.0, "{}", z(&thrown));
        assert!(z(&kept) < -5.0, "{}", z(&kept));
    }

    fn mean_of_tile(film: &Film) -> f64 {
        let planes = film.resolve();
        planes[0].values.chunks(4).take(16).map(|pixel| f64::from(pixel[0])).sum::<f64>() / 16.0
    }
}
