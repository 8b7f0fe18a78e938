//! Paths that pixels share: what a walk brings behind a vertex goes to all walks that could have got there.
//!
//! Walks k of neighbouring pixels have come with the weights A_k to x_k, points of entry or collisions; one of them, j, goes on to x and
//! brings L_j in the end. With F_k(x) what gets from x_k to x without a collision, walk i has the part
//! A_i F_i / (sum_k A_k F_k) of L_j: the balance heuristic over the walks that could have made that step (Bekaert, Sbert, Halton 2002,
//! "Accelerating path tracing by re-using paths"). The parts of a walk add up to all of it, so that nothing gets brighter than it was. From
//! the last vertices that are noted back to the entries, light is spread over more and more neighbours. Groups are chosen by where
//! the x_k are, before anything is known of x, so that each step keeps the expectation of what is behind x_k.
//!
//! A dielectric boundary asks where light comes from: nobody shares what is behind it, nor a way by its reflection, but what
//! is behind the collisions before and after it; what these find of lights themselves is each walk's own.

use super::PathStats;
use super::entry::{Entry, Kind, Vertex, WIDE};
use crate::math::Rgb;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::{Enclosure, Start, Step, Steps};
use glam::Vec3;

/// Layers of the light that is shared: what pixels show, of it what belongs to no light; then AOVs.
const SHOWN: usize = 0;
const UNLIT: usize = 1;
const AOVS: usize = 2;

/// Side in pixels of a group of paths whose mean free path is so many pixels: all see much the same, few do, or some.
fn side(across: f32) -> i32 {
    match across {
        _ if across > WIDE => 7,
        _ if across < 1.5 => 2,
        _ => 4,
    }
}

/// Side in pixels of the cell of a group of collisions: four mean free paths, two where that would be many pixels, since each
/// is asked for each other's way.
fn cell(across: f32) -> f32 {
    (4.0 * across).min(6.0).max(2.0 * across)
}

/// Position errors that an exit is seen from this side of its surface by.
const MARGIN: f32 = 8.0;

/// The paths of a tile, one per pixel, whose light may be shared. Light is per throughput.
#[derive(Default)]
pub struct Shared {
    members: Vec<Member>,
    /// By member, then by layer: what is behind the vertices that are under way.
    light: Vec<Rgb>,
    /// By member, by vertex, then by layer: what it brought there, and since, by itself.
    own: Vec<Rgb>,
    layers: usize,
    // Scratch memory.
    order: Vec<(Group, usize)>,
    reach: Vec<Rgb>,
    next: Vec<Rgb>,
}

/// The path of a pixel.
struct Member {
    /// Index in the tile.
    pixel: usize,
    /// On the image.
    at: [i32; 2],
    entry: Entry,
    /// Of its part of [`Shared::own`].
    own: usize,
}

/// Instance and surface, whose medium is one; size of the group (minus pixels, or a binary logarithm of a cell's side), place.
type Group = ([u32; 2], i32, [i32; 3]);

impl Shared {
    /// Forgets all; paths to come have so many `aovs`.
    pub fn clear(&mut self, aovs: usize) {
        self.members.clear();
        self.light.clear();
        self.own.clear();
        self.layers = AOVS + aovs;
    }

    /// The path of pixel `pixel` of the tile, `at` on the image, with what it brought by vertex ([`super::WalkLog::rows`]).
    pub fn push(&mut self, pixel: usize, at: [i32; 2], entry: Entry, rows: &[Rgb]) {
        let carried = entry.carried();
        let per_throughput = |light: &Rgb| Rgb::select(carried, *light / entry.throughput, Rgb::ZERO);
        let own = self.own.len();
        for row in rows.chunks_exact(self.layers - AOVS + 1) {
            self.own.extend([per_throughput(&row[0]), Rgb::ZERO]);
            self.own.extend(row[1..].iter().map(per_throughput));
        }
        let last = self.own.len() - self.layers;
        self.own[last + SHOWN] -= entry.correction;
        self.own[last + UNLIT] -= entry.correction;
        self.light.resize(self.light.len() + self.layers, Rgb::ZERO);
        self.members.push(Member { pixel, at, entry, own });
    }

