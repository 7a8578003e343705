//! Structures of arrays, several points at a time.

use super::{GROUP, Kernel, Lanes, run};

/// What is done with one point of N numbers; it gives M. `of` has to be `#[inline(always)]`.
pub(crate) trait Each<L, const N: usize, const M: usize> {
    /// The results; lanes never look at each other.
    fn of(&self, x: [L; N]) -> [L; M];
}

/// Every point of arrays of one length. What fills no group goes through as a group of its own, filled up with its last point, so that a
/// point gives the same bits wherever it stands.
#[inline(always)]
pub(crate) fn sweep<L: Lanes, E: Each<L, N, M>, const N: usize, const M: usize>(
    each: &E,
    from: [&[f64]; N],
    to: [&mut [f64]; M],
) {
    let n = from[0].len();
    let whole = n - n % GROUP;
    // Plain loops: what is handed closures is not always compiled for the kernel's instructions.
    let mut x = [L::splat(0.0); N];
    let mut i = 0;
    while i < whole {
        for k in 0..N {
            x[k] = L::load(&from[k][i..]);
        }
        let found = each.of(x);
        for k in 0..M {
            found[k].store(&mut to[k][i..]);
        }
        i += L::N;
    }
    if whole == n {
        return;
    }
    let mut last = [[0.0; GROUP]; N];
    let mut results = [[0.0; GROUP]; M];
    for k in 0..N {
        for j in 0..GROUP {
            last[k][j] = from[k][(whole + j).min(n - 1)];
        }
    }
    let mut i = 0;
    while i < GROUP {
        for k in 0..N {
            x[k] = L::load(&last[k][i..]);
        }
        let found = each.of(x);
        for k in 0..M {
            found[k].store(&mut results[k][i..]);
        }
        i += L::N;
    }
    for k in 0..M {
        to[k][whole..].copy_from_slice(&results[k][..n - whole]);
    }
}

struct AllFinite<'a>(&'a [f64]);

impl Kernel for AllFinite<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let whole = self.0.len() - self.0.len() % GROUP;
        // Of what is not finite the difference is NaN, and stays it in a sum.
        let mut sum = L::splat(0.0);
        let mut i = 0;
        while i < whole {
            let x = L::load(&self.0[i..]);
            sum = sum + (x - x);
            i += L::N;
        }
        L::all(sum.below(L::splat(1.0))) && self.0[whole..].iter().all(|x| x.is_finite())
    }
}

/// Whether no number is infinite or `NaN`.
pub(crate) fn all_finite(x: &[f64]) -> bool {
    run(AllFinite(x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::run_all;

    #[test]
    fn one_number_that_is_not_finite_is_seen_wherever_it_stands() {
        for n in [0, 1, 7, 8, 9, 40, 43] {
            let mut x: Vec<f64> = (0..n).map(|i| 1e308 * (i as f64).sin()).collect();
            assert!(all_finite(&x));
            for i in 0..n {
                for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    let good = std::mem::replace(&mut x[i], bad);
                    assert!(!all_finite(&x), "{bad} at {i} of {n}");
                    x[i] = good;
                }
            }
        }
    }

    /// Which point, and the larger and the smaller one of two numbers.
    struct Sorted;
    impl<L: Lanes> Each<L, 2, 3> for Sorted {
        #[inline(always)]
        fn of(&self, [a, b]: [L; 2]) -> [L; 3] {
            [a, a.at_least(b), a.at_most(b)]
        }
    }
    #[derive(Clone)]
    struct Sort(usize);
    impl Kernel for Sort {
        type Output = [Vec<f64>; 3];
        #[inline(always)]
        fn run<L: Lanes>(self) -> [Vec<f64>; 3] {
            let a: Vec<f64> = (0..self.0).map(|i| i as f64).collect();
            let b = vec![10.0; self.0];
            let mut to = [(); 3].map(|_| vec![-1.0; self.0]);
            sweep::<L, _, 2, 3>(&Sorted, [&a, &b], to.each_mut().map(|list| &mut list[..]));
            to
        }
    }

    #[test]
    fn every_point_of_any_number_is_visited_once_in_every_width() {
        for n in [0, 1, 7, 8, 9, 16, 29] {
            let list = |f: fn(f64) -> f64| (0..n).map(|i| f(i as f64)).collect::<Vec<_>>();
            let wanted = [list(|i| i), list(|i| i.max(10.0)), list(|i| i.min(10.0))];
            run_all(&Sort(n)).into_iter().for_each(|found| assert_eq!(found, wanted));
        }
    }
}
