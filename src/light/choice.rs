//! Which light to sample: proportional to an estimate of what each would give without shadows.
//!
//! Few lights are weighed one by one, in two passes, sum and choice, so that nothing is stored and the order of the random
//! number (its stratification) is kept. Of many, the area lights are in a [`super::tree::Tree`], beside which domes and
//! distant lights are weighed one by one. Sampling and pdf share the weights and the order of their sum.

use super::{
    LightSample, Lights, LightsAt,
    tree::{Descents, Receiver, Tree},
};
use crate::math::PI;
use glam::{Vec2, Vec3};

/// How a receiver's lights are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Choice<'a> {
    /// Each, as many times.
    All(u32),
    /// As many, each by its unshadowed contribution times the visible share of its parts ([`Parts`]); none: all of it.
    Drawn { count: u32, shares: &'a [f32] },
}

impl<'a> Choice<'a> {
    pub const ONE: Choice<'static> = Choice::Drawn { count: 1, shares: &[] };

    /// Samples, of each light or in all.
    pub fn count(&self) -> u32 {
        match *self {
            Choice::All(count) | Choice::Drawn { count, .. } => count,
        }
    }

    fn shares(self) -> &'a [f32] {
        match self {
            Choice::All(_) => &[],
            Choice::Drawn { shares, .. } => shares,
        }
    }
}

/// What visible shares are learned of: each light where they are few; of many, those that are in no tree, and the tree's first
/// nodes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parts {
    /// The part that each lies in, which comes before it.
    pub parents: Vec<Option<u32>>,
    /// The smallest part of each light.
    pub of_light: Vec<u32>,
}

impl Parts {
    pub fn len(&self) -> usize {
        self.parents.len()
    }

    pub fn is_empty(&self) -> bool {
        self.parents.is_empty()
    }

    /// Each of `lights` by itself.
    pub fn single(lights: usize) -> Self {
        Self { parents: vec![None; lights], of_light: (0..lights as u32).collect() }
    }

    /// All parts that hold `light`, from the smallest on.
    pub fn holding(&self, light: u32) -> impl Iterator<Item = usize> {
        let smallest = self.of_light[light as usize];
        std::iter::successors(Some(smallest), |&part| self.parents[part as usize]).map(|part| part as usize)
    }
}

impl Lights {
    pub fn parts(&self) -> Parts {
        let Some(tree) = &self.tree else { return Parts::single(self.len()) };
        let mut parts = Parts { parents: vec![None; self.beside.len()], of_light: vec![0; self.len()] };
        for (part, &light) in self.beside.iter().enumerate() {
            parts.of_light[light as usize] = part as u32;
        }
        tree.add_parts(&mut parts);
        parts
    }
}

impl<'a> LightsAt<'a> {
    /// Lights drawn for the receiver at `p`, one by one.
    pub fn draws(self, p: Vec3, n: Option<Vec3>, choice: Choice<'a>) -> Draws<'a, impl Fn(u32) -> f64> {
        let tree = self.all.tree.as_ref().map(move |tree| tree.descents(self.receiver(p, n, choice.shares())));
        Draws { lights: self, p, n, choice, tree }
    }

    /// Expected number of samples of `light` at p.
    pub fn choice_probability(&self, light: u32, p: Vec3, n: Option<Vec3>, choice: Choice) -> f32 {
        let Choice::Drawn { count, shares } = choice else { return choice.count() as f32 };
        let (beside, at) = (self.weigh(p, n, shares), self.receiver(p, n, shares));
        let in_tree = |tree: &Tree| if self.beside.is_empty() { ALONE } else { tree.irradiance(&at) };
        let probability = match &self.tree {
            None => share(beside, 0.0, Some(light)),
            Some(tree) if tree.contains(light) => share(beside, in_tree(tree), None) * tree.probability(light, &at),
            Some(tree) => share(beside, in_tree(tree), Some(light)),
        };
        (f64::from(count) * probability) as f32
    }

    fn receiver<'b>(
        self,
        p: Vec3,
        n: Option<Vec3>,
        shares: &'b [f32],
    ) -> Receiver<'b, impl Fn(u32) -> f64 + use<'a, 'b>>
    where
        'a: 'b,
    {
        let shares = shares.get(self.beside.len()..).unwrap_or(&[]);
        let lanes = self.allowed().map(|linked| &linked.lanes[..]);
        Receiver { p, n, shares, lanes, weight: move |light| self.weight(light, p, n) }
    }

    fn weight(&self, light: u32, p: Vec3, n: Option<Vec3>) -> f64 {
        if self.allowed().is_some_and(|linked| !linked.has(light)) {
            return 0.0;
        }
        // An overflowing estimate still takes part, as the largest number.
        let (light, _, p, n) = self.seen(light, p, n);
        f64::from(light.importance(p, n).min(f32::MAX))
    }

