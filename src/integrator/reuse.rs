//! Paths that pixels share: what a walk brings behind a vertex goes to all walks that could have got there.
//!
//! Walks k of neighbouring pixels are at x_k, a point of entry or a collision, with weights A_k; one of them, j, goes on to x, and
//! brings L_j in the end. With F_k(x) what comes from x_k to x without a collision, walk i gets
//! A_i F_i / (sum_k A_k F_k) L_j: the balance heuristic over the walks that could have made that step (Veach and Guibas 1995; Bekaert, Sbert,
//! Halton 2002, "Accelerating path tracing by re-using paths"). The parts of a walk add up to all of it, so that nothing is brighter than
//! it was. From the last vertices that are noted back to the entries, a walk's light is spread over more and more of its neighbours.

use super::PathStats;
use super::entry::{Entry, Vertex};
use crate::math::Rgb;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::{Enclosure, Start, Step, Steps};
use glam::Vec3;

/// Layers of the light that is shared: what pixels show, of it what belongs to no light; then AOVs.
const SHOWN: usize = 0;
const UNLIT: usize = 1;
const AOVS: usize = 2;

/// A position error is as much of the way that a vertex may be on the wrong side of a boundary by.
const MARGIN: f32 = 8.0;

/// The paths of a tile, one per pixel, whose light may be shared.
#[derive(Default)]
pub struct Shared {
    pixels: Vec<(usize, [i32; 2])>,
    entries: Vec<Entry>,
    /// By entry, then by layer: per throughput.
    light: Vec<Rgb>,
    layers: usize,
    order: Vec<(Key, usize)>,
    reach: Vec<Rgb>,
    next: Vec<Rgb>,
}

/// The cell of a vertex: instance, binary logarithm of the cell's size, place.
type Key = (u32, i32, [i32; 3]);

impl Shared {
    pub fn clear(&mut self, layers: usize) {
        self.pixels.clear();
        self.entries.clear();
        self.light.clear();
        self.layers = AOVS + layers;
    }

    /// The path of pixel `i`, with the AOVs of its light.
    pub fn push(&mut self, i: usize, pixel: [i32; 2], entry: Entry, aovs: &[Rgb]) {
        let carried = entry.throughput.cmpgt(Rgb::ZERO);
        let per_throughput = |light: Rgb| Rgb::select(carried, light / entry.throughput, Rgb::ZERO);
        self.pixels.push((i, pixel));
        self.light.extend([per_throughput(entry.brought) - entry.correction, -entry.correction]);
        self.light.extend(aovs.iter().map(|light| per_throughput(*light)));
        self.entries.push(entry);
    }

    /// Hands it out: `add` gets the pixel, what it shows, what of it belongs to no light, AOVs. Cells are moved by `shift` in [0, 1).
    pub fn hand_out(
        &mut self,
        scene: Moment,
        shift: Vec3,
        stats: &mut PathStats,
        mut add: impl FnMut(usize, Rgb, Rgb, &[Rgb]),
    ) {
        let most = self.entries.iter().map(|entry| entry.most as usize).max().unwrap_or(0);
        for stage in (0..most).rev() {
            self.stage(scene, stage, shift, stats);
        }
        let rows = self.light.chunks_exact_mut(self.layers);
        for (((i, _), entry), row) in self.pixels.iter().zip(&self.entries).zip(rows) {
            row.iter_mut().for_each(|light| *light *= entry.throughput);
            add(*i, row[SHOWN], row[UNLIT], &row[AOVS..]);
        }
    }

    /// Shares what is behind the vertex `stage` of all paths.
    fn stage(&mut self, scene: Moment, stage: usize, shift: Vec3, stats: &mut PathStats) {
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        order.extend(self.entries.iter().enumerate().filter_map(|(i, entry)| Some((entry.cell(stage, self.pixels[i].1, shift)?, i))));
        order.sort_unstable();
        for cell in order.chunk_by(|a, b| a.0 == b.0).filter(|cell| cell.len() > 1) {
            self.cell(scene, stage, cell, stats);
        }
        self.order = order;
    }

