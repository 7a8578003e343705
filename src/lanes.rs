//! Several numbers at a time, with equal bits on every machine.
//!
//! A kernel is written once over [`Lanes`] and compiled for AVX-512 (8 numbers), AVX2 (4) and plain `f64` (1); [`run`] picks at run
//! time what the processor has. Equal bits hold where a kernel keeps two rules: lanes never look at each other, and sums over
//! points go into [`GROUP`] running sums (point i into sum i mod 8) that [`sum`] adds in one order. No operation here rounds otherwise
//! than its plain counterpart. A product and a sum are fused only where a kernel says so ([`Several::fused`]), and then on every machine:
//! one without such an instruction asks the C library, slowly.
//!
//! Outside of `ffi` this is the one room with `unsafe` code: the processor's instructions, each used only in a function compiled for it.
#![allow(unsafe_code)]

mod columns;
mod dots;
mod greys;
mod raster;
mod singles;
mod sweep;
mod twice;
mod whole;
#[cfg(target_arch = "x86_64")]
mod x86;
#[cfg(target_arch = "x86_64")]
mod x86_greys;
#[cfg(target_arch = "x86_64")]
mod x86_whole;

pub(crate) use columns::{Column, ColumnMut};
pub(crate) use dots::dots;
pub(crate) use greys::Greys;
pub(crate) use raster::{LINE, Level, Raster, fetch};
pub(crate) use singles::{Picks, SINGLES, Singles, WithPicks, sum_of_singles};
pub(crate) use sweep::{Each, sweep};
pub(crate) use twice::Twice;
pub(crate) use whole::BYTES;

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Points that go through a kernel together, whatever the width.
pub(crate) const GROUP: usize = 8;

/// 2^52. Added to a whole number below it leaves that number in the lowest bits: quicker than a conversion that asks for overflow.
const WHOLE: f64 = 4_503_599_627_370_496.0;

/// Numbers that are computed with at once, each an `X`.
pub(crate) trait Several<X>:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// How many; divides [`GROUP`] (`f64`; but for [`Twice`]) or [`SINGLES`] (`f32`).
    const N: usize;
    /// One truth value per number.
    type Mask: Copy;
    /// The same number everywhere.
    fn splat(x: X) -> Self;
    /// The first N numbers of a slice; panics where it is shorter.
    fn load(x: &[X]) -> Self;
    /// Into the first N places of a slice; panics where it is shorter.
    fn store(self, out: &mut [X]);
    /// Square root.
    fn sqrt(self) -> Self;
    /// `self by + plus`, rounded once.
    fn fused(self, by: Self, plus: Self) -> Self;
    /// `self < other`; false for NaN.
    fn below(self, other: Self) -> Self::Mask;
    /// `a` where the mask is set, else `b`.
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    /// True where every mask is set.
    fn all(mask: Self::Mask) -> bool;
    /// The larger one; `other` where self is NaN.
    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        Self::select(other.below(self), self, other)
    }
    /// The smaller one; `other` where self is NaN.
    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        Self::select(self.below(other), self, other)
    }
}

