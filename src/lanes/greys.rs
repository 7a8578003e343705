//! Eight numbers of single precision: grey levels, and the weights of their windows.
//!
//! Eight stand for one window's row of eight samples, or for rows of four samples of two windows. One width on every processor (AVX, or
//! eight plain numbers): rows of a window are short, wider ones would have to be put together.

use std::ops::{Add, Mul};

/// Eight numbers; a *four* is their lower or upper half.
pub(crate) trait Greys: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// The same number everywhere.
    fn splat(x: f32) -> Self;
    /// `self by + plus`, rounded once.
    fn fused(self, by: Self, plus: Self) -> Self;
    /// Those of an array.
    fn load(x: &[f32; 8]) -> Self;
    /// Into an array.
    fn store(self, out: &mut [f32; 8]);
    /// Number K of each four everywhere in that four.
    fn of_fours<const K: usize>(self) -> Self;
    /// Number 2 K four times, then number 2 K + 1 four times.
    fn four_times<const K: usize>(self) -> Self;
    /// Number i of list j as number j of list i.
    fn turned(x: [Self; 8]) -> [Self; 8];
    /// Of each four its sum (0 + 2) + (1 + 3): both of the first, both of the second, and so on.
    fn sums(x: [Self; 4]) -> Self;
}

/// Eight plain numbers.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; 8]);

impl Plain {
    #[inline(always)]
    fn from_each(each: impl Fn(usize) -> f32) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = each(i);
        }
        Self(out)
    }
}

impl Add for Plain {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::from_each(|i| self.0[i] + other.0[i])
    }
}

impl Mul for Plain {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::from_each(|i| self.0[i] * other.0[i])
    }
}

impl Greys for Plain {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 8])
    }
    #[inline(always)]
    fn fused(self, by: Self, plus: Self) -> Self {
        Self::from_each(|i| self.0[i].mul_add(by.0[i], plus.0[i]))
    }
    #[inline(always)]
    fn load(x: &[f32; 8]) -> Self {
        Self(*x)
    }
    #[inline(always)]
    fn store(self, out: &mut [f32; 8]) {
        *out = self.0;
    }
    #[inline(always)]
    fn of_fours<const K: usize>(self) -> Self {
        Self::from_each(|i| self.0[i / 4 * 4 + K])
    }
    #[inline(always)]
    fn four_times<const K: usize>(self) -> Self {
        Self::from_each(|i| self.0[2 * K + i / 4])
    }
    #[inline(always)]
    fn turned(x: [Self; 8]) -> [Self; 8] {
        let mut out = x;
        for i in 0..8 {
            out[i] = Self::from_each(|j| x[j].0[i]);
        }
        out
    }
    #[inline(always)]
    fn sums(x: [Self; 4]) -> Self {
        Self::from_each(|i| {
            let (x, at) = (&x[i / 2].0, 4 * (i % 2));
            (x[at] + x[at + 2]) + (x[at + 1] + x[at + 3])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, Lanes, run_all};

    #[derive(Clone)]
    struct Everything;
    impl Kernel for Everything {
        type Output = Vec<[f32; 8]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<[f32; 8]> {
            let list = |step: f32| L::Greys::load(&std::array::from_fn(|i| (1.0 + i as f32) * step));
            let [a, b, c, d] = [1.0, 10.0, 100.0, 1e7].map(list);
            let all = [
                a + b,
                a * d,
                L::Greys::splat(0.1).fused(a, d),
                a.of_fours::<0>(),
                a.of_fours::<1>(),
                a.of_fours::<2>(),
                a.of_fours::<3>(),
                a.four_times::<0>(),
                a.four_times::<1>(),
                a.four_times::<2>(),
                a.four_times::<3>(),
                Greys::sums([a, b, c, d]),
            ];
            let turned = L::Greys::turned([a, b, c, d, a + b, a + c, a + d, b + c]);
            [&all[..], &turned]
                .concat()
                .into_iter()
                .map(|x| {
                    let mut out = [0.0; 8];
                    x.store(&mut out);
                    out
                })
                .collect()
        }
    }

    #[test]
    fn all_widths_agree_and_do_what_they_say() {
        let all = run_all(&Everything);
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
        assert_eq!(all[0][4], [2.0, 2.0, 2.0, 2.0, 6.0, 6.0, 6.0, 6.0]);
        assert_eq!(all[0][8], [3.0, 3.0, 3.0, 3.0, 4.0, 4.0, 4.0, 4.0]);
        assert_eq!(all[0][11], [10.0, 26.0, 100.0, 260.0, 1000.0, 2600.0, 1e8, 2.6e8]);
        assert_eq!(all[0][12], [1.0, 10.0, 100.0, 1e7, 11.0, 101.0, 10_000_001.0, 110.0]);
        assert_eq!(all[0][19], [8.0, 80.0, 800.0, 8e7, 88.0, 808.0, 80_000_008.0, 880.0]);
    }
}
