//! The walks of a group at one of their vertices: the part of each in a step from there, eight at a time.

use crate::integrator::entry::{Entry, Kind, Vertex};
use crate::math::{Rgb, exp_in_lanes};
use glam::{BVec3, Vec3};
use std::ops::Range;

/// Walks of a block. Loops over them are what the compiler makes lanes of.
const WIDTH: usize = 8;

/// A number of each.
type Lanes = [f32; WIDTH];

/// By axis or channel.
type Lanes3 = [Lanes; 3];

/// Squared distance below which a step has no direction: it is that of the walk that made it.
const TOUCHING: f32 = 1e-30;

/// [`exp_in_lanes`] goes no further; what is left there, 1e-38, is no part of anything.
const DEEPEST: f32 = 87.0;

#[derive(Default)]
pub(super) struct Walks {
    blocks: Vec<Block>,
    /// What they get: by block, then by layer.
    next: Vec<Lanes3>,
    layers: usize,
    /// Blocks that may have a part in the step: of one that is a walk's own, its.
    within: Range<usize>,
    /// Whether they are at their entries.
    entering: bool,
    /// Whether channels have one extinction.
    grey: bool,
}

/// Lanes without a walk have no weight.
#[derive(Clone, Copy, Default)]
struct Block {
    /// Walk space.
    from: Lanes3,
    /// Of entries.
    ng: Lanes3,
    n: Lanes3,
    /// With which they go on; 0 in channels that they did not carry in.
    weight: Lanes3,
    sigma_t: Lanes3,
    /// [`Entry::expected`].
    expected: Lanes3,
    /// A_k F_k of a step but for what all have in common.
    reach: Lanes3,
    parts: Lanes3,
    /// Bits of those that have looked, or need not.
    asked: u32,
}

impl Walks {
    /// Those of `entries`, at their vertices `stage`; they have got nothing of the `layers` yet.
    pub fn gather<'a>(&mut self, entries: impl ExactSizeIterator<Item = &'a Entry>, stage: usize, layers: usize) {
        let blocks = entries.len().div_ceil(WIDTH);
        self.blocks.clear();
        self.blocks.resize(blocks, Block::default());
        self.next.clear();
        self.next.resize(blocks * layers, Lanes3::default());
        (self.layers, self.entering, self.grey) = (layers, stage == 0, true);
        for (k, entry) in entries.enumerate() {
            let sigma_t = entry.medium.sigma_t;
            self.grey &= sigma_t.x == sigma_t.y && sigma_t.y == sigma_t.z;
            self.blocks[k / WIDTH].set(k % WIDTH, entry, stage);
        }
    }

    /// The parts in a step to `to` if nothing is between; the walk `own` made it, along `d`.
    pub fn part(&mut self, to: &Vertex, own: usize, d: Vec3) {
        let block = own / WIDTH;
        if to.kind.is_own() {
            self.within = block..block + 1;
            self.blocks[block].reach = Lanes3::default();
        } else {
            self.within = 0..self.blocks.len();
            for (b, walks) in self.blocks.iter_mut().enumerate() {
                walks.asked = 0;
                let own = (block == b).then_some((own % WIDTH, d));
                walks.reach(to, self.entering.then_some(own), self.grey);
            }
        }
        self.share(own, |part, share| *part = share);
    }

    /// Asks which of those with a part of more than `least`, that have not been asked, `sees` the step, as is done one time in 1 / `q`: parts
    /// are what is seen on average. Returns how many were asked, how many do not.
    pub fn look(&mut self, own: usize, least: f32, q: f32, mut sees: impl FnMut(usize) -> bool) -> [u32; 2] {
        let [mut asked, mut blind] = [0; 2];
        self.blocks[own / WIDTH].asked |= 1 << (own % WIDTH);
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let mut left = block.above(least) & !block.asked;
            block.asked |= left;
            while left != 0 {
                let i = left.trailing_zeros() as usize;
                left &= left - 1;
                asked += 1;
                if !sees(b * WIDTH + i) {
                    blind += 1;
                    block.reach.iter_mut().for_each(|reach| reach[i] = 0.0);
                }
            }
        }
        if blind > 0 {
            self.share(own, |part, share| *part += (share - *part) / q);
        }
        [asked, blind]
    }

    /// Tells `take` each part and the share of the reach of all that it should be. Where rounding has left nothing of a step, it is that of `own`.
    fn share(&mut self, own: usize, take: impl Fn(&mut f32, f32)) {
        for c in 0..3 {
            let mut sums = Lanes::default();
            self.blocks[self.within.clone()]
                .iter()
                .for_each(|block| (0..WIDTH).for_each(|i| sums[i] += block.reach[c][i]));
            let sum: f32 = sums.iter().sum();
            let known = sum.is_finite() && sum >= f32::MIN_POSITIVE;
            if !known {
                self.blocks[self.within.clone()].iter_mut().for_each(|block| block.reach[c] = Lanes::default());
                self.blocks[own / WIDTH].reach[c][own % WIDTH] = 1.0;
            }
            let inverse = if known { 1.0 / sum } else { 1.0 };
            for Block { reach, parts, .. } in &mut self.blocks[self.within.clone()] {
                (0..WIDTH).for_each(|i| take(&mut parts[c][i], reach[c][i] * inverse));
            }
        }
    }

    /// Those that may have a part, and what they get by layer.
    fn with_next(&mut self) -> impl Iterator<Item = (&Block, &mut [Lanes3])> {
        let (blocks, next) = (&self.blocks[self.within.clone()], self.next.chunks_exact_mut(self.layers));
        blocks.iter().zip(next.skip(self.within.start))
    }

    /// Takes all parts in `channels` away.
    pub fn forget(&mut self, channels: BVec3) {
        for c in (0..3).filter(|c| channels.test(*c)) {
            self.blocks[self.within.clone()].iter_mut().for_each(|block| block.parts[c] = Lanes::default());
        }
    }

    /// Hands out the layers `light` by parts.
    pub fn split(&mut self, light: &[Rgb]) {
        for (block, next) in self.with_next() {
            for (next, light) in next.iter_mut().zip(light).filter(|(_, light)| **light != Rgb::ZERO) {
                for c in 0..3 {
                    (0..WIDTH).for_each(|i| next[c][i] += block.parts[c][i] * light[c]);
                }
            }
        }
    }

    /// Takes what walks are expected to bring off the first `layers`, by parts of what `arrived`: the parts of all steps from a vertex weigh
    /// as much as the walk did there.
    pub fn expect(&mut self, arrived: Rgb, layers: usize) {
        for (block, next) in self.with_next() {
            for next in &mut next[..layers] {
                for c in 0..3 {
                    (0..WIDTH).for_each(|i| next[c][i] -= block.parts[c][i] * arrived[c] * block.expected[c][i]);
                }
            }
        }
    }

    #[cfg(test)]
    pub fn part_of(&self, k: usize) -> Rgb {
        at(&self.blocks[k / WIDTH].parts, k % WIDTH)
    }

    /// What the walk `k` has got, by layer.
    pub fn got(&self, k: usize) -> impl Iterator<Item = Rgb> {
        let next = &self.next[k / WIDTH * self.layers..][..self.layers];
        next.iter().map(move |next| at(next, k % WIDTH))
    }
}