    /// Hands the light out: `add` gets the pixel, what it shows, what of it belongs to no light, AOVs. Groups are moved by `shift` in
    /// [0, 1), which has to be another for each sample.
    pub fn hand_out(
        &mut self,
        scene: Moment,
        shift: Vec3,
        stats: &mut PathStats,
        mut add: impl FnMut(usize, Rgb, Rgb, &[Rgb]),
    ) {
        let most = self.members.iter().map(|member| member.entry.most).max().unwrap_or(0);
        for stage in (0..=most).rev() {
            self.stage(scene, stage, shift, stats);
            self.take_own(stage);
        }
        for (member, row) in self.members.iter().zip(self.light.chunks_exact_mut(self.layers)) {
            row.iter_mut().for_each(|light| *light *= member.entry.throughput);
            add(member.pixel, row[SHOWN], row[UNLIT], &row[AOVS..]);
        }
    }

    /// Adds what paths brought by themselves at their vertices `stage`.
    fn take_own(&mut self, stage: usize) {
        let Self { members, light, own, layers, .. } = self;
        for (member, row) in members.iter().zip(light.chunks_exact_mut(*layers)) {
            if stage <= member.entry.vertices().len() {
                let own = &own[member.own + stage * *layers..];
                row.iter_mut().zip(own).for_each(|(light, own)| *light += *own);
            }
        }
    }

    /// Shares what is behind the vertices `stage` of all paths, 0 being the entry.
    fn stage(&mut self, scene: Moment, stage: usize, shift: Vec3, stats: &mut PathStats) {
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        let members = self.members.iter().enumerate();
        order.extend(members.filter_map(|(i, member)| Some((member.group(stage, shift)?, i))));
        order.sort_unstable();
        for group in order.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
            self.group(scene, stage, group, stats);
        }
        self.order = order;
    }

    /// The same of one group.
    fn group(&mut self, scene: Moment, stage: usize, group: &[(Group, usize)], stats: &mut PathStats) {
        let enclosure = InstanceEnclosure::new(scene, group[0].0.0[0]);
        self.next.clear();
        self.next.resize(group.len() * self.layers, Rgb::ZERO);
        let expects = group.iter().any(|(_, k)| self.members[*k].entry.expected != Rgb::ZERO);
        for (_, j) in group {
            let nothing = self.row(*j).iter().all(|light| *light == Rgb::ZERO);
            let to = self.members[*j].entry.vertices().get(stage).copied();
            if let Some(to) = to.filter(|_| expects || !nothing) {
                self.split(&enclosure, stage, group, *j, &to, stats);
            }
        }
        for (n, (_, k)) in group.iter().enumerate() {
            let entry = &self.members[*k].entry;
            let row = &mut self.light[k * self.layers..(k + 1) * self.layers];
            row.copy_from_slice(&self.next[n * self.layers..(n + 1) * self.layers]);
            let expected = entry.weight(stage) * entry.expected;
            row[SHOWN] += expected;
            row[UNLIT] += expected;
        }
    }

    /// Splits what member `j` brings from behind its vertex `to`.
    fn split(
        &mut self,
        enclosure: &InstanceEnclosure,
        stage: usize,
        group: &[(Group, usize)],
        j: usize,
        to: &Vertex,
        stats: &mut PathStats,
    ) {
        let Self { members, light, layers, reach, next, .. } = self;
        let row = &light[j * *layers..(j + 1) * *layers];
        reach.clear();
        for (_, k) in group {
            stats.shadow_rays += u64::from(*k != j && !to.kind.is_own());
            reach.push(members[*k].entry.reach(enclosure, stage, to, *k == j));
        }
        let sum: Rgb = reach.iter().sum();
        // Of a channel that the walk did not carry it knows nothing.
        let carried = members[j].entry.carried();
        for (n, (_, k)) in group.iter().enumerate() {
            // Where rounding has left nothing of a step, it is that of the walk that made it.
            let all = if *k == j { Rgb::ONE } else { Rgb::ZERO };
            let part = Rgb::select(sum.cmpgt(Rgb::ZERO), reach[n] / sum, all);
            let part = Rgb::select(carried, part, Rgb::ZERO);
            if part != Rgb::ZERO {
                let next = &mut next[n * *layers..(n + 1) * *layers];
                next.iter_mut().zip(row).for_each(|(next, light)| *next += part * *light);
                // Control variate: the parts of all steps from a vertex weigh as much as the walk did there.
                let expected = part * to.arrived * members[*k].entry.expected;
                next[SHOWN] -= expected;
                next[UNLIT] -= expected;
            }
        }
    }

    fn row(&self, member: usize) -> &[Rgb] {
        &self.light[member * self.layers..(member + 1) * self.layers]
    }
}