/// `f64` numbers that are computed with at once.
pub(crate) trait Lanes: Several<f64> {
    /// Eight numbers of single precision.
    type Greys: Greys;
    /// Numbers of single precision in the same registers.
    type Single: Singles;
    /// Whether the processor can pick ([`Lanes::with_picks`]).
    const PICKS: bool = false;
    /// N numbers at a place of any alignment.
    ///
    /// # Safety
    /// They can be read.
    unsafe fn load_at(x: *const f64) -> Self;
    /// To N places of any alignment.
    ///
    /// # Safety
    /// They can be written.
    unsafe fn store_at(self, out: *mut f64);
    /// Into the first N places of a slice, rounded to single precision; panics where it is shorter.
    fn narrow(self, out: &mut [f32]);
    /// The whole number at or below.
    fn floor(self) -> Self;
    /// Whole numbers from 0 to below 2^52 into the first N places of a slice; panics where it is shorter.
    fn whole(self, out: &mut [u64]);
    /// Both.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Sums of `x`, `i x`, `x^2` and, but for the first where it is `alone`, `(x - y)^2` over the first `n` of some bytes, before which there is one
    /// more: `x` a byte and `y` the one before it less the `ground`, `i` its place. Whole eights and that one; at least one of the last eight
    /// counts, `n` up to [`BYTES`].
    #[inline(always)]
    fn sums_of_bytes(bytes: &[u8], n: usize, ground: u8, alone: bool) -> [i32; 4] {
        whole::sums_of_bytes(bytes, n, ground, alone)
    }
    /// Bit `i` is set where number `i` is not zero.
    #[inline(always)]
    fn bits_of(x: &[u16; 32]) -> u32 {
        whole::bits_of(x)
    }
    /// What the work gives where the processor can pick.
    #[inline(always)]
    fn with_picks<W: WithPicks>(_work: W) -> Option<W::Output> {
        None
    }
}

/// One number as a list of one.
macro_rules! one_number {
    ($number:ident) => {
        impl Several<$number> for $number {
            const N: usize = 1;
            type Mask = bool;
            #[inline(always)]
            fn splat(x: $number) -> Self {
                x
            }
            #[inline(always)]
            fn load(x: &[$number]) -> Self {
                x[0]
            }
            #[inline(always)]
            fn store(self, out: &mut [$number]) {
                out[0] = self;
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn fused(self, by: Self, plus: Self) -> Self {
                self.mul_add(by, plus)
            }
            #[inline(always)]
            fn below(self, other: Self) -> bool {
                self < other
            }
            #[inline(always)]
            fn select(mask: bool, a: Self, b: Self) -> Self {
                if mask { a } else { b }
            }
            #[inline(always)]
            fn all(mask: bool) -> bool {
                mask
            }
        }
    };
}

one_number!(f64);
one_number!(f32);

impl Lanes for f64 {
    type Greys = greys::Plain;
    type Single = f32;
    #[inline(always)]
    unsafe fn load_at(x: *const f64) -> Self {
        // SAFETY: the contract of this function.
        unsafe { x.read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store_at(self, out: *mut f64) {
        // SAFETY: the contract of this function.
        unsafe { out.write_unaligned(self) }
    }
    #[inline(always)]
    fn narrow(self, out: &mut [f32]) {
        out[0] = self as f32;
    }
    #[inline(always)]
    fn floor(self) -> Self {
        self.floor()
    }
    #[inline(always)]
    fn whole(self, out: &mut [u64]) {
        out[0] = (self + WHOLE).to_bits() ^ WHOLE.to_bits();
    }
    #[inline(always)]
    fn and(a: bool, b: bool) -> bool {
        a & b
    }
}

/// Work that is compiled for every width; `run` has to be `#[inline(always)]`, and so has all that it calls with lanes.
pub(crate) trait Kernel {
    /// Its result.
    type Output;
    /// Does it.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs a kernel as wide as this processor allows; one number at a time with `--cfg spivcal_narrow`, for tools that watch memory and do not
/// see wide writes (ThreadSanitizer).
#[inline]
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if !cfg!(spivcal_narrow) {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has the instructions that the function is compiled for.
            return unsafe { x86::in_avx512(kernel) };
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: as above.
            return unsafe { x86::in_avx2(kernel) };
        }
    }
    kernel.run::<f64>()
}

/// Each number in every lane. Plain loops: what is handed closures is not always compiled for the kernel's instructions.
#[inline(always)]
pub(crate) fn splats<L: Lanes, const N: usize>(x: [f64; N]) -> [L; N] {
    let mut out = [L::splat(0.0); N];
    for k in 0..N {
        out[k] = L::splat(x[k]);
    }
    out
}

/// The sum of [`GROUP`] running sums, always in this order.
#[inline(always)]
pub(crate) fn sum(x: &[f64]) -> f64 {
    ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]))
}

