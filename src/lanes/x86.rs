//! AVX2 and AVX-512.
//!
//! A value of these types is only ever made inside a function compiled for its instructions, which [`super::run`] enters after having
//! asked the processor: that is what makes each `unsafe` below sound.

use super::x86_singles::{EightSingles, SixteenSingles};
use super::{Greys, Kernel, Lanes};
use std::arch::asm;
use std::arch::x86_64::{
    __m256, __m256d, __m512d, __mmask8, _CMP_LT_OQ, _MM_FROUND_NO_EXC, _MM_FROUND_TO_NEG_INF, _mm_storeu_ps,
    _mm256_add_pd, _mm256_add_ps, _mm256_and_pd, _mm256_blendv_pd, _mm256_cmp_pd, _mm256_cvtpd_ps, _mm256_div_pd,
    _mm256_floor_pd, _mm256_loadu_pd, _mm256_loadu_ps, _mm256_movemask_pd, _mm256_mul_pd, _mm256_mul_ps,
    _mm256_permute2f128_ps, _mm256_permutevar8x32_ps, _mm256_set1_pd, _mm256_set1_ps, _mm256_setr_epi32,
    _mm256_shuffle_ps, _mm256_sqrt_pd, _mm256_storeu_pd, _mm256_storeu_ps, _mm256_sub_pd, _mm256_xor_pd, _mm512_add_pd,
    _mm512_cmp_pd_mask, _mm512_cvtpd_ps, _mm512_div_pd, _mm512_loadu_pd, _mm512_mask_blend_pd, _mm512_mul_pd,
    _mm512_roundscale_pd, _mm512_set1_pd, _mm512_sqrt_pd, _mm512_storeu_pd, _mm512_sub_pd,
};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Four numbers.
#[derive(Clone, Copy)]
pub(super) struct Four(__m256d);

/// Eight numbers.
#[derive(Clone, Copy)]
pub(super) struct Eight(__m512d);

/// Eight numbers of single precision.
#[derive(Clone, Copy)]
pub(super) struct Single(__m256);

/// Runs a kernel four numbers at a time.
#[target_feature(enable = "avx2")]
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

operator!(Four, Add, add, _mm256_add_pd);
operator!(Four, Sub, sub, _mm256_sub_pd);
operator!(Four, Mul, mul, _mm256_mul_pd);
operator!(Four, Div, div, _mm256_div_pd);
operator!(Single, Add, add, _mm256_add_ps);
operator!(Single, Mul, mul, _mm256_mul_ps);
operator!(Eight, Add, add, _mm512_add_pd);
operator!(Eight, Sub, sub, _mm512_sub_pd);
operator!(Eight, Mul, mul, _mm512_mul_pd);
operator!(Eight, Div, div, _mm512_div_pd);

impl Neg for Four {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_xor_pd(self.0, _mm256_set1_pd(-0.0)) })
    }
}

impl Neg for Eight {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // -0 - x rounds like a change of sign: the xor of this width asks for further instructions.
        Self::splat(-0.0) - self
    }
}

impl Lanes for Four {
    const N: usize = 4;
    type Mask = __m256d;
    type Greys = Single;
    type Single = EightSingles;
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_set1_pd(x) })
    }
    #[inline(always)]
    fn load(x: &[f64]) -> Self {
        // SAFETY: as above; the slice has four numbers.
        Self(unsafe { _mm256_loadu_pd(x[..4].as_ptr()) })
    }
    #[inline(always)]
    fn store(self, out: &mut [f64]) {
        // SAFETY: as above; the slice has four places.
        unsafe { _mm256_storeu_pd(out[..4].as_mut_ptr(), self.0) }
    }
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
    fn sqrt(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_sqrt_pd(self.0) })
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
    fn below(self, other: Self) -> __m256d {
        // SAFETY: see the head of the file.
        unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn select(mask: __m256d, a: Self, b: Self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_blendv_pd(b.0, a.0, mask) })
    }
    #[inline(always)]
    fn and(a: __m256d, b: __m256d) -> __m256d {
        // SAFETY: see the head of the file.
        unsafe { _mm256_and_pd(a, b) }
    }
    #[inline(always)]
    fn all(mask: __m256d) -> bool {
        // SAFETY: see the head of the file.
        unsafe { _mm256_movemask_pd(mask) == 0b1111 }
    }
}