impl Member {
    /// The group of the vertex `stage`, if what is behind it is shared. Of what is behind an exit, nothing is.
    fn group(&self, stage: usize, shift: Vec3) -> Option<Group> {
        let entry = &self.entry;
        if stage < entry.from || stage >= entry.most {
            return None;
        }
        let (of, across) = ([entry.instance, entry.surface], entry.across());
        if stage > 0 && !entry.vertices().get(stage - 1)?.kind.scatters() {
            return None;
        }
        if stage == 0 || across > WIDE {
            let side = side(across);
            let place = |at: i32, shift: f32| (at + (shift * side as f32) as i32).div_euclid(side);
            return Some((of, -side, [place(self.at[0], shift.x), place(self.at[1], shift.y), 0]));
        }
        let p = entry.vertices()[stage - 1].p;
        // A size that all in the group agree on, though their pixels differ a little.
        let log = (cell(across) * entry.footprint).log2().round();
        let place = (p / log.exp2() + shift).floor().as_ivec3();
        Some((of, log as i32, place.to_array()))
    }
}

impl Entry {
    /// Weight with which a walk goes on from the vertex `stage`.
    fn weight(&self, stage: usize) -> Rgb {
        if stage == 0 { Rgb::ONE } else { self.vertices()[stage - 1].weight }
    }

    /// A_k F_k of a step from the vertex `stage` to `to`, but for what all steps there have in common; `own`: the walk made it.
    fn reach(&self, enclosure: &InstanceEnclosure, stage: usize, to: &Vertex, own: bool) -> Rgb {
        if to.kind.is_own() {
            return if own { Rgb::ONE } else { Rgb::ZERO };
        }
        let from = if stage == 0 { self.start.p } else { self.vertices()[stage - 1].p };
        let squared = from.distance_squared(to.p);
        let t = squared.sqrt();
        let d = if own && stage == 0 { self.start.d } else { (to.p - from) / t };
        let leaving = if stage == 0 { entering(d, self.normal, self.start.normal) } else { 1.0 };
        let arriving = if let Kind::Leaves(n) = to.kind { d.dot(n).max(0.0) } else { 1.0 };
        let geometry = leaving * arriving / squared;
        if !(geometry > 0.0 && geometry.is_finite()) {
            return Rgb::ZERO;
        }
        let reach = self.weight(stage) * self.medium.transmittance(t) * geometry;
        let reach = Rgb::select(self.carried(), reach, Rgb::ZERO);
        if own || self.sees(enclosure, stage, from, d, to, t) { reach } else { Rgb::ZERO }
    }

    /// Whether nothing is between the vertex `stage`, `from`, and `to`, `t` along `d`: by the walk's own rules.
    fn sees(&self, enclosure: &InstanceEnclosure, stage: usize, from: Vec3, d: Vec3, to: &Vertex, t: f32) -> bool {
        let t = if matches!(to.kind, Kind::Leaves(_)) { t - MARGIN * enclosure.position_error() } else { t };
        if stage > 0 {
            return enclosure.cast(from, d, t, None).is_none();
        }
        !matches!(Steps::new(enclosure, Start { d, ..self.start }).advance(d, t), Step::Boundary { .. })
    }
}

/// pi times the density of directions that enter along `d`: the cosine to the shading `normal`, mirrored at the surface where that
/// does not get in.
fn entering(d: Vec3, normal: Vec3, ng: Vec3) -> f32 {
    let cos = d.dot(ng);
    if cos > 0.0 {
        return 0.0;
    }
    let mirrored = d - 2.0 * cos * ng;
    (-d.dot(normal)).max(0.0) + (-mirrored.dot(normal)).max(0.0)
}

#[cfg(test)]
mod tests;
