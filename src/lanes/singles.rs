//! Numbers of single precision, for sums over pixels: twice as many at a time.
//!
//! The rules of [`super`] hold with [`SINGLES`] running sums: bits are equal on every machine.

use super::{LINE, Level, Several};

/// Pixels that go through a kernel together, whatever the width.
pub(crate) const SINGLES: usize = 16;

/// `f32` numbers that are computed with at once.
pub(crate) trait Singles: Several<f32> {
    /// Two to the power of a whole number from -126 to 127.
    fn power_of_two(self) -> Self;
    /// Absolute value.
    #[inline(always)]
    fn size(self) -> Self {
        Self::select(self.below(Self::splat(0.0)), -self, self)
    }
}

/// Sixteen numbers, each of which can be picked from a line of thirty-two.
pub(crate) trait Picks: Singles {
    /// Thirty-two numbers.
    type Line: Copy;
    /// Sixteen numbers of numbers in a line.
    type Index: Copy;
    /// Of grey levels.
    fn line<S: Level>(x: &[S; LINE]) -> Self::Line;
    /// Of whole numbers from 0 to 31.
    fn index(self) -> Self::Index;
    /// The same, so much later.
    fn behind(index: Self::Index, by: i32) -> Self::Index;
    /// From a line.
    fn pick(line: Self::Line, index: Self::Index) -> Self;
}

/// Work for processors that can pick; `run` has to be `#[inline(always)]`.
pub(crate) trait WithPicks {
    /// Its result.
    type Output;
    /// Does it.
    fn run<P: Picks>(self) -> Self::Output;
}

impl Singles for f32 {
    #[inline(always)]
    fn power_of_two(self) -> Self {
        f32::from_bits((((self as i32) + 127) as u32) << 23)
    }
}

/// The sum of [`SINGLES`] running sums, always in this order.
#[inline(always)]
pub(crate) fn sum_of_singles(x: &[f32; SINGLES]) -> f64 {
    let mut wide = [0.0; 8];
    for i in 0..8 {
        wide[i] = f64::from(x[i]) + f64::from(x[i + 8]);
    }
    super::sum(&wide)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, Lanes, run_all};

    /// Every operation once, on numbers that include zeros, infinities and NaN.
    #[derive(Clone)]
    struct Everything;
    impl Everything {
        #[inline(always)]
        fn of<S: Singles>() -> Vec<(usize, u32)> {
            let odd = [1.5, -2.0, 0.0, f32::NAN, 1e30, f32::INFINITY, -0.1, 3.0];
            let mut a = [0.0_f32; SINGLES];
            let mut b = a;
            for i in 0..SINGLES {
                a[i] = odd[i % 8] * if i < 8 { 1.0 } else { 0.7 };
                b[i] = odd[(5 * i + 3) % 8];
            }
            let mut out = vec![];
            for i in (0..SINGLES).step_by(S::N) {
                let (x, y) = (S::load(&a[i..]), S::load(&b[i..]));
                let some = x.below(y);
                let all = [
                    x + y,
                    x - y,
                    x * y,
                    x / y,
                    -x,
                    x.sqrt(),
                    x.fused(y, S::splat(-0.7)),
                    S::select(some, x, y),
                    x.at_least(y),
                    x.at_most(y),
                    x.size(),
                ];
                for (k, z) in all.into_iter().enumerate() {
                    let mut place = [0.0; SINGLES];
                    z.store(&mut place);
                    // Which NaN an operation gives is left open.
                    let bits = place[..S::N].iter().map(|v| if v.is_nan() { u32::MAX } else { v.to_bits() });
                    out.extend(bits.enumerate().map(|(n, v)| (k * SINGLES + i + n, v)));
                }
            }
            out.sort_unstable();
            out
        }
    }
    impl Kernel for Everything {
        type Output = Vec<(usize, u32)>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            Self::of::<L::Single>()
        }
    }

    #[test]
    fn all_widths_agree_to_the_bit_with_plain_numbers() {
        let all = run_all(&Everything);
        assert_eq!(all[0].len(), 11 * SINGLES);
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
    }

    #[derive(Clone)]
    struct Powers;
    impl Kernel for Powers {
        type Output = Vec<f32>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let mut out = vec![];
            for first in [-126, -16, 0, 112] {
                let mut place = [0.0; SINGLES];
                for i in (0..SINGLES).step_by(L::Single::N) {
                    let mut x = [0.0; SINGLES];
                    for (k, x) in x.iter_mut().enumerate() {
                        *x = (first + (i + k) as i32) as f32;
                    }
                    L::Single::load(&x).power_of_two().store(&mut place[i..]);
                }
                out.extend(place);
            }
            out
        }
    }

    #[test]
    fn powers_of_two_are_exact() {
        for all in run_all(&Powers) {
            for (k, x) in all.iter().enumerate() {
                let n = [-126, -16, 0, 112][k / SINGLES] + (k % SINGLES) as i32;
                assert_eq!(*x, 2.0_f32.powi(n), "{n}");
            }
        }
    }

    /// The numbers of a line at places that run forth and back, and at others three later.
    struct Picked([u16; LINE]);
    impl WithPicks for Picked {
        type Output = [[f32; SINGLES]; 2];
        #[inline(always)]
        fn run<P: Picks>(self) -> Self::Output {
            let places = |within: usize| {
                let mut places = [0.0; SINGLES];
                places.iter_mut().enumerate().for_each(|(i, x)| *x = (7 * i % within) as f32);
                P::load(&places).index()
            };
            let (line, mut out) = (P::line(&self.0), [[0.0; SINGLES]; 2]);
            P::pick(line, places(LINE)).store(&mut out[0]);
            P::pick(line, P::behind(places(LINE - 3), 3)).store(&mut out[1]);
            out
        }
    }
    #[derive(Clone)]
    struct Picking;
    impl Kernel for Picking {
        type Output = Option<[[f32; SINGLES]; 2]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            L::with_picks(Picked(std::array::from_fn(|i| 1000 + i as u16)))
        }
    }

    #[test]
    fn numbers_are_picked_where_the_processor_can() {
        for picked in run_all(&Picking).into_iter().flatten() {
            let wanted = |within: usize, later: usize| std::array::from_fn(|i| (1000 + 7 * i % within + later) as f32);
            assert_eq!(picked, [wanted(LINE, 0), wanted(LINE - 3, 3)]);
        }
    }

    #[derive(Clone)]
    struct AllBelow(f32);
    impl Kernel for AllBelow {
        type Output = bool;
        #[inline(always)]
        fn run<L: Lanes>(self) -> bool {
            let mut x = [0.0; SINGLES];
            x.iter_mut().enumerate().for_each(|(i, x)| *x = i as f32);
            (0..SINGLES)
                .step_by(L::Single::N)
                .all(|i| L::Single::all(L::Single::load(&x[i..]).below(L::Single::splat(self.0))))
        }
    }

    #[test]
    fn one_lane_decides_over_all() {
        assert!(run_all(&AllBelow(16.0)).into_iter().all(|x| x));
        assert!(!run_all(&AllBelow(15.0)).into_iter().any(|x| x));
    }

    #[test]
    fn running_sums_are_added_in_one_order() {
        let x: [f32; SINGLES] = std::array::from_fn(|i| 0.1 + i as f32);
        let plain: f64 = x.iter().map(|x| f64::from(*x)).sum();
        assert!((sum_of_singles(&x) - plain).abs() < 1e-12);
    }
}
