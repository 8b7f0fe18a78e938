//! How a path goes on where its first walk comes out: in how many ways, and which later walks are worth their time.
//!
//! A path whose walk has the variance V0 and costs C0, and goes on in n ways of variance Vw and cost Cw each, has
//! the variance V0 + Vw / n for C0 + n Cw: their product is least at n^2 = (Vw / Cw) / (V0 / C0). The same of a walk that is met
//! later says how often it is worth being walked; its expected value stands for those that are not (after Rath et al. 2022,
//! "EARS: Efficiency-Aware Russian Roulette and Splitting").

use crate::math::{Rgb, mean};
use bytemuck::{Pod, Zeroable};

/// Steps of walks that a ray to a surface, with what is shaded there, and a shadow ray count for: seconds would not give the same
/// image twice. Larger than their times, which are nearer 3 and 2: 15 was better than 6 (docs/performance.md), since the variance of
/// the mean of several ways, drawn from a lattice, is less than that of as many independent ones.
pub const RAY_COST: u64 = 15;
pub const SHADOW_RAY_COST: u64 = 9;

/// Sums over the walks that started in a region.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Effort {
    walks: f64,
    /// Estimates per channel, relative to what the path carried in.
    estimate: [f64; 3],
    /// Their means over channels less the controls, and the squares of those.
    moments: [f64; 2],
    /// From the start of the walk to the end of the path.
    cost: f64,
    /// Of the number of ways, and of 1 over it.
    ways: f64,
    inverse: f64,
    /// Walks that would go on in several ways, whether they came out or not.
    forked: f64,
    /// Of those: variance of one way, and its cost.
    way_variance: f64,
    way_cost: f64,
    /// Reflections that were followed beside a walk, the probabilities with which they would have been drawn in its place.
    reflections: f64,
    chance: f64,
    /// What they brought, as the moments above, and what they cost.
    reflected: [f64; 2],
    reflected_cost: f64,
}

/// What one walk, and what followed, took.
#[derive(Debug, Clone, Copy)]
pub struct Taken {
    pub cost: u64,
    /// In which the path would go on, whether the walk came out or not.
    pub ways: u32,
    /// Variance between ways, of the mean over channels.
    pub way_variance: f64,
    /// Of all ways.
    pub ways_cost: u64,
}

/// What follows for walks that start in a region.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Onward {
    /// In which a path goes on where its first walk comes out.
    pub ways: u32,
    /// Whether what the first surface reflects is followed beside the walk; drawn in its place otherwise.
    pub parted: u32,
    /// Root of variance over cost, per throughput; 0: not known.
    pub worth: f32,
    /// Expected value of a walk.
    pub expected: Rgb,
    /// Variance of a walk, over its squared mean; infinite: not known.
    pub noise: f32,
}

impl Onward {
    /// Before anything is known: what tells the ways apart, and reflections from walks.
    pub const UNKNOWN: Self = Self { ways: 2, parted: 1, worth: 0.0, expected: Rgb::ZERO, noise: f32::INFINITY };
}

/// Most ways: 16 were no better where light comes from a card, and worse elsewhere.
const MOST_WAYS: f64 = 4.0;

/// Walks from which sums say something: few may have missed the light that the others find.
const LEAST_WALKS: f64 = 256.0;

/// Walks from which their noise is told from none at all.
const FEW_WALKS: f64 = 32.0;

/// Share of the variance that is the walk's own, at least: what is left of a difference of two estimates may be anything.
const LEAST_OWN: f64 = 0.05;

/// What a path costs before its first walk: a ray from the camera, and one to a light.
const CAMERA_COST: f64 = (RAY_COST + SHADOW_RAY_COST) as f64;

/// Numbers of an [`Effort`].
const SUMS: usize = size_of::<Effort>() / size_of::<f64>();

/// Least probability of survival.
const LEAST_SURVIVAL: f32 = 0.1;

/// Largest throughput of a walk that survives, over that of the first: regions may bring more than is known of them.
const MOST_LIFTED: f32 = 2.0;