impl Lanes for Eight {
    const N: usize = 8;
    type Mask = __mmask8;
    type Greys = Single;
    type Single = SixteenSingles;
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_set1_pd(x) })
    }
    #[inline(always)]
    fn load(x: &[f64]) -> Self {
        // SAFETY: as above; the slice has eight numbers.
        Self(unsafe { _mm512_loadu_pd(x[..8].as_ptr()) })
    }
    #[inline(always)]
    fn store(self, out: &mut [f64]) {
        // SAFETY: as above; the slice has eight places.
        unsafe { _mm512_storeu_pd(out[..8].as_mut_ptr(), self.0) }
    }
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
    fn sqrt(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_sqrt_pd(self.0) })
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
    fn below(self, other: Self) -> __mmask8 {
        // SAFETY: see the head of the file.
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn select(mask: __mmask8, a: Self, b: Self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_mask_blend_pd(mask, b.0, a.0) })
    }
    #[inline(always)]
    fn and(a: __mmask8, b: __mmask8) -> __mmask8 {
        a & b
    }
    #[inline(always)]
    fn all(mask: __mmask8) -> bool {
        mask == u8::MAX
    }
}

/// Number K of each four everywhere in that four.
#[inline]
#[target_feature(enable = "avx")]
fn of_fours<const K: usize>(x: __m256) -> __m256 {
    let out;
    // In words of the processor: where the compiler sees through a shuffle it merges it with others and takes two instructions for one.
    // SAFETY: one instruction between registers, of the set that the function is compiled for.
    unsafe {
        match K {
            0 => {
                asm!("vpermilps {}, {}, 0x00", lateout(ymm_reg) out, in(ymm_reg) x, options(pure, nomem, nostack, preserves_flags))
            }
            1 => {
                asm!("vpermilps {}, {}, 0x55", lateout(ymm_reg) out, in(ymm_reg) x, options(pure, nomem, nostack, preserves_flags))
            }
            2 => {
                asm!("vpermilps {}, {}, 0xaa", lateout(ymm_reg) out, in(ymm_reg) x, options(pure, nomem, nostack, preserves_flags))
            }
            _ => {
                asm!("vpermilps {}, {}, 0xff", lateout(ymm_reg) out, in(ymm_reg) x, options(pure, nomem, nostack, preserves_flags))
            }
        }
    }
    out
}

impl Greys for Single {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn load(x: &[f32; 8]) -> Self {
        // SAFETY: as above; the array has eight numbers.
        Self(unsafe { _mm256_loadu_ps(x.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, out: &mut [f32; 8]) {
        // SAFETY: as above; the array has eight places.
        unsafe { _mm256_storeu_ps(out.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn of_fours<const K: usize>(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { of_fours::<K>(self.0) })
    }
    #[inline(always)]
    fn four_times<const K: usize>(self) -> Self {
        let [a, b] = [2 * K as i32, 2 * K as i32 + 1];
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_permutevar8x32_ps(self.0, _mm256_setr_epi32(a, a, a, a, b, b, b, b)) })
    }
    #[inline(always)]
    fn four_twice<const K: usize>(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe {
            match K {
                0 => _mm256_permute2f128_ps::<0x00>(self.0, self.0),
                _ => _mm256_permute2f128_ps::<0x11>(self.0, self.0),
            }
        })
    }
    #[inline(always)]
    fn folded(self, other: Self) -> Self {
        // SAFETY: see the head of the file.
        unsafe {
            let low = Self(_mm256_permute2f128_ps::<0x20>(self.0, other.0));
            low + Self(_mm256_permute2f128_ps::<0x31>(self.0, other.0))
        }
    }
    #[inline(always)]
    fn sums([a, b, c, d]: [Self; 4]) -> Self {
        // SAFETY: see the head of the file.
        unsafe {
            let ab = Self(_mm256_shuffle_ps::<0x44>(a.0, b.0)) + Self(_mm256_shuffle_ps::<0xee>(a.0, b.0));
            let cd = Self(_mm256_shuffle_ps::<0x44>(c.0, d.0)) + Self(_mm256_shuffle_ps::<0xee>(c.0, d.0));
            let all = Self(_mm256_shuffle_ps::<0x88>(ab.0, cd.0)) + Self(_mm256_shuffle_ps::<0xdd>(ab.0, cd.0));
            // Even ones below, odd ones above.
            Self(_mm256_permutevar8x32_ps(all.0, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7)))
        }
    }
}
