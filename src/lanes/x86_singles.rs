//! AVX2 and AVX-512 for single precision. What is said at the head of `x86` makes each `unsafe` below sound.

use super::Singles;
use std::arch::x86_64::{
    __m256, __m512, __mmask16, _CMP_LT_OQ, _mm256_add_epi32, _mm256_add_ps, _mm256_blendv_ps, _mm256_castsi256_ps,
    _mm256_cmp_ps, _mm256_cvtps_epi32, _mm256_div_ps, _mm256_loadu_ps, _mm256_movemask_ps, _mm256_mul_ps,
    _mm256_set1_epi32, _mm256_set1_ps, _mm256_slli_epi32, _mm256_sqrt_ps, _mm256_storeu_ps, _mm256_sub_ps,
    _mm256_xor_ps, _mm512_add_epi32, _mm512_add_ps, _mm512_castsi512_ps, _mm512_cmp_ps_mask, _mm512_cvtps_epi32,
    _mm512_div_ps, _mm512_loadu_ps, _mm512_mask_blend_ps, _mm512_mul_ps, _mm512_set1_epi32, _mm512_set1_ps,
    _mm512_slli_epi32, _mm512_sqrt_ps, _mm512_storeu_ps, _mm512_sub_ps,
};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Eight numbers.
#[derive(Clone, Copy)]
pub(crate) struct EightSingles(__m256);

/// Sixteen numbers.
#[derive(Clone, Copy)]
pub(crate) struct SixteenSingles(__m512);

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

operator!(EightSingles, Add, add, _mm256_add_ps);
operator!(EightSingles, Sub, sub, _mm256_sub_ps);
operator!(EightSingles, Mul, mul, _mm256_mul_ps);
operator!(EightSingles, Div, div, _mm256_div_ps);
operator!(SixteenSingles, Add, add, _mm512_add_ps);
operator!(SixteenSingles, Sub, sub, _mm512_sub_ps);
operator!(SixteenSingles, Mul, mul, _mm512_mul_ps);
operator!(SixteenSingles, Div, div, _mm512_div_ps);

impl Neg for EightSingles {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
}

impl Neg for SixteenSingles {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // -0 - x rounds like a change of sign: the xor of this width asks for further instructions.
        Self::splat(-0.0) - self
    }
}

impl Singles for EightSingles {
    const N: usize = 8;
    type Mask = __m256;
    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn load(x: &[f32]) -> Self {
        // SAFETY: as above; the slice has eight numbers.
        Self(unsafe { _mm256_loadu_ps(x[..8].as_ptr()) })
    }
    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        // SAFETY: as above; the slice has eight places.
        unsafe { _mm256_storeu_ps(out[..8].as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn below(self, other: Self) -> __m256 {
        // SAFETY: see the head of the file.
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn select(mask: __m256, a: Self, b: Self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm256_blendv_ps(b.0, a.0, mask) })
    }
    #[inline(always)]
    fn all(mask: __m256) -> bool {
        // SAFETY: see the head of the file.
        unsafe { _mm256_movemask_ps(mask) == 0xff }
    }
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
    const N: usize = 16;
    type Mask = __mmask16;
    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_set1_ps(x) })
    }
    #[inline(always)]
    fn load(x: &[f32]) -> Self {
        // SAFETY: as above; the slice has sixteen numbers.
        Self(unsafe { _mm512_loadu_ps(x[..16].as_ptr()) })
    }
    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        // SAFETY: as above; the slice has sixteen places.
        unsafe { _mm512_storeu_ps(out[..16].as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn below(self, other: Self) -> __mmask16 {
        // SAFETY: see the head of the file.
        unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn select(mask: __mmask16, a: Self, b: Self) -> Self {
        // SAFETY: see the head of the file.
        Self(unsafe { _mm512_mask_blend_ps(mask, b.0, a.0) })
    }
    #[inline(always)]
    fn all(mask: __mmask16) -> bool {
        mask == u16::MAX
    }
    #[inline(always)]
    fn power_of_two(self) -> Self {
        // SAFETY: see the head of the file.
        unsafe {
            let exponent = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
            Self(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(exponent)))
        }
    }
}
