//! Random numbers as a function of (seed, pixel, sample, dimension): Owen-scrambled Sobol for the
//! first dimensions of a path, where stratification pays, a counter-based hash for the rest.

use glam::Vec2;

/// Dimensions below this one are Sobol; a walk's thousands are not.
const SOBOL_DIMENSIONS: u32 = 64;

/// Samples of one sobol_burley sequence (its documented maximum is 2^16); further ones are reseeded.
const SEQUENCE: u32 = 1 << 16;

/// The stream of one path.
#[derive(Debug, Clone)]
pub struct Sampler {
    seed: u32,
    index: u32,
    dimension: u32,
    /// Counter of the hashed stream.
    state: u64,
}

impl Sampler {
    pub fn new(seed: u32, pixel: u32, sample: u32) -> Self {
        let pixel_seed = hash(u64::from(pixel) << 32 | u64::from(seed)) as u32;
        let block = sample / SEQUENCE;
        Self {
            seed: pixel_seed.wrapping_add(block.wrapping_mul(0x9e37_79b9)),
            index: sample % SEQUENCE,
            dimension: 0,
            state: hash(u64::from(pixel_seed) << 32 | u64::from(sample)),
        }
    }

    /// A number in [0, 1).
    pub fn next_1d(&mut self) -> f32 {
        if self.dimension < SOBOL_DIMENSIONS {
            let u = sobol_burley::sample(self.index, self.dimension, self.seed);
            self.dimension += 1;
            return u;
        }
        self.random()
    }

    pub fn next_2d(&mut self) -> Vec2 {
        Vec2::new(self.next_1d(), self.next_1d())
    }

    /// In place of [`Self::next_2d`] where nothing uses it: what follows gets the same numbers.
    pub fn skip_2d(&mut self) -> Vec2 {
        for _ in 0..2 {
            if self.dimension < SOBOL_DIMENSIONS {
                self.dimension += 1;
            } else {
                self.bits();
            }
        }
        Vec2::ZERO
    }

    /// A number in [0, 1) from the hashed stream: SplitMix64 (Steele et al. 2014), top 24 bits.
    pub fn random(&mut self) -> f32 {
        (self.bits() >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
    }

    /// A number in (0, 1] with 32 bits, for logarithms: -ln reaches 22.2 instead of 16.6 mean free paths.
    pub fn random_open(&mut self) -> f32 {
        ((self.bits() >> 32) + 1) as f32 * (1.0 / (1u64 << 32) as f32)
    }

    fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn hash(x: u64) -> u64 {
    mix(x.wrapping_add(0x9e37_79b9_7f4a_7c15))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a lens is there or not, all that follows gets the same numbers, Sobol or hashed.
    #[test]
    fn skipping_moves_no_other_number() {
        for drawn in [0, SOBOL_DIMENSIONS - 2, SOBOL_DIMENSIONS - 1, SOBOL_DIMENSIONS] {
            let mut used = Sampler::new(3, 7, 5);
            (0..drawn).for_each(|_| _ = used.next_1d());
            let mut unused = used.clone();
            used.next_2d();
            unused.skip_2d();
            assert_eq!((used.next_1d(), used.random()), (unused.next_1d(), unused.random()), "after {drawn}");
        }
    }
}
