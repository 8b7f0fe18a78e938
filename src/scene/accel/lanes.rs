//! Eight floats at once. The algorithms are written once over [`Lanes`]; both implementations round every
//! operation alike and never fuse two, so they agree bit for bit.
//!
//! Code over `Lanes` has no closures: only what is `#[inline(always)]` surely ends up in the function that may use
//! the wide instructions, and one call across that border costs more than the width gains (measured: 3x).

/// Eight f32. `min` and `max` return the second operand where either is NaN, as the x86 instructions do.
pub(super) trait Lanes: Copy {
    fn splat(x: f32) -> Self;
    fn load(x: &[f32; 8]) -> Self;
    fn store(self) -> [f32; 8];
    fn sub(self, o: Self) -> Self;
    fn mul(self, o: Self) -> Self;
    fn min(self, o: Self) -> Self;
    fn max(self, o: Self) -> Self;
    /// Bit i: lane i of `self` <= lane i of `o`; false with NaN.
    fn le(self, o: Self) -> u32;
}

/// Instruction sets we have code for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Isa {
    Portable,
    /// With the bit manipulations that came with it: the lanes of a mask are told apart by them.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// The same eight lanes in twice as many registers, with fewer moves between them.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// The widest last.
    #[cfg(target_arch = "x86_64")]
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];
    #[cfg(not(target_arch = "x86_64"))]
    pub const ALL: [Self; 1] = [Self::Portable];

    /// The widest that the processor has.
    pub fn detect() -> Self {
        Self::ALL.into_iter().rfind(Self::is_here).expect("the portable one")
    }

    pub fn is_here(&self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => has_bmi() && is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                let sizes = is_x86_feature_detected!("avx512vl") && is_x86_feature_detected!("avx512bw");
                has_bmi() && sizes && is_x86_feature_detected!("avx512dq")
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn has_bmi() -> bool {
    is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2")
}

/// Plain arrays; the compiler makes what it can of them.
#[derive(Clone, Copy)]
pub(super) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(self, o: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], o.0[i])))
    }
}

impl Lanes for Portable {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 8])
    }
    #[inline(always)]
    fn load(x: &[f32; 8]) -> Self {
        Self(*x)
    }
    #[inline(always)]
    fn store(self) -> [f32; 8] {
        self.0
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.zip(o, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.zip(o, |a, b| a * b)
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        self.zip(o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        self.zip(o, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn le(self, o: Self) -> u32 {
        (0..8).fold(0, |mask, i| mask | u32::from(self.0[i] <= o.0[i]) << i)
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::Lanes;
    use std::arch::x86_64::*;

    /// One 256-bit register. Everything here is inlined into functions with `#[target_feature]`.
    ///
    /// SAFETY of every block below: the type is private to `accel`, and `Tree::walk` (the only place that names
    /// it outside tests) does so only where [`super::Isa::detect`] found AVX2 or more. Loads and stores are unaligned
    /// ones of exactly eight floats.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256);

    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_set1_ps(x)) }
        }
        #[inline(always)]
        fn load(x: &[f32; 8]) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_loadu_ps(x.as_ptr())) }
        }
        #[inline(always)]
        fn store(self) -> [f32; 8] {
            let mut x = [0.0; 8];
            // SAFETY: see the type.
            unsafe { _mm256_storeu_ps(x.as_mut_ptr(), self.0) };
            x
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_sub_ps(self.0, o.0)) }
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_mul_ps(self.0, o.0)) }
        }
        #[inline(always)]
        fn min(self, o: Self) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_min_ps(self.0, o.0)) }
        }
        #[inline(always)]
        fn max(self, o: Self) -> Self {
            // SAFETY: see the type.
            unsafe { Self(_mm256_max_ps(self.0, o.0)) }
        }
        #[inline(always)]
        fn le(self, o: Self) -> u32 {
            // SAFETY: see the type.
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0)) as u32 }
        }
    }
}