impl Block {
    fn set(&mut self, i: usize, entry: &Entry, stage: usize) {
        set(&mut self.from, i, entry.from(stage));
        set(&mut self.ng, i, entry.start.normal);
        set(&mut self.n, i, entry.normal);
        set(&mut self.weight, i, Rgb::select(entry.carried(), entry.weight(stage), Rgb::ZERO));
        set(&mut self.sigma_t, i, entry.medium.sigma_t);
        set(&mut self.expected, i, entry.expected);
    }

    /// Bits of those with a part of more than `least`.
    fn above(&self, least: f32) -> u32 {
        let part = |i: usize| self.parts[0][i].max(self.parts[1][i]).max(self.parts[2][i]);
        (0..WIDTH).fold(0, |bits, i| bits | u32::from(part(i) > least) << i)
    }

    /// `enters`: at their entries; there the direction of one lane is known better than from its ends.
    #[inline(always)]
    fn reach(&mut self, to: &Vertex, enters: Option<Option<(usize, Vec3)>>, grey: bool) {
        let (mut d, mut t, mut geometry) = (Lanes3::default(), Lanes::default(), Lanes::default());
        for i in 0..WIDTH {
            let way = to.p - at(&self.from, i);
            let squared = way.length_squared();
            let inverse = if squared > TOUCHING { 1.0 / squared } else { 0.0 };
            t[i] = squared.sqrt();
            geometry[i] = inverse;
            set(&mut d, i, way * inverse.sqrt());
        }
        if let Some(own) = enters {
            if let Some((i, own)) = own {
                set(&mut d, i, own);
            }
            (0..WIDTH).for_each(|i| geometry[i] *= entering(at(&d, i), at(&self.n, i), at(&self.ng, i)));
        }
        if let Kind::Leaves(n) = to.kind {
            (0..WIDTH).for_each(|i| geometry[i] *= at(&d, i).dot(n).max(0.0));
        }
        let mut transmittance = Lanes::default();
        for c in 0..3 {
            if c == 0 || !grey {
                let depth = |i: usize| (self.sigma_t[c][i] * t[i]).min(DEEPEST);
                (0..WIDTH).for_each(|i| transmittance[i] = exp_in_lanes(-depth(i)));
            }
            (0..WIDTH).for_each(|i| self.reach[c][i] = self.weight[c][i] * transmittance[i] * geometry[i]);
        }
    }
}

/// pi times the density of directions that enter along `d`: the cosine to the shading normal `n`, mirrored at the surface where that
/// does not get in.
#[inline(always)]
fn entering(d: Vec3, n: Vec3, ng: Vec3) -> f32 {
    let (cos, shading) = (d.dot(ng), d.dot(n));
    let mirrored = shading - 2.0 * cos * ng.dot(n);
    let enters = (-shading).max(0.0) + (-mirrored).max(0.0);
    if cos > 0.0 { 0.0 } else { enters }
}

#[inline(always)]
fn at(lanes: &Lanes3, i: usize) -> Vec3 {
    Vec3::new(lanes[0][i], lanes[1][i], lanes[2][i])
}

#[inline(always)]
fn set(lanes: &mut Lanes3, i: usize, v: Vec3) {
    (0..3).for_each(|axis| lanes[axis][i] = v[axis]);
}
