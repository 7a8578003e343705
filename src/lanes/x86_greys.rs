//! AVX for windows of grey levels. What is said at the head of `x86` makes each `unsafe` below sound.

use super::x86::EightSingles;
use super::{Greys, Several};
use std::arch::asm;
use std::arch::x86_64::{
    __m256, _mm256_permute2f128_ps, _mm256_permutevar8x32_ps, _mm256_setr_epi32, _mm256_shuffle_ps, _mm256_unpackhi_ps,
    _mm256_unpacklo_ps,
};

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

impl Greys for EightSingles {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Several::splat(x)
    }
    #[inline(always)]
    fn fused(self, by: Self, plus: Self) -> Self {
        Several::fused(self, by, plus)
    }
    #[inline(always)]
    fn load(x: &[f32; 8]) -> Self {
        Several::load(x)
    }
    #[inline(always)]
    fn store(self, out: &mut [f32; 8]) {
        Several::store(self, out);
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
    fn turned(x: [Self; 8]) -> [Self; 8] {
        let mut out = x;
        // SAFETY: see the head of the file.
        unsafe {
            // Fours of numbers, of lists 0 to 3 and of lists 4 to 7.
            for k in [0, 4] {
                let [a, b, c, d] = [x[k].0, x[k + 1].0, x[k + 2].0, x[k + 3].0];
                let [ab, cd] = [_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d)];
                out[k] = Self(_mm256_shuffle_ps::<0x44>(ab, cd));
                out[k + 1] = Self(_mm256_shuffle_ps::<0xee>(ab, cd));
                let [ab, cd] = [_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d)];
                out[k + 2] = Self(_mm256_shuffle_ps::<0x44>(ab, cd));
                out[k + 3] = Self(_mm256_shuffle_ps::<0xee>(ab, cd));
            }
            for k in 0..4 {
                let [low, high] = [out[k].0, out[k + 4].0];
                out[k] = Self(_mm256_permute2f128_ps::<0x20>(low, high));
                out[k + 4] = Self(_mm256_permute2f128_ps::<0x31>(low, high));
            }
        }
        out
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
