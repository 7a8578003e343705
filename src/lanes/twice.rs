//! Two lists of lanes side by side: what each has to wait for the other fills.
//!
//! A point's image is one long chain of operations, each of which waits four cycles or more for the one before. A processor looks ahead far
//! enough for a part of the next chain only; two that alternate instruction by instruction keep it busy.

use super::{Lanes, Several};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// The numbers of two lists; a list of its own, twice as long.
#[derive(Clone, Copy)]
pub(crate) struct Twice<L>([L; 2]);

macro_rules! operator {
    ($operator:ident, $name:ident) => {
        impl<L: Lanes> $operator for Twice<L> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self([self.0[0].$name(other.0[0]), self.0[1].$name(other.0[1])])
            }
        }
    };
}

operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl<L: Lanes> Neg for Twice<L> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self([-self.0[0], -self.0[1]])
    }
}

impl<L: Lanes> Several<f64> for Twice<L> {
    const N: usize = 2 * L::N;
    type Mask = [L::Mask; 2];
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([L::splat(x); 2])
    }
    #[inline(always)]
    fn load(x: &[f64]) -> Self {
        Self([L::load(x), L::load(&x[L::N..])])
    }
    #[inline(always)]
    fn store(self, out: &mut [f64]) {
        self.0[0].store(out);
        self.0[1].store(&mut out[L::N..]);
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self([self.0[0].sqrt(), self.0[1].sqrt()])
    }
    #[inline(always)]
    fn fused(self, by: Self, plus: Self) -> Self {
        Self([self.0[0].fused(by.0[0], plus.0[0]), self.0[1].fused(by.0[1], plus.0[1])])
    }
    #[inline(always)]
    fn below(self, other: Self) -> Self::Mask {
        [self.0[0].below(other.0[0]), self.0[1].below(other.0[1])]
    }
    #[inline(always)]
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self {
        Self([L::select(mask[0], a.0[0], b.0[0]), L::select(mask[1], a.0[1], b.0[1])])
    }
    #[inline(always)]
    fn all(mask: Self::Mask) -> bool {
        L::all(mask[0]) & L::all(mask[1])
    }
}

impl<L: Lanes> Lanes for Twice<L> {
    type Greys = L::Greys;
    type Single = L::Single;
    #[inline(always)]
    unsafe fn load_at(x: *const f64) -> Self {
        // SAFETY: the contract of this function.
        unsafe { Self([L::load_at(x), L::load_at(x.add(L::N))]) }
    }
    #[inline(always)]
    unsafe fn store_at(self, out: *mut f64) {
        // SAFETY: the contract of this function.
        unsafe {
            self.0[0].store_at(out);
            self.0[1].store_at(out.add(L::N));
        }
    }
    #[inline(always)]
    fn narrow(self, out: &mut [f32]) {
        self.0[0].narrow(out);
        self.0[1].narrow(&mut out[L::N..]);
    }
    #[inline(always)]
    fn whole(self, out: &mut [u64]) {
        self.0[0].whole(out);
        self.0[1].whole(&mut out[L::N..]);
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self([self.0[0].floor(), self.0[1].floor()])
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        [L::and(a[0], b[0]), L::and(a[1], b[1])]
    }
}
