//! AVX2 for small whole numbers. What is said at the head of `x86` makes each `unsafe` below sound.

use std::arch::x86_64::{
    __m128i, _mm_add_epi16, _mm_add_epi32, _mm_and_si128, _mm_cmpgt_epi16, _mm_cvtepu8_epi16, _mm_hadd_epi32,
    _mm_loadl_epi64, _mm_madd_epi16, _mm_set1_epi16, _mm_setr_epi16, _mm_setzero_si128, _mm_storeu_si128,
    _mm_sub_epi16, _mm256_cmpeq_epi16, _mm256_loadu_si256, _mm256_movemask_epi8, _mm256_packs_epi16,
    _mm256_permute4x64_epi64, _mm256_setzero_si256,
};

const EIGHT: usize = 8;

/// As [`super::Lanes::sums_of_bytes`], eight at a time.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn sums_of_bytes(bytes: &[u8], n: usize, ground: u8, alone: bool) -> [i32; 4] {
    // SAFETY: eight bytes are read of arrays that have as many, four numbers of 32 bits written.
    unsafe {
        let eight = |bytes: &[u8]| _mm_cvtepu8_epi16(_mm_loadl_epi64(bytes[..EIGHT].as_ptr().cast()));
        let (ground, one) = (_mm_set1_epi16(i16::from(ground)), _mm_set1_epi16(1));
        let mut place = _mm_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7);
        // Up to 1024, which 16 bits hold.
        let end = _mm_set1_epi16(n as i16);
        let mut beside = _mm_cmpgt_epi16(place, _mm_set1_epi16(if alone { 0 } else { -1 }));
        let mut sums = [_mm_setzero_si128(); 4];
        let add = |sum: &mut __m128i, x: __m128i, y: __m128i| *sum = _mm_add_epi32(*sum, _mm_madd_epi16(x, y));
        let mut from = 0;
        while let Some(nine) = bytes.get(from..from + EIGHT + 1) {
            let counted = _mm_cmpgt_epi16(end, place);
            let (x, y) = (eight(&nine[1..]), eight(nine));
            let step = _mm_and_si128(_mm_sub_epi16(x, y), _mm_and_si128(counted, beside));
            let x = _mm_and_si128(_mm_sub_epi16(x, ground), counted);
            add(&mut sums[0], x, one);
            add(&mut sums[1], x, place);
            add(&mut sums[2], x, x);
            add(&mut sums[3], step, step);
            place = _mm_add_epi16(place, _mm_set1_epi16(EIGHT as i16));
            beside = _mm_set1_epi16(-1);
            from += EIGHT;
        }
        let mut out = [0; 4];
        let all = _mm_hadd_epi32(_mm_hadd_epi32(sums[0], sums[1]), _mm_hadd_epi32(sums[2], sums[3]));
        _mm_storeu_si128(out.as_mut_ptr().cast(), all);
        out
    }
}

/// As [`super::Lanes::bits_of`].
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn bits_of(x: &[u16; 32]) -> u32 {
    let none = _mm256_setzero_si256();
    // SAFETY: sixteen numbers each of the lower and the upper half are read.
    let [low, high] = [0, 16].map(|k| unsafe { _mm256_loadu_si256(x.as_ptr().add(k).cast()) });
    let zeros = _mm256_packs_epi16(_mm256_cmpeq_epi16(low, none), _mm256_cmpeq_epi16(high, none));
    // Of each list four, four, four and four come in turns.
    !(_mm256_movemask_epi8(_mm256_permute4x64_epi64::<0b11_01_10_00>(zeros)) as u32)
}