    /// Those of the lights beside the tree that have weight, in order. `shares`: visible, by place; without them 1.
    fn weigh(&self, p: Vec3, n: Option<Vec3>, shares: &[f32]) -> impl Iterator<Item = (u32, f64)> + Clone {
        self.beside.iter().enumerate().filter_map(move |(place, &light)| {
            let weight = self.weight(light, p, n) * f64::from(shares.get(place).copied().unwrap_or(1.0));
            (weight > 0.0).then_some((light, weight))
        })
    }
}

/// What the tree weighs where there is nothing beside it: anything.
const ALONE: f64 = 1.0;

/// Draws of lights for one receiver.
pub struct Draws<'a, F> {
    lights: LightsAt<'a>,
    p: Vec3,
    n: Option<Vec3>,
    choice: Choice<'a>,
    tree: Option<Descents<'a, F>>,
}

impl<F: Fn(u32) -> f64> Draws<'_, F> {
    /// A light by its estimated contribution, and a direction to it; `None`: this sample contributes nothing.
    ///
    /// The pdf counts as many samples as the choice draws. That is not `All`: of all lights each is asked by
    /// [`LightsAt::sample_light`].
    pub fn sample(&mut self, u_choice: f32, u: Vec2) -> Option<LightSample> {
        let (sample, times) = self.draw(u_choice, u)?;
        let pdf = sample.pdf * times;
        (pdf > 0.0 && pdf.is_finite()).then_some(LightSample { pdf, ..sample })
    }

    /// A light as if it were the only one, and how many of it are expected.
    pub fn draw(&mut self, u_choice: f32, u: Vec2) -> Option<(LightSample, f32)> {
        let (light, chosen) = self.choose(u_choice)?;
        Some((self.lights.sample_light(light, self.p, self.n, u)?, chosen * self.choice.count() as f32))
    }

    /// A light and the probability it was chosen with; `None` where no light can reach p, or none of the cluster that was
    /// chosen.
    pub fn choose(&mut self, u: f32) -> Option<(u32, f32)> {
        let lights = self.lights;
        let beside = lights.weigh(self.p, self.n, self.choice.shares());
        let in_tree = self
            .tree
            .as_mut()
            .map_or(0.0, |tree| if self.lights.beside.is_empty() { ALONE } else { tree.irradiance() });
        let (light, probability, u) = pick(beside, in_tree, f64::from(u))?;
        if let Some(light) = light {
            return Some((light, probability as f32));
        }
        let (light, within) = self.tree.as_mut()?.descend(u)?;
        Some((light, (probability * within) as f32))
    }
}

/// One of `weights`, or `None` for the `rest`, with its probability and `u` remapped; nothing where nothing has weight.
fn pick(weights: impl Iterator<Item = (u32, f64)> + Clone, rest: f64, u: f64) -> Option<(Option<u32>, f64, f64)> {
    let sum: f64 = weights.clone().map(|(_, weight)| weight).sum::<f64>() + rest;
    let mut left = u * sum;
    // Rounding may leave a remainder beyond the last weight: it is the last light's.
    let mut last = None;
    for (light, weight) in weights {
        last = Some((Some(light), weight / sum, 1.0));
        if left < weight {
            return Some((Some(light), weight / sum, left / weight));
        }
        left -= weight;
    }
    if rest > 0.0 { Some((None, rest / sum, (left / rest).min(1.0))) } else { last }
}

/// Probability with which [`pick`] gives `light`, or the rest.
fn share(weights: impl Iterator<Item = (u32, f64)>, rest: f64, light: Option<u32>) -> f64 {
    let (mut sum, mut own) = (0.0, if light.is_none() { rest } else { 0.0 });
    for (i, weight) in weights {
        sum += weight;
        if Some(i) == light {
            own = weight;
        }
    }
    if own > 0.0 { own / (sum + rest) } else { 0.0 }
}

/// Half angle under which a light is seen, as sine and cosine.
#[derive(Debug, Clone, Copy)]
pub struct Spread {
    pub sin: f32,
    pub cos: f32,
}

impl Spread {
    /// Of a ball at squared distance `d2`; every direction from within it.
    #[inline]
    pub fn of_ball(radius: f32, d2: f32) -> Self {
        let sin2 = radius * radius / d2;
        if sin2 < 1.0 { Self { sin: sin2.sqrt(), cos: (1.0 - sin2).sqrt() } } else { Self { sin: 0.0, cos: -1.0 } }
    }

    pub fn of_angle(angle: f32) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    pub fn angle(&self) -> f32 {
        if self.cos <= -1.0 { PI } else { self.sin.atan2(self.cos) }
    }

    /// Whether it is every direction.
    pub fn is_all(&self) -> bool {
        self.cos <= -1.0
    }
}

/// What f32 cosines may be off by: a light on the horizon is not to be missed.
pub const ROUNDING: f32 = 1e-6;

/// Largest max(0, n . w) over directions w within `spread` of `wi`, from above.
#[inline]
pub fn facing(n: Vec3, wi: Vec3, spread: &Spread) -> f32 {
    let cos = n.dot(wi);
    if cos >= spread.cos {
        return 1.0;
    }
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    // cos(theta - spread)
    (cos * spread.cos + sin * spread.sin + ROUNDING).max(0.0)
}
