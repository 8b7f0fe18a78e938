//! Which light to sample: proportional to an estimate of what each would give without shadows.
//!
//! Two passes over the lights, sum and choice, so that nothing is stored and the order of the random number
//! (its stratification) is kept. Sampling and pdf share the weights and the order of their sum.

use super::Lights;
use crate::math::PI;
use glam::Vec3;

/// How a receiver's lights are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Choice<'a> {
    /// One, by its unshadowed contribution.
    One,
    /// Each, as many times.
    All(u32),
    /// One, by its unshadowed contribution times a factor per light: the share that is visible.
    Weighted(&'a [f32]),
}

impl Choice<'_> {
    fn factor(&self, light: usize) -> f32 {
        match self {
            Choice::One | Choice::All(_) => 1.0,
            Choice::Weighted(factors) => factors[light],
        }
    }
}

impl Lights {
    /// A light and the probability it was chosen with; `None` where no light can reach p.
    pub(super) fn choose(&self, p: Vec3, n: Option<Vec3>, choice: Choice, u: f32) -> Option<(u32, f32)> {
        let sum: f64 = self.weights(p, n, choice).map(|(_, weight)| weight).sum();
        let mut left = f64::from(u) * sum;
        // Rounding may leave a remainder beyond the last weight: it is the last light's.
        let mut chosen = None;
        for (light, weight) in self.weights(p, n, choice) {
            chosen = Some((light, (weight / sum) as f32));
            left -= weight;
            if left < 0.0 {
                break;
            }
        }
        chosen
    }

    /// Probability with which `light` is sampled at p, or how many times.
    pub fn choice_probability(&self, light: u32, p: Vec3, n: Option<Vec3>, choice: Choice) -> f32 {
        if let Choice::All(count) = choice {
            return count as f32;
        }
        let (mut sum, mut own) = (0.0, 0.0);
        for (i, weight) in self.weights(p, n, choice) {
            sum += weight;
            if i == light {
                own = weight;
            }
        }
        if own > 0.0 { (own / sum) as f32 } else { 0.0 }
    }

    /// The lights of positive weight, in a fixed order.
    fn weights(&self, p: Vec3, n: Option<Vec3>, choice: Choice) -> impl Iterator<Item = (u32, f64)> {
        self.lights.iter().enumerate().filter_map(move |(i, light)| {
            // An overflowing estimate still takes part, as the largest number.
            let weight = f64::from(light.importance(p, n).min(f32::MAX)) * f64::from(choice.factor(i));
            (weight > 0.0).then_some((i as u32, weight))
        })
    }
}

/// Half angle under which a light is seen, as sine and cosine.
#[derive(Debug, Clone, Copy)]
pub struct Spread {
    sin: f32,
    cos: f32,
}

impl Spread {
    /// Of a ball at squared distance `d2`; every direction from within it.
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
}

/// Largest max(0, n . w) over directions w within `spread` of `wi`.
pub fn facing(n: Vec3, wi: Vec3, spread: &Spread) -> f32 {
    let cos = n.dot(wi);
    if cos >= spread.cos {
        return 1.0;
    }
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    // cos(theta - spread)
    (cos * spread.cos + sin * spread.sin).max(0.0)
}