/// A kernel in every width that this machine has; for tests of equal bits.
#[cfg(test)]
pub(crate) fn run_all<K: Kernel + Clone>(kernel: &K) -> Vec<K::Output> {
    let mut out = vec![kernel.clone().run::<f64>()];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the processor has these instructions.
            out.push(unsafe { x86::in_avx2(kernel.clone()) });
        }
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: as above.
            out.push(unsafe { x86::in_avx512(kernel.clone()) });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation once, on numbers that include zeros, infinities and NaN.
    #[derive(Clone)]
    struct Everything;
    impl Kernel for Everything {
        type Output = Vec<u64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u64> {
            let a = [1.5, -2.0, 0.0, f64::NAN, 1e300, f64::INFINITY, -0.1, 3.0];
            let b = [0.3, 7.0, -0.0, 1.0, 1e300, f64::NEG_INFINITY, 2.0, f64::NAN];
            let mut out = vec![];
            for i in (0..GROUP).step_by(L::N) {
                let (x, y) = (L::load(&a[i..]), L::load(&b[i..]));
                let some = x.below(y);
                let both = L::and(x.below(y), y.below(L::splat(0.5)));
                let all = [
                    x + y,
                    x - y,
                    x * y,
                    x / y,
                    -x,
                    x.sqrt(),
                    x.fused(y, L::splat(-0.7)),
                    L::select(some, x, y),
                    L::select(both, x, y),
                    x.at_least(y),
                    x.at_most(y),
                ];
                for (k, z) in all.into_iter().enumerate() {
                    let mut place = [0.0; GROUP];
                    z.store(&mut place);
                    // Which NaN an operation gives is left open.
                    let bits = place[..L::N].iter().map(|v| if v.is_nan() { u64::MAX } else { v.to_bits() });
                    out.extend(bits.enumerate().map(|(n, v)| ((k * GROUP + i + n) as u64, v)));
                }
            }
            out.sort_unstable();
            out.into_iter().map(|(_, v)| v).collect()
        }
    }

    #[test]
    fn all_widths_agree_to_the_bit_with_plain_numbers() {
        let all = run_all(&Everything);
        assert_eq!(all[0].len(), 11 * GROUP);
        assert_eq!(all[0][0], 1.8_f64.to_bits());
        assert_eq!(all[0][6 * GROUP], 1.5_f64.mul_add(0.3, -0.7).to_bits());
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
    }

    #[derive(Clone)]
    struct Whole([f64; GROUP]);
    impl Kernel for Whole {
        type Output = [u64; GROUP];
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let mut out = [0; GROUP];
            for i in (0..GROUP).step_by(L::N) {
                L::load(&self.0[i..]).whole(&mut out[i..]);
            }
            out
        }
    }

    #[test]
    fn whole_numbers_stay_what_they_are() {
        let all = run_all(&Whole([0.0, 1.0, 2.0, 1023.0, 1e9, 4_294_967_296.0, 1e15, 4_503_599_627_370_495.0]));
        all.iter().for_each(|one| {
            assert_eq!(*one, [0, 1, 2, 1023, 1_000_000_000, 1 << 32, 1_000_000_000_000_000, (1 << 52) - 1]);
        });
    }

    #[derive(Clone)]
    struct AllBelow(f64);
    impl Kernel for AllBelow {
        type Output = bool;
        #[inline(always)]
        fn run<L: Lanes>(self) -> bool {
            let x: Vec<f64> = (0..GROUP).map(|i| i as f64).collect();
            (0..GROUP).step_by(L::N).all(|i| L::all(L::load(&x[i..]).below(L::splat(self.0))))
        }
    }

    #[test]
    fn one_lane_decides_over_all() {
        assert!(run_all(&AllBelow(8.0)).into_iter().all(|x| x));
        assert!(!run_all(&AllBelow(7.0)).into_iter().any(|x| x));
        assert!(!run_all(&AllBelow(f64::NAN)).into_iter().any(|x| x));
    }
}
