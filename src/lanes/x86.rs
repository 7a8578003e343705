//! AVX2 and AVX-512.
//!
//! A value of these types is only ever made inside a function compiled for its instructions, which [`super::run`] enters after having
//! asked the processor: that is what makes each `unsafe` below sound.

use super::{Kernel, LINE, Lanes, Level, Picks, SINGLES, Several, Singles, WHOLE, WithPicks, x86_whole};
use std::arch::x86_64::{
    __m256, __m256d, __m512, __m512d, __m512i, __mmask8, __mmask16, _CMP_LT_OQ, _MM_FROUND_NO_EXC,
    _MM_FROUND_TO_NEG_INF, _mm_storeu_ps, _mm256_add_epi32, _mm256_add_pd, _mm256_add_ps, _mm256_and_pd,
    _mm256_blendv_pd, _mm256_blendv_ps, _mm256_castsi256_ps, _mm256_cmp_pd, _mm256_cmp_ps, _mm256_cvtpd_ps,
    _mm256_cvtps_epi32, _mm256_div_pd, _mm256_div_ps, _mm256_floor_pd, _mm256_fmadd_pd, _mm256_fmadd_ps,
    _mm256_loadu_pd, _mm256_loadu_ps, _mm256_movemask_pd, _mm256_movemask_ps, _mm256_mul_pd, _mm256_mul_ps,
    _mm256_set1_epi32, _mm256_set1_pd, _mm256_set1_ps, _mm256_slli_epi32, _mm256_sqrt_pd, _mm256_sqrt_ps,
    _mm256_storeu_pd, _mm256_storeu_ps, _mm256_sub_pd, _mm256_sub_ps, _mm256_xor_pd, _mm256_xor_ps, _mm512_add_epi32,
    _mm512_add_pd, _mm512_add_ps, _mm512_castpd_si512, _mm512_castsi512_ps, _mm512_cmp_pd_mask, _mm512_cmp_ps_mask,
    _mm512_cvtpd_ps, _mm512_cvtps_epi32, _mm512_div_pd, _mm512_div_ps, _mm512_fmadd_pd, _mm512_fmadd_ps,
    _mm512_loadu_pd, _mm512_loadu_ps, _mm512_mask_blend_pd, _mm512_mask_blend_ps, _mm512_mul_pd, _mm512_mul_ps,
    _mm512_permutex2var_ps, _mm512_roundscale_pd, _mm512_set1_epi32, _mm512_set1_pd, _mm512_set1_ps, _mm512_slli_epi32,
    _mm512_sqrt_pd, _mm512_sqrt_ps, _mm512_storeu_pd, _mm512_storeu_ps, _mm512_storeu_si512, _mm512_sub_pd,
    _mm512_sub_ps, _mm512_xor_si512,
};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Runs a kernel four numbers at a time.
#[target_feature(enable = "avx2,fma")]
pub(super) fn in_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Four>()
}

/// Runs a kernel eight numbers at a time.
#[target_feature(enable = "avx512f")]
pub(super) fn in_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Eight>()
}

macro_rules! operator {
    ($lanes:ident, $operator:ident, $name:ident, $instruction:ident) => {
        impl $operator for $lanes {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: see the head of the file.
                Self(unsafe { $instruction(self.0, other.0) })
            }
        }
    };
}

/// Work on small whole numbers, the same however many numbers of 64 bits a register holds.
macro_rules! small_whole_numbers {
    () => {
        #[inline(always)]
        fn sums_of_bytes(bytes: &[u8], n: usize, ground: u8, alone: bool) -> [i32; 4] {
            // SAFETY: see the head of the file.
            unsafe { x86_whole::sums_of_bytes(bytes, n, ground, alone) }
        }
        #[inline(always)]
        fn bits_of(x: &[u16; 32]) -> u32 {
            // SAFETY: see the head of the file.
            unsafe { x86_whole::bits_of(x) }
        }
    };
}

