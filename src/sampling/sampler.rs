//! Random numbers as a function of (seed, pixel, sample, dimension): Owen-scrambled Sobol for the
//! first dimensions of a path, where stratification pays, a counter-based hash for the rest.

use glam::Vec2;
use sobol_burley::parts;
use std::sync::LazyLock;

/// Dimensions below this one are Sobol; a walk's thousands are not.
const SOBOL_DIMENSIONS: u32 = 64;

/// The dimension of the path's time: whoever asks for it moves no other number.
const TIME: u32 = SOBOL_DIMENSIONS;

/// Steps of a path's first walk that have Sobol points: the light that a walk finds after more depends on too many numbers
/// for strata to matter.
const STEPS: u32 = 4;

/// Numbers of a step, at most.
const STEP_DIMENSIONS: u32 = 4;

/// Samples of one sobol_burley sequence (its documented maximum is 2^16); further ones are reseeded.
const SEQUENCE: u32 = 1 << 16;

/// By dimension and hexadecimal digit of the reversed index: what the digit gives of the Sobol point, whose digits are joined by
/// xor. 16 KB.
type Digits = [[[u32; 16]; 4]; TIME as usize + 1];

static DIGITS: LazyLock<Box<Digits>> = LazyLock::new(|| {
    let mut digits = Box::new([[[0; 16]; 4]; TIME as usize + 1]);
    for (dimension, places) in digits.iter_mut().enumerate() {
        for (place, values) in places.iter_mut().enumerate() {
            for (value, point) in values.iter_mut().enumerate() {
                *point = parts::sobol_rev((value as u32) << (28 - 4 * place), dimension as u32);
            }
        }
    }
    digits
});

/// The stream of one path.
#[derive(Debug, Clone)]
pub struct Sampler {
    digits: &'static Digits,
    seed: u32,
    /// Of the sample in its sequence, shuffled by the seed, bits reversed.
    shuffled: u32,
    dimension: u32,
    /// Steps of walks that have begun, [`STEPS`] at most.
    steps: u32,
    step: Step,
    /// Counter of the hashed stream.
    state: u64,
}

/// Where the numbers of the step under way come from.
#[derive(Debug, Clone)]
struct Step {
    /// Index of its points.
    shuffled: u32,
    /// What its first number is scrambled as.
    scrambled_as: u32,
    /// Numbers drawn; [`STEP_DIMENSIONS`]: what follows is hashed.
    drawn: u32,
}

impl Step {
    const HASHED: Self = Self { shuffled: 0, scrambled_as: 0, drawn: STEP_DIMENSIONS };
}

impl Sampler {
    pub fn new(seed: u32, pixel: u32, sample: u32) -> Self {
        let pixel_seed = hash(u64::from(pixel) << 32 | u64::from(seed)) as u32;
        let block = sample / SEQUENCE;
        let seed = pixel_seed.wrapping_add(block.wrapping_mul(0x9e37_79b9));
        let shuffle = parts::hash(seed ^ 0x79c6_8e4a);
        Self {
            digits: &DIGITS,
            seed,
            shuffled: parts::owen_scramble_rev((sample % SEQUENCE).reverse_bits(), shuffle),
            dimension: 0,
            steps: 0,
            step: Step::HASHED,
            state: hash(u64::from(pixel_seed) << 32 | u64::from(sample)),
        }
    }

    /// The stream of a path that parts from this one here: strata and hashed numbers of its own, of the same sample.
    pub fn parted(&self) -> Self {
        Self { seed: parts::hash(self.seed), state: hash(self.state), ..self.clone() }
    }

    /// A number in [0, 1).
    pub fn next_1d(&mut self) -> f32 {
        if self.dimension < SOBOL_DIMENSIONS {
            let u = self.sobol(self.dimension);
            self.dimension += 1;
            return u;
        }
        self.random()
    }

    /// `sobol_burley::sample` to the bit, whose shuffling of the index is made once and whose point comes from a table.
    fn sobol(&self, dimension: u32) -> f32 {
        parts::u32_to_f32_norm(self.sobol_bits(self.shuffled, dimension, dimension))
    }