    /// The same of those in one cell.
    fn cell(&mut self, scene: Moment, stage: usize, cell: &[(Key, usize)], stats: &mut PathStats) {
        let Self { entries, light, layers, reach, next, .. } = self;
        let layers = *layers;
        let enclosure = InstanceEnclosure::new(scene, cell[0].0.0);
        next.clear();
        next.resize(cell.len() * layers, Rgb::ZERO);
        let expects = cell.iter().any(|(_, k)| entries[*k].expected != Rgb::ZERO);
        for (_, j) in cell {
            let from = &entries[*j];
            let row = &light[j * layers..(j + 1) * layers];
            let Some(to) = from.vertices().get(stage) else { continue };
            if !expects && row.iter().all(|light| *light == Rgb::ZERO) {
                continue;
            }
            reach.clear();
            reach.extend(cell.iter().map(|(_, k)| {
                let of = &entries[*k];
                if of.medium != from.medium {
                    return Rgb::ZERO;
                }
                stats.shadow_rays += u64::from(k != j);
                of.reach(&enclosure, stage, to, k == j)
            }));
            let sum: Rgb = reach.iter().sum();
            for (n, (_, k)) in cell.iter().enumerate() {
                let all = if k == j { Rgb::ONE } else { Rgb::ZERO };
                let share = Rgb::select(sum.cmpgt(Rgb::ZERO), reach[n] / sum, all);
                if share == Rgb::ZERO {
                    continue;
                }
                let next = &mut next[n * layers..(n + 1) * layers];
                next.iter_mut().zip(row).for_each(|(next, light)| *next += share * *light);
                let expected = share * to.weight * entries[*k].expected;
                next[SHOWN] -= expected;
                next[UNLIT] -= expected;
            }
        }
        for (n, (_, k)) in cell.iter().enumerate() {
            let (row, entry) = (&mut light[k * layers..(k + 1) * layers], &entries[*k]);
            row.copy_from_slice(&next[n * layers..(n + 1) * layers]);
            let expected = entry.scattered(stage) * entry.expected;
            row[SHOWN] += expected;
            row[UNLIT] += expected;
        }
    }
}

impl Entry {
    /// The cell of the vertex `stage`, if what is behind it may be shared.
    fn cell(&self, stage: usize, pixel: [i32; 2], shift: Vec3) -> Option<Key> {
        if stage >= self.most as usize {
            return None;
        }
        let across = self.across();
        if stage == 0 {
            let side = if across < env("C2", 1.5) { 2 } else { env("CN", 5.0) as i32 };
            let at = [pixel[0] + (shift.x * 64.0) as i32, pixel[1] + (shift.y * 64.0) as i32];
            return Some((self.instance, side, [at[0].div_euclid(side), at[1].div_euclid(side), 0]));
        }
        let p = self.vertices().get(stage - 1).filter(|vertex| vertex.exit.is_none())?.p;
        let log = (env("CW", 2.0) * across * self.footprint).log2().round();
        let at = (p / log.exp2() + shift).floor().as_ivec3();
        Some((self.instance, log as i32, at.to_array()))
    }

    /// Weight with which a walk goes on from the vertex `stage`.
    fn scattered(&self, stage: usize) -> Rgb {
        match stage {
            0 => Rgb::ONE,
            _ => self.vertices()[stage - 1].weight * self.medium.albedo,
        }
    }

    /// A_k F_k: what comes from the vertex `stage` to `to`; `own`: the walk did go there. A factor that all walks have in common is left out.
    fn reach(&self, enclosure: &InstanceEnclosure, stage: usize, to: &Vertex, own: bool) -> Rgb {
        let from = if stage == 0 { self.start.p } else { self.vertices()[stage - 1].p };
        let way = to.p - from;
        let squared = way.length_squared();
        let t = squared.sqrt();
        let d = if own && stage == 0 { self.start.d } else { way / t };
        let leaving = if stage == 0 { entering(d, self.normal, self.start.normal) } else { 1.0 };
        let arriving = to.exit.map_or(1.0, |n| d.dot(n).abs());
        let geometry = leaving * arriving / squared;
        if !(geometry > 0.0 && geometry.is_finite()) {
            return Rgb::ZERO;
        }
        // A channel that is not carried in is not measured.
        let carried = self.throughput.cmpgt(Rgb::ZERO);
        let weight = if stage == 0 { Rgb::ONE } else { self.vertices()[stage - 1].weight };
        let reach = Rgb::select(carried, weight * self.medium.transmittance(t) * geometry, Rgb::ZERO);
        if own {
            return reach;
        }
        let t = if to.exit.is_some() { t - MARGIN * enclosure.position_error() } else { t };
        let blocked = if stage == 0 {
            !matches!(Steps::new(enclosure, Start { d, ..self.start }).advance(d, t), Step::Collision)
        } else {
            enclosure.cast(from, d, t, None).is_some()
        };
        if blocked { Rgb::ZERO } else { reach }
    }
}

pub(super) fn env(name: &'static str, d: f32) -> f32 {
    use std::sync::OnceLock;
    static V: OnceLock<std::collections::HashMap<String, f32>> = OnceLock::new();
    let v = V.get_or_init(|| std::env::vars().filter_map(|(k, v)| Some((k, v.parse().ok()?))).collect());
    v.get(name).copied().unwrap_or(d)
}

/// pi times the density of directions that enter along `d`: cosine to the shading normal, mirrored at the surface where
/// that does not get in.
fn entering(d: Vec3, normal: Vec3, ng: Vec3) -> f32 {
    let cos = d.dot(ng);
    if cos > 0.0 {
        return 0.0;
    }
    let mirrored = d - 2.0 * cos * ng;
    (-d.dot(normal)).max(0.0) + (-mirrored.dot(normal)).max(0.0)
}
