//! Paths that pixels share: what a walk brings behind a vertex goes to all walks that could have got there.
//!
//! Walks k of neighbouring pixels have come with the weights A_k to x_k, points of entry or collisions; one of them, j, goes on to x and
//! brings L_j in the end. With F_k(x) what gets from x_k to x without a collision, walk i has the part
//! A_i F_i / (sum_k A_k F_k) of L_j: the balance heuristic over the walks that could have made that step (Bekaert, Sbert, Halton 2002,
//! "Accelerating path tracing by re-using paths"). The parts of a walk add up to all of it, so that nothing gets brighter than it was. From
//! the last vertices that are noted back to the entries, light is spread over more and more neighbours. Groups are chosen by where
//! the x_k are, before anything is known of x, so that each step keeps the expectation of what is behind x_k.
//!
//! Next to never is anything between vertices so near each other, so parts are those without, and what a ray to each would change of them is
//! found for a random few of the steps, for which it stands ([`Looked`]).
//!
//! A dielectric boundary asks where light comes from: nobody shares what is behind it, nor a way by its reflection, but what
//! is behind the collisions before and after it; what these find of lights themselves is each walk's own.

use super::PathStats;
use super::entry::{Entry, Kind, Vertex, WIDE};
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment};
use crate::subsurface::steps::{Enclosure, Start, Step, Steps};
use glam::Vec3;
use walks::Walks;

/// Layers of the light that is shared: what pixels show, of it what belongs to no light; then AOVs.
const SHOWN: usize = 0;
const UNLIT: usize = 1;
const AOVS: usize = 2;

/// Side in pixels of a group of paths whose mean free path is so many pixels: all see much the same, few do, or some. No group is
/// larger than a tile.
fn side(across: f32) -> i32 {
    match across {
        _ if across > WIDE => 24,
        _ if across < 1.5 => 4,
        _ => 7,
    }
}

/// Side in pixels of the cell of a group of collisions: eight mean free paths, fewer where that would be many pixels, since each
/// is asked for each other's way.
fn cell(across: f32) -> f32 {
    (8.0 * across).min(12.0).max(2.0 * across)
}

/// Position errors that an exit is seen from this side of its surface by.
const MARGIN: f32 = 8.0;

/// Share of the steps of so many walks whose ways are looked along where nothing is known to be between; of more walks fewer, since each
/// has the less of a step.
const SELDOM: f32 = 0.125;
const MANY: f32 = 49.0;

/// Part of a step whose way is looked along always: by itself it would be a firefly.
const LARGE: f32 = 0.125;

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
    walks: Walks,
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
    /// [0, 1), which has to be another for each sample; `random` numbers say which ways are looked along.
    pub fn hand_out(
        &mut self,
        scene: Moment,
        shift: Vec3,
        random: &mut Sampler,
        stats: &mut PathStats,
        mut add: impl FnMut(usize, Rgb, Rgb, &[Rgb]),
    ) {
        let most = self.members.iter().map(|member| member.entry.most).max().unwrap_or(0);
        for stage in (0..=most).rev() {
            self.stage(scene, stage, shift, random, stats);
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
    fn stage(&mut self, scene: Moment, stage: usize, shift: Vec3, random: &mut Sampler, stats: &mut PathStats) {
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        let members = self.members.iter().enumerate();
        order.extend(members.filter_map(|(i, member)| Some((member.group(stage, shift)?, i))));
        order.sort_unstable();
        for group in order.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
            self.group(scene, stage, group, random, stats);
        }
        self.order = order;
    }

    /// The same of one group.
    fn group(
        &mut self,
        scene: Moment,
        stage: usize,
        of: &[(Group, usize)],
        random: &mut Sampler,
        stats: &mut PathStats,
    ) {
        let Self { members, light, layers, walks, .. } = self;
        let enclosure = InstanceEnclosure::new(scene, of[0].0.0[0]);
        let group = Around { members, of, stage, enclosure };
        walks.gather((0..of.len()).map(|k| group.entry(k)), stage, *layers);
        let expects = (0..of.len()).any(|k| group.entry(k).expected != Rgb::ZERO);
        let row = |k: usize| of[k].1 * *layers..(of[k].1 + 1) * *layers;
        let mut looked = Looked::of((0..of.len()).map(|k| group.brings(k, light[row(k)][SHOWN])));
        for own in 0..of.len() {
            let light = &light[row(own)];
            let nothing = !expects && light.iter().all(|light| *light == Rgb::ZERO);
            let Some(to) = group.to(own).filter(|_| !nothing) else { continue };
            walks.part(to, own, group.entry(own).start.d);
            if !to.kind.is_own() {
                let sees = |k: usize| group.entry(k).sees(&group.enclosure, stage, to);
                looked.look(walks, own, group.brings(own, light[SHOWN]), random.random(), sees);
            }
            // Of a channel that the walk did not carry it knows nothing.
            walks.forget(!group.entry(own).carried());
            walks.split(light);
            if expects {
                walks.expect(to.arrived, AOVS);
            }
        }
        stats.shadow_rays += looked.rays;
        for k in 0..of.len() {
            group.take(k, walks, &mut light[row(k)]);
        }
    }
}