    /// The point of index `shuffled` in `dimension`, scrambled as `scrambled_as`.
    #[inline]
    fn sobol_bits(&self, shuffled: u32, dimension: u32, scrambled_as: u32) -> u32 {
        let places = &self.digits[dimension as usize];
        let digit = |place: usize| places[place][(shuffled >> (28 - 4 * place)) as usize & 15];
        let point = digit(0) ^ digit(1) ^ digit(2) ^ digit(3);
        let lane = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8][scrambled_as as usize & 3];
        let scramble = (scrambled_as >> 2) ^ self.seed.wrapping_mul(0x9c8f_2d3b) ^ lane;
        parts::owen_scramble_rev(point, parts::hash(scramble)).reverse_bits()
    }

    pub fn next_2d(&mut self) -> Vec2 {
        Vec2::new(self.next_1d(), self.next_1d())
    }

    /// In place of [`Self::next_1d`] where nothing uses it: what follows gets the same numbers.
    pub fn skip_1d(&mut self) {
        if self.dimension < SOBOL_DIMENSIONS {
            self.dimension += 1;
        } else {
            self.state = self.state.wrapping_add(STEP);
        }
    }

    /// In place of [`Self::next_2d`].
    pub fn skip_2d(&mut self) -> Vec2 {
        self.skip_1d();
        self.skip_1d();
        Vec2::ZERO
    }

    /// The path's time in [0, 1).
    pub fn time(&self) -> f32 {
        self.sobol(TIME)
    }

    /// A step of a walk begins. Each of the first ones has a set of points of its own, the first four dimensions, which fill
    /// small boxes best, shuffled against the others (Burley 2020, "Practical Hash-based Owen Scrambling", section 3).
    pub fn begin_step(&mut self) {
        self.step = if self.steps < STEPS {
            Step {
                shuffled: parts::owen_scramble_rev(self.shuffled, parts::hash(self.seed ^ self.steps)),
                scrambled_as: TIME + STEP_DIMENSIONS * (1 + self.steps),
                drawn: 0,
            }
        } else {
            Step::HASHED
        };
        self.steps = STEPS.min(self.steps + 1);
    }

    /// The walk is over; how the next one's steps are drawn must not depend on how long it was.
    pub fn end_walk(&mut self) {
        (self.steps, self.step) = (STEPS, Step::HASHED);
    }

    /// A number in [0, 1) of the step under way.
    pub fn step_1d(&mut self) -> f32 {
        if let Some(bits) = self.step_bits() { parts::u32_to_f32_norm(bits) } else { self.random() }
    }

    pub fn step_2d(&mut self) -> Vec2 {
        Vec2::new(self.step_1d(), self.step_1d())
    }

    /// A number in (0, 1] with 32 bits of the step under way, as [`Self::random_open`].
    pub fn step_open(&mut self) -> f32 {
        if let Some(bits) = self.step_bits() { open(bits) } else { self.random_open() }
    }

    #[inline(always)] // most steps are hashed, in a few instructions
    fn step_bits(&mut self) -> Option<u32> {
        if self.step.drawn < STEP_DIMENSIONS { Some(self.step_sobol()) } else { None }
    }

    #[inline(never)]
    fn step_sobol(&mut self) -> u32 {
        let Step { shuffled, scrambled_as, drawn } = self.step;
        self.step.drawn += 1;
        self.sobol_bits(shuffled, drawn, scrambled_as + drawn)
    }

    /// A number in [0, 1) from the hashed stream: SplitMix64 (Steele et al. 2014), top 24 bits.
    pub fn random(&mut self) -> f32 {
        (self.bits() >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
    }

    /// A number in (0, 1] with 32 bits, for logarithms: -ln reaches 22.2 instead of 16.6 mean free paths.
    pub fn random_open(&mut self) -> f32 {
        open((self.bits() >> 32) as u32)
    }

    fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(STEP);
        mix(self.state)
    }
}

/// (bits + 1) / 2^32.
fn open(bits: u32) -> f32 {
    (u64::from(bits) + 1) as f32 * (1.0 / (1u64 << 32) as f32)
}

/// Of the hashed stream's counter: 2^64 over the golden ratio.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn hash(x: u64) -> u64 {
    mix(x.wrapping_add(STEP))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_give_the_points_of_sobol_burley() {
        for (seed, pixel, sample) in [(0, 0, 0), (1, 2, 3), (7, 123_456, 65_535), (0xffff_ffff, 9, 40_961)] {
            let mut sampler = Sampler::new(seed, pixel, sample);
            for dimension in 0..SOBOL_DIMENSIONS {
                let expected = sobol_burley::sample(sample, dimension, sampler.seed);
                assert_eq!(sampler.next_1d(), expected, "dimension {dimension} of sample {sample}");
            }
            assert_eq!(sampler.time(), sobol_burley::sample(sample, TIME, sampler.seed));
        }
    }

    /// Steps of later walks, and late ones, are hashed; the numbers of the path do not depend on the walk's length.
    #[test]
    fn steps_of_walks() {
        let fresh = Sampler::new(3, 7, 5);
        let (mut short, mut long) = (fresh.clone(), fresh.clone());
        short.begin_step();
        for _ in 0..STEPS {
            long.begin_step();
            (0..STEP_DIMENSIONS).for_each(|_| _ = long.step_1d());
        }
        for walked in [&mut short, &mut long] {
            walked.end_walk();
            walked.begin_step();
            assert_eq!(walked.step_1d(), fresh.clone().random());
        }
        assert_eq!((short.next_1d(), long.next_1d()), (fresh.clone().next_1d(), fresh.clone().next_1d()));
    }

    /// 256 samples: one in each of 16 x 16 boxes of the first two numbers of a step; steps know nothing of each other.
    #[test]
    fn a_step_is_stratified() {
        let points: Vec<[f32; 3]> = (0..256)
            .map(|sample| {
                let mut sampler = Sampler::new(1, 2, sample);
                sampler.begin_step();
                sampler.begin_step();
                let (first, second) = (sampler.step_open(), sampler.step_1d());
                sampler.begin_step();
                [first, second, sampler.step_open()]
            })
            .collect();
        let filled = |a: usize, b: usize| {
            let side = |u: f32| (u * 16.0).clamp(0.0, 15.0) as usize;
            let mut boxes = [false; 256];
            points.iter().for_each(|p| boxes[16 * side(p[a]) + side(p[b])] = true);
            boxes.iter().filter(|filled| **filled).count()
        };
        assert_eq!(filled(0, 1), 256);
        // Independent points fill 1 - 1/e of the boxes, 162 +- 5.
        assert!((140..185).contains(&filled(0, 2)), "{}", filled(0, 2));
    }

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
