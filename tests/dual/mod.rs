//! Dual numbers: values that carry their gradient by N variables.

#![allow(dead_code, clippy::suspicious_arithmetic_impl)]

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number with its gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dual<const N: usize> {
    pub(crate) x: f64,
    pub(crate) d: [f64; N],
}

impl<const N: usize> Dual<N> {
    pub(crate) fn constant(x: f64) -> Self {
        Self { x, d: [0.0; N] }
    }
    pub(crate) fn variable(x: f64, index: usize) -> Self {
        let mut v = Self::constant(x);
        v.d[index] = 1.0;
        v
    }
    /// Value and slope of a function of one number.
    pub(crate) fn chain(self, x: f64, slope: f64) -> Self {
        Self { x, d: self.d.map(|d| d * slope) }
    }
    pub(crate) fn sin(self) -> Self {
        self.chain(self.x.sin(), self.x.cos())
    }
    pub(crate) fn sqrt(self) -> Self {
        self.chain(self.x.sqrt(), 0.5 / self.x.sqrt())
    }
    pub(crate) fn cos(self) -> Self {
        self.chain(self.x.cos(), -self.x.sin())
    }
}
impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self { x: self.x + o.x, d: std::array::from_fn(|i| self.d[i] + o.d[i]) }
    }
}
impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.x, -1.0)
    }
}
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        self + -o
    }
}
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self { x: self.x * o.x, d: std::array::from_fn(|i| self.d[i] * o.x + self.x * o.d[i]) }
    }
}
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let x = self.x / o.x;
        Self { x, d: std::array::from_fn(|i| (self.d[i] - x * o.d[i]) / o.x) }
    }
}