/// The paths of a group, at their vertices `stage`.
struct Around<'a> {
    members: &'a [Member],
    of: &'a [(Group, usize)],
    stage: usize,
    enclosure: InstanceEnclosure<'a>,
}

impl Around<'_> {
    fn entry(&self, k: usize) -> &Entry {
        &self.members[self.of[k].1].entry
    }

    /// Where one went from there.
    fn to(&self, k: usize) -> Option<&Vertex> {
        self.entry(k).vertices().get(self.stage)
    }

    /// How much it brings from behind that, `shown`, or how far that is from what is expected, which is not taken off AOVs.
    fn brings(&self, k: usize, shown: Rgb) -> f32 {
        let expected = self.to(k).map_or(Rgb::ZERO, |to| to.arrived * self.entry(k).expected);
        (shown - expected).abs().max(shown.abs()).max_element()
    }

    /// Puts into `row` what it has got, and what is expected, which was taken off.
    fn take(&self, k: usize, walks: &Walks, row: &mut [Rgb]) {
        row.iter_mut().zip(walks.got(k)).for_each(|(light, got)| *light = got);
        let expected = self.entry(k).weight(self.stage) * self.entry(k).expected;
        row[SHOWN] += expected;
        row[UNLIT] += expected;
    }
}

/// What looking along the ways of a group has shown.
struct Looked {
    /// Where it was left to chance.
    asked: u32,
    blind: u32,
    /// In all.
    rays: u64,
    walks: f32,
    /// Of what they bring.
    mean: f32,
}

impl Looked {
    fn of(brought: impl ExactSizeIterator<Item = f32>) -> Self {
        let walks = brought.len() as f32;
        Self { asked: 0, blind: 0, rays: 0, walks, mean: brought.sum::<f32>() / walks }
    }

    /// Who `sees` the step that walk `own` made and that has `brought` so much: those with a large part, and, by the random number `u`, all.
    fn look(&mut self, walks: &mut Walks, own: usize, brought: f32, u: f32, sees: impl Fn(usize) -> bool) {
        let q = self.probability(brought);
        self.rays += u64::from(walks.look(own, LARGE, 1.0, &sees)[0]);
        if u < q {
            let [asked, blind] = walks.look(own, 0.0, q, &sees);
            (self.asked, self.blind) = (self.asked + asked, self.blind + blind);
            self.rays += u64::from(asked);
        }
    }

    /// With which to look along those of the step of a walk that has `brought` so much: seldom, since next to nothing is ever between, but
    /// where something was, and in proportion, so that none that stands for many is a firefly. What comes of it has no part in it, so
    /// that it stands for all on average.
    fn probability(&self, brought: f32) -> f32 {
        let blind = self.blind as f32 / self.asked.max(1) as f32;
        let of_all = (4.0 * blind).clamp(SELDOM, 1.0) * (MANY / self.walks).min(1.0);
        let over_mean = if self.mean > 0.0 { brought / self.mean } else { 1.0 };
        (of_all * (0.2 + 0.8 * over_mean)).min(1.0)
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

    /// Where it goes on from the vertex `stage`, walk space.
    fn from(&self, stage: usize) -> Vec3 {
        if stage == 0 { self.start.p } else { self.vertices()[stage - 1].p }
    }

    /// Whether nothing is between the vertex `stage` and `to`: by the walk's own rules.
    fn sees(&self, enclosure: &InstanceEnclosure, stage: usize, to: &Vertex) -> bool {
        let from = self.from(stage);
        let t = from.distance(to.p);
        let d = (to.p - from) / t;
        let t = if matches!(to.kind, Kind::Leaves(_)) { t - MARGIN * enclosure.position_error() } else { t };
        if stage > 0 {
            return enclosure.cast(from, d, t, None).is_none();
        }
        !matches!(Steps::new(enclosure, Start { d, ..self.start }).advance(d, t), Step::Boundary { .. })
    }
}

mod walks;

#[cfg(test)]
mod tests;