impl Effort {
    /// A walk that brought `estimate` per unit of throughput, `residual` less the controls.
    pub fn add(&mut self, estimate: Rgb, residual: Rgb, taken: &Taken) {
        let gray = f64::from(mean(residual));
        self.walks += 1.0;
        (0..3).for_each(|c| self.estimate[c] += f64::from(estimate[c]));
        self.moments[0] += gray;
        self.moments[1] += gray * gray;
        self.cost += taken.cost as f64;
        self.ways += f64::from(taken.ways);
        self.inverse += 1.0 / f64::from(taken.ways);
        if taken.ways > 1 {
            self.forked += 1.0;
            self.way_variance += taken.way_variance;
            self.way_cost += taken.ways_cost as f64 / f64::from(taken.ways);
        }
    }

    /// A reflection beside a walk, which brought `estimate` per unit of the walk's throughput, and would have been drawn in its place
    /// with probability `chance`.
    pub fn add_reflection(&mut self, estimate: Rgb, chance: f32, cost: u64) {
        let gray = f64::from(mean(estimate));
        self.reflections += 1.0;
        self.chance += f64::from(chance);
        self.reflected[0] += gray;
        self.reflected[1] += gray * gray;
        self.reflected_cost += cost as f64;
    }

    pub fn merge(&mut self, other: &Self) {
        let other = bytemuck::cast_ref::<Self, [f64; SUMS]>(other);
        bytemuck::cast_mut::<Self, [f64; SUMS]>(self).iter_mut().zip(other).for_each(|(a, b)| *a += b);
    }

    pub fn fade(&mut self, by: f64) {
        bytemuck::cast_mut::<Self, [f64; SUMS]>(self).iter_mut().for_each(|x| *x *= by);
    }

    /// What follows, `before` being what followed so far.
    pub fn onward(&self, before: Onward) -> Onward {
        if self.walks < FEW_WALKS {
            return before;
        }
        let expected = Rgb::from_array(self.estimate.map(|sum| (sum / self.walks) as f32));
        let [average, square] = self.moments.map(|sum| sum / self.walks);
        let (variance, cost) = ((square - average * average).max(0.0), self.cost / self.walks);
        let worth = (variance / cost.max(1.0)).sqrt() as f32;
        let ways = self.ways(variance, cost).unwrap_or(before.ways);
        let parted = self.parted(variance, cost).map_or(before.parted, u32::from);
        // Nothing may be what was brought so far.
        let noise = if average > 0.0 { (variance / (average * average)) as f32 } else { f32::INFINITY };
        let known = self.walks >= LEAST_WALKS && worth.is_finite() && expected.is_finite();
        if known { Onward { ways, parted, worth, expected, noise } } else { Onward { noise, ..before } }
    }

    /// The number of ways for which variance times cost is least; `None`: there were none to go by.
    fn ways(&self, variance: f64, cost: f64) -> Option<u32> {
        if self.forked < LEAST_WALKS {
            return None;
        }
        let (way_variance, way_cost) = (self.way_variance / self.forked, self.way_cost / self.forked);
        let own = (variance - way_variance * self.inverse / self.walks).max(LEAST_OWN * variance);
        let own_cost = CAMERA_COST + (cost - way_cost * self.ways / self.walks).max(1.0);
        let best = (way_variance / way_cost.max(1.0) * own_cost / own).sqrt();
        best.is_finite().then(|| best.round().clamp(1.0, MOST_WAYS) as u32)
    }

    /// Whether variance times cost is less where a reflection is followed beside the walk than where one of the two is drawn, from
    /// strata, which leave no variance of the choice itself; `None`: too few were followed.
    fn parted(&self, variance: f64, cost: f64) -> Option<bool> {
        if self.reflections < LEAST_WALKS {
            return None;
        }
        let [average, square] = self.reflected.map(|sum| sum / self.reflections);
        let (reflected, reflected_cost) = (square - average * average, self.reflected_cost / self.reflections);
        let chance = self.chance / self.reflections;
        let drawn = reflected / chance + variance / (1.0 - chance);
        let drawn_cost = CAMERA_COST + chance * reflected_cost + (1.0 - chance) * cost;
        Some((reflected + variance) * (CAMERA_COST + reflected_cost + cost) < drawn * drawn_cost)
    }
}

