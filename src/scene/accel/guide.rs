//! What obvhs sees of the boxes: scaled into [-1, 1]^3 and grown by a little noise.
//!
//! Scaled and clamped, because the areas of huge or infinite boxes overflow and obvhs unwraps comparisons of them.
//! Noise, because PLOC merges pairs that prefer each other, and among equal boxes or equally spaced ones (a
//! million copies, a row of posts) ties make everyone prefer the right neighbour: one merge per pass, n passes.

use super::aabb::Aabb;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Made one by one when asked for, which takes less than to keep them.
pub(super) struct Guides<'a> {
    pub boxes: &'a [Aabb],
    centre: DVec3,
    scale: f64,
    /// To their centres.
    pub shrunk: bool,
}

impl<'a> Guides<'a> {
    pub fn new(boxes: &'a [Aabb]) -> Self {
        let (centre, scale) = frame(boxes);
        Self { boxes, centre, scale, shrunk: false }
    }

    pub fn get(&self, i: u32) -> obvhs::aabb::Aabb {
        let b = &self.boxes[i as usize];
        let map = |p: Vec3| ((p.as_dvec3() - self.centre) * self.scale).clamp(DVec3::NEG_ONE, DVec3::ONE).as_vec3();
        let (min, max) = if b.is_empty() { (Vec3::ZERO, Vec3::ZERO) } else { (map(b.min), map(b.max)) };
        // Small against the box; for points at least a few roundings of numbers near 1.
        let size = (max - min).max_element() * 2.0_f32.powi(-12) + 4.0 * f32::EPSILON;
        let [low, high] = noise(u64::from(i));
        let guide = obvhs::aabb::Aabb::new((min - low * size).into(), (max + high * size).into());
        if self.shrunk { obvhs::aabb::Aabb::from_point(guide.center()) } else { guide }
    }

    /// Where the middle of a box is along an axis, without clamp and noise; NaN of an empty one.
    pub fn middle(&self, i: u32, axis: usize) -> f32 {
        let b = &self.boxes[i as usize];
        let middle = f64::from(b.min[axis] * 0.5 + b.max[axis] * 0.5);
        ((middle - self.centre[axis]) * self.scale) as f32
    }
}

/// Centre and inverse half size of the finite part of all boxes.
fn frame(boxes: &[Aabb]) -> (DVec3, f64) {
    let finite = |b: &Aabb| Aabb::from_points([b.min, b.max].into_iter().filter(|p| p.is_finite()));
    let all = boxes.par_iter().with_min_len(1 << 14).map(finite).reduce(|| Aabb::EMPTY, |a, b| a.union(&b));
    if all.is_empty() {
        return (DVec3::ZERO, 1.0);
    }
    let (min, max) = (all.min.as_dvec3(), all.max.as_dvec3());
    let half = (max - min).max_element() * 0.5;
    ((min + max) * 0.5, if half > 0.0 { 1.0 / half } else { 1.0 })
}

/// Six numbers in [0, 1), ten bits each, from SplitMix64's finalizer (Steele et al. 2014).
fn noise(i: u64) -> [Vec3; 2] {
    let mut z = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    let u = |k: u32| ((z >> (10 * k)) & 1023) as f32 / 1024.0;
    [Vec3::new(u(0), u(1), u(2)), Vec3::new(u(3), u(4), u(5))]
}
