//! Some triangles of a mesh, drawn by their areas: cumulative sums of blocks of them, whose areas are computed again.
//!
//! That is half a byte a triangle, where a sum for each would take eight.

use rayon::prelude::*;

const BLOCK: usize = 16;

pub(super) struct Areas {
    /// `None`: all there are.
    triangles: Option<Vec<u32>>,
    count: usize,
    /// Up to each block, from 0 on, and in all.
    sums: Vec<f64>,
}

impl Areas {
    /// Of those of `count` triangles that are `wanted`; `None` where they have no area.
    pub fn new(count: u32, wanted: impl Fn(u32) -> bool, area: impl Fn(u32) -> f64 + Sync) -> Option<Self> {
        let some = !(0..count).all(&wanted);
        let triangles = some.then(|| Vec::from_iter((0..count).filter(|&triangle| wanted(triangle))));
        let count = triangles.as_ref().map_or(count as usize, Vec::len);
        let mut areas = Self { triangles, count, sums: vec![0.0] };
        let of_block = |block: usize| areas.block(block).map(&area).sum::<f64>();
        let blocks: Vec<f64> = (0..count.div_ceil(BLOCK)).into_par_iter().with_min_len(64).map(of_block).collect();
        let mut sum = 0.0;
        areas.sums.extend(blocks.into_iter().map(|block| {
            sum += block;
            sum
        }));
        (sum > 0.0 && sum.is_finite()).then_some(areas)
    }

    /// Of all of them.
    pub fn sum(&self) -> f64 {
        *self.sums.last().expect("begins with 0")
    }

    /// The triangle at `u` in [0, 1), of positive area.
    pub fn sample(&self, u: f64, area: impl Fn(u32) -> f64) -> u32 {
        let target = u * self.sum();
        let block = self.sums.partition_point(|&sum| sum <= target).clamp(1, self.sums.len() - 1) - 1;
        let mut left = target - self.sums[block];
        // Rounding may leave a remainder beyond the last one: it is the last positive one's.
        let mut last = self.triangle(block * BLOCK);
        for triangle in self.block(block) {
            let area = area(triangle);
            if area > 0.0 {
                last = triangle;
            }
            if left < area {
                break;
            }
            left -= area;
        }
        last
    }

    fn block(&self, block: usize) -> impl Iterator<Item = u32> {
        (block * BLOCK..((block + 1) * BLOCK).min(self.count)).map(|i| self.triangle(i))
    }

    fn triangle(&self, i: usize) -> u32 {
        self.triangles.as_ref().map_or(i as u32, |triangles| triangles[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each share of [0, 1) is as long as the area it leads to.
    #[test]
    fn triangles_are_drawn_by_area() {
        let area = |triangle: u32| if triangle % 7 == 2 { 0.0 } else { f64::from(triangle % 5 + 1) };
        for odd_only in [false, true] {
            let wanted = |triangle: u32| !odd_only || triangle % 2 == 1;
            let areas = Areas::new(101, wanted, area).expect("has area");
            let total: f64 = (0..101).filter(|&triangle| wanted(triangle)).map(area).sum();
            assert_eq!(areas.sum(), total);
            let mut counts = [0_u32; 101];
            let draws = total as u32 * 8;
            (0..draws).for_each(|i| {
                counts[areas.sample((f64::from(i) + 0.5) / f64::from(draws), area) as usize] += 1;
            });
            for triangle in 0..101 {
                let expected = if wanted(triangle) { 8.0 * area(triangle) } else { 0.0 };
                assert_eq!(f64::from(counts[triangle as usize]), expected, "{triangle} of {odd_only}");
            }
            assert!(area(areas.sample(1.0, area)) > 0.0);
        }
        assert!(Areas::new(3, |_| true, |_| 0.0).is_none());
    }
}