/// A register of N numbers and the instructions that it is computed with. What the widths write differently is spelt out: a change of
/// sign, the choice by a mask (its numbers bare registers), and whether a mask is set everywhere.
macro_rules! register {
    (
        $(#[$words:meta])*
        $name:ident: $n:literal $number:ident in $register:ident, mask $mask:ident;
        $add:ident $sub:ident $mul:ident $div:ident $sqrt:ident $fused:ident $splat:ident $load:ident $store:ident $below:ident;
        |$x:ident| $neg:expr; |$by:ident, $a:ident, $b:ident| $select:expr; |$of:ident| $all:expr
    ) => {
        $(#[$words])*
        #[derive(Clone, Copy)]
        pub(super) struct $name(pub(super) $register);

        operator!($name, Add, add, $add);
        operator!($name, Sub, sub, $sub);
        operator!($name, Mul, mul, $mul);
        operator!($name, Div, div, $div);

        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                let $x = self.0;
                // SAFETY: see the head of the file.
                Self(unsafe { $neg })
            }
        }

        impl Several<$number> for $name {
            const N: usize = $n;
            type Mask = $mask;
            #[inline(always)]
            fn splat(x: $number) -> Self {
                // SAFETY: see the head of the file.
                Self(unsafe { $splat(x) })
            }
            #[inline(always)]
            fn load(x: &[$number]) -> Self {
                // SAFETY: as above; the slice has N numbers.
                Self(unsafe { $load(x[..$n].as_ptr()) })
            }
            #[inline(always)]
            fn store(self, out: &mut [$number]) {
                // SAFETY: as above; the slice has N places.
                unsafe { $store(out[..$n].as_mut_ptr(), self.0) }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: see the head of the file.
                Self(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn fused(self, by: Self, plus: Self) -> Self {
                // SAFETY: see the head of the file.
                Self(unsafe { $fused(self.0, by.0, plus.0) })
            }
            #[inline(always)]
            fn below(self, other: Self) -> $mask {
                // SAFETY: see the head of the file.
                unsafe { $below::<_CMP_LT_OQ>(self.0, other.0) }
            }
            #[inline(always)]
            fn select($by: $mask, a: Self, b: Self) -> Self {
                let ($a, $b) = (a.0, b.0);
                // SAFETY: see the head of the file.
                Self(unsafe { $select })
            }
            #[inline(always)]
            #[allow(unused_unsafe)] // Masks of the wider registers are plain numbers.
            fn all($of: $mask) -> bool {
                // SAFETY: see the head of the file.
                unsafe { $all }
            }
        }
    };
}

register! {
    /// Four numbers.
    Four: 4 f64 in __m256d, mask __m256d;
    _mm256_add_pd _mm256_sub_pd _mm256_mul_pd _mm256_div_pd _mm256_sqrt_pd _mm256_fmadd_pd _mm256_set1_pd _mm256_loadu_pd _mm256_storeu_pd _mm256_cmp_pd;
    |x| _mm256_xor_pd(x, _mm256_set1_pd(-0.0)); |mask, a, b| _mm256_blendv_pd(b, a, mask); |mask| _mm256_movemask_pd(mask) == 0b1111
}

register! {
    /// Eight numbers of single precision.
    EightSingles: 8 f32 in __m256, mask __m256;
    _mm256_add_ps _mm256_sub_ps _mm256_mul_ps _mm256_div_ps _mm256_sqrt_ps _mm256_fmadd_ps _mm256_set1_ps _mm256_loadu_ps _mm256_storeu_ps _mm256_cmp_ps;
    |x| _mm256_xor_ps(x, _mm256_set1_ps(-0.0)); |mask, a, b| _mm256_blendv_ps(b, a, mask); |mask| _mm256_movemask_ps(mask) == 0xff
}

// -0 - x rounds like a change of sign: the xor of this width asks for further instructions.
register! {
    /// Eight numbers.
    Eight: 8 f64 in __m512d, mask __mmask8;
    _mm512_add_pd _mm512_sub_pd _mm512_mul_pd _mm512_div_pd _mm512_sqrt_pd _mm512_fmadd_pd _mm512_set1_pd _mm512_loadu_pd _mm512_storeu_pd _mm512_cmp_pd_mask;
    |x| _mm512_sub_pd(_mm512_set1_pd(-0.0), x); |mask, a, b| _mm512_mask_blend_pd(mask, b, a); |mask| mask == u8::MAX
}

register! {
    /// Sixteen numbers of single precision.
    SixteenSingles: 16 f32 in __m512, mask __mmask16;
    _mm512_add_ps _mm512_sub_ps _mm512_mul_ps _mm512_div_ps _mm512_sqrt_ps _mm512_fmadd_ps _mm512_set1_ps _mm512_loadu_ps _mm512_storeu_ps _mm512_cmp_ps_mask;
    |x| _mm512_sub_ps(_mm512_set1_ps(-0.0), x); |mask, a, b| _mm512_mask_blend_ps(mask, b, a); |mask| mask == u16::MAX
}

impl Lanes for Four {
    type Greys = EightSingles;
    type Single = EightSingles;
    #[inline(always)]
    unsafe fn load_at(x: *const f64) -> Self {
        // SAFETY: as above, and the contract of this function.
        Self(unsafe { _mm256_loadu_pd(x) })
    }
    #[inline(always)]
    unsafe fn store_at(self, out: *mut f64) {
        // SAFETY: as above, and the contract of this function.
        unsafe { _mm256_storeu_pd(out, self.0) }
    }
    #[inline(always)]
    fn narrow(self, out: &mut [f32]) {
        // SAFETY: see the head of the file; the slice has four places.
        unsafe { _mm_storeu_ps(out[..4].as_mut_ptr(), _mm256_cvtpd_ps(self.0)) }
    }
    #[inline(always)]
    fn floor(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_floor_pd(self.0) })
    }
    #[inline(always)]
    fn whole(self, out: &mut [u64]) {
        let ground = Self::splat(WHOLE);
        // SAFETY: see the head of the file; the slice has four places.
        unsafe { _mm256_storeu_pd(out[..4].as_mut_ptr().cast(), _mm256_xor_pd((self + ground).0, ground.0)) }
    }
    #[inline(always)]
    fn and(a: __m256d, b: __m256d) -> __m256d {
        // SAFETY: see the head of the file.
        unsafe { _mm256_and_pd(a, b) }
    }
    small_whole_numbers!();
}