impl Onward {
    /// Probability with which a walk that would start here with `throughput` is walked, in a path whose first walk started
    /// `from` there with `first`; `None`: always.
    pub fn survival(&self, throughput: f32, from: &Self, first: f32) -> Option<f32> {
        let known = self.worth > 0.0 && from.worth > 0.0 && first > 0.0;
        let survival = (throughput / first) * (self.worth / from.worth).max(1.0 / MOST_LIFTED);
        (known && survival < 1.0).then(|| survival.max(LEAST_SURVIVAL))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walks of the variance `own`, whose paths go on in 2 ways of the variance `way` and a cost of `way_cost` each.
    fn effort(own: f64, way: f64, way_cost: u64) -> Effort {
        let mut effort = Effort::default();
        for i in 0..1000 {
            // Two values have the variance of the square of their distance from the mean.
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let gray = Rgb::splat((4.0 + sign * (own + way / 2.0).sqrt()) as f32);
            let taken = Taken { cost: 100 + 2 * way_cost, ways: 2, way_variance: way, ways_cost: 2 * way_cost };
            effort.add(gray, gray, &taken);
        }
        effort
    }

    #[test]
    fn ways_follow_variance_and_cost() {
        let ways = |own, way, cost| effort(own, way, cost).onward(Onward::UNKNOWN).ways;
        // n^2 = (way / cost) / (own / (100 + that of the camera)).
        assert_eq!(ways(1.0, 1.0, 124), 1);
        assert_eq!(ways(1.0, 9.0, 124), 3);
        assert_eq!(ways(1.0, 4.0, 124), 2);
        assert_eq!(ways(1.0, 4.0, 31), 4);
        assert_eq!(ways(1.0, 100.0, 1), MOST_WAYS as u32);
        assert_eq!(ways(1.0, 0.0, 10), 1);
        assert_eq!(Effort::default().onward(Onward::UNKNOWN), Onward::UNKNOWN);
        // Half of the walks in 4 ways: the ways' cost is no part of the walks' own, whoever takes them.
        let mut mixed = effort(1.0, 4.0, 124);
        for i in 0..1000 {
            let gray = Rgb::splat(if i % 2 == 0 { 4.0 + 2.0_f32.sqrt() } else { 4.0 - 2.0_f32.sqrt() });
            mixed.add(gray, gray, &Taken { cost: 100 + 4 * 124, ways: 4, way_variance: 4.0, ways_cost: 4 * 124 });
        }
        assert_eq!(mixed.onward(Onward::UNKNOWN).ways, 2);
    }

    #[test]
    fn reflections_are_followed_where_they_are_noisy_and_cheap() {
        let parted = |deviation: f32, chance, cost| {
            let mut effort = effort(1.0, 0.0, 100);
            for i in 0..1000 {
                effort.add_reflection(Rgb::splat(if i % 2 == 0 { 0.0 } else { 2.0 * deviation }), chance, cost);
            }
            effort.onward(Onward::UNKNOWN).parted == 1
        };
        // Walks have a variance of 1 and a cost of 324 with what is before them; 1 of 25 would be reflected.
        assert!(parted(0.5, 0.04, 20));
        assert!(!parted(0.05, 0.04, 300));
        assert!(!parted(0.0, 0.04, 20));
        // Where half is reflected, following both costs a few of two rays, and each is drawn in vain as often.
        assert!(parted(0.0, 0.5, 20));
        let unknown = Onward { parted: 0, ..Onward::UNKNOWN };
        assert_eq!(effort(1.0, 0.0, 100).onward(unknown).parted, 0);
    }

    #[test]
    fn what_is_known_of_a_walk() {
        let onward = effort(1.0, 2.0, 50).onward(Onward::UNKNOWN);
        assert!((onward.expected - Rgb::splat(4.0)).abs().max_element() < 1e-4);
        assert!((onward.worth - (2.0_f32 / 200.0).sqrt()).abs() < 1e-4);
        // The same walk, for a quarter of the light: as often.
        assert_eq!(onward.survival(0.5, &onward, 2.0), Some(0.25));
        // However little is known of it, what survives is no firefly.
        let dim = Onward { worth: 1e-3 * onward.worth, ..onward };
        assert_eq!(dim.survival(1.0, &onward, 2.0), Some(0.5 / MOST_LIFTED));
        assert_eq!(onward.survival(2.0, &onward, 2.0), None);
        assert_eq!(onward.survival(1e-6, &onward, 2.0), Some(LEAST_SURVIVAL));
        assert_eq!(Onward::UNKNOWN.survival(0.5, &onward, 2.0), None);
        let mut twice = effort(1.0, 2.0, 50);
        twice.merge(&effort(1.0, 2.0, 50));
        twice.fade(0.5);
        assert_eq!(twice.walks, 1000.0);
    }
}