impl Lanes for Eight {
    type Greys = EightSingles;
    type Single = SixteenSingles;
    const PICKS: bool = true;
    #[inline(always)]
    unsafe fn load_at(x: *const f64) -> Self {
        // SAFETY: as above, and the contract of this function.
        Self(unsafe { _mm512_loadu_pd(x) })
    }
    #[inline(always)]
    unsafe fn store_at(self, out: *mut f64) {
        // SAFETY: as above, and the contract of this function.
        unsafe { _mm512_storeu_pd(out, self.0) }
    }
    #[inline(always)]
    fn narrow(self, out: &mut [f32]) {
        // SAFETY: see the head of the file; the slice has eight places.
        unsafe { _mm256_storeu_ps(out[..8].as_mut_ptr(), _mm512_cvtpd_ps(self.0)) }
    }
    #[inline(always)]
    fn floor(self) -> Self {
        // SAFETY: see the head of the file; downwards, inexact numbers not reported.
        Self(unsafe { _mm512_roundscale_pd::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(self.0) })
    }
    #[inline(always)]
    fn whole(self, out: &mut [u64]) {
        let ground = Self::splat(WHOLE);
        // SAFETY: see the head of the file; the slice has eight places.
        unsafe {
            let bits = _mm512_xor_si512(_mm512_castpd_si512((self + ground).0), _mm512_castpd_si512(ground.0));
            _mm512_storeu_si512(out[..8].as_mut_ptr().cast(), bits);
        }
    }
    #[inline(always)]
    fn and(a: __mmask8, b: __mmask8) -> __mmask8 {
        a & b
    }
    small_whole_numbers!();
    #[inline(always)]
    fn with_picks<W: WithPicks>(work: W) -> Option<W::Output> {
        Some(work.run::<SixteenSingles>())
    }
}

impl Singles for EightSingles {
    #[inline(always)]
    fn power_of_two(self) -> Self {
        // SAFETY: see the head of the file.
        unsafe {
            let exponent = _mm256_add_epi32(_mm256_cvtps_epi32(self.0), _mm256_set1_epi32(127));
            Self(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(exponent)))
        }
    }
}

impl Singles for SixteenSingles {
    #[inline(always)]
    fn power_of_two(self) -> Self {
        // SAFETY: see the head of the file.
        unsafe {
            let exponent = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
            Self(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(exponent)))
        }
    }
}

impl Picks for SixteenSingles {
    type Line = [Self; 2];
    type Index = __m512i;
    #[inline(always)]
    fn line<S: Level>(x: &[S; LINE]) -> [Self; 2] {
        let mut numbers = [0.0; LINE];
        for i in 0..LINE {
            numbers[i] = x[i].number();
        }
        [Self::load(&numbers), Self::load(&numbers[SINGLES..])]
    }
    #[inline(always)]
    fn index(self) -> __m512i {
        // SAFETY: see the head of the file.
        unsafe { _mm512_cvtps_epi32(self.0) }
    }
    #[inline(always)]
    fn behind(index: __m512i, by: i32) -> __m512i {
        // SAFETY: see the head of the file.
        unsafe { _mm512_add_epi32(index, _mm512_set1_epi32(by)) }
    }
    #[inline(always)]
    fn pick(line: [Self; 2], index: __m512i) -> Self {
        // SAFETY: see the head of the file; of an index the five lowest bits count.
        Self(unsafe { _mm512_permutex2var_ps(line[0].0, index, line[1].0) })
    }
}
