//! Structures of arrays, several points at a time.

use super::{Column, ColumnMut, GROUP, Lanes, Several, Twice};

/// What is done with one point of N numbers; it gives M. `of` has to be `#[inline(always)]`.
pub(crate) trait Each<L, const N: usize, const M: usize> {
    /// The results; lanes never look at each other.
    fn of(&self, x: [L; N]) -> [L; M];
}

/// Every point of columns of one length; whether all that was found is finite (`false` also where only a sum of it is not). The same work
/// twice as wide, `pair`, goes as far as it can. What fills no group goes through as a group of its own, filled up with its last point, so that a
/// point gives the same bits wherever it stands.
#[inline(always)]
pub(crate) fn sweep<L: Lanes, P: Each<Twice<L>, N, M>, E: Each<L, N, M>, const N: usize, const M: usize>(
    pair: &P,
    each: &E,
    from: [Column; N],
    mut to: [ColumnMut; M],
) -> bool {
    let n = from[0].len();
    let whole = n - n % GROUP;
    // Plain loops: what is handed closures is not always compiled for the kernel's instructions.
    let mut x = [Twice::<L>::splat(0.0); N];
    let mut all = Twice::<L>::splat(0.0);
    let mut i = 0;
    // List by list: lists that lie a power of two apart take each other's lines of the cache, which the next group would read anew.
    while i + Twice::<L>::N <= whole {
        for k in 0..N {
            x[k] = from[k].lanes(i);
        }
        let found = pair.of(x);
        for k in 0..M {
            to[k].put(i, found[k]);
        }
        all = all + not_finite(found);
        i += Twice::<L>::N;
    }
    let finite = Twice::<L>::all(all.below(Twice::<L>::splat(1.0)));
    let mut x = [L::splat(0.0); N];
    let mut all = L::splat(0.0);
    while i < whole {
        for k in 0..N {
            x[k] = from[k].lanes(i);
        }
        let found = each.of(x);
        for k in 0..M {
            to[k].put(i, found[k]);
        }
        all = all + not_finite(found);
        i += L::N;
    }
    if whole < n {
        let mut last = [[0.0; GROUP]; N];
        let mut results = [[0.0; GROUP]; M];
        for k in 0..N {
            for j in 0..GROUP {
                last[k][j] = from[k].get((whole + j).min(n - 1));
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
            all = all + not_finite(found);
            i += L::N;
        }
        for k in 0..M {
            for j in whole..n {
                to[k].set(j, results[k][j - whole]);
            }
        }
    }
    finite & L::all(all.below(L::splat(1.0)))
}

/// Zero of either sign, or `NaN` where a number or their sum is not finite.
#[inline(always)]
fn not_finite<L: Lanes, const M: usize>(found: [L; M]) -> L {
    let mut sum = found[0];
    for k in 1..M {
        sum = sum + found[k];
    }
    // Infinity times zero is no number either.
    sum * L::splat(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, run_all};

    /// Which point, and the larger and the smaller one of two numbers; the second where it is no number.
    struct Sorted;
    impl<L: Lanes> Each<L, 2, 3> for Sorted {
        #[inline(always)]
        fn of(&self, [a, b]: [L; 2]) -> [L; 3] {
            [a, a.at_least(b), a.at_most(b)]
        }
    }
    /// So many points, one of them perhaps not finite, in memory of whatever alignment.
    #[derive(Clone)]
    struct Sort(usize, Option<(usize, f64)>, usize);
    impl Kernel for Sort {
        type Output = ([Vec<f64>; 3], bool);
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let Sort(n, odd, shift) = self;
            let mut bytes = vec![0u8; 8 * 5 * n + 8];
            let at = |bytes: &mut Vec<u8>, k: usize| bytes[shift + 8 * n * k..].as_mut_ptr().cast::<f64>();
            let all = [0, 1, 2, 3, 4].map(|k| at(&mut bytes, k));
            // SAFETY: five lists of n numbers have room behind the shift.
            let (from, mut to) = unsafe {
                let mut input = [0, 1].map(|k| ColumnMut::new(all[k], n));
                for i in 0..n {
                    input[0].set(i, i as f64);
                    input[1].set(i, odd.filter(|o| o.0 == i).map_or(10.0, |o| o.1));
                }
                ([0, 1].map(|k| Column::new(all[k], n)), [2, 3, 4].map(|k| ColumnMut::new(all[k], n)))
            };
            let finite = sweep::<L, _, _, 2, 3>(&Sorted, &Sorted, from, to.each_mut().map(|list| list.part(0, n)));
            (to.map(|list| (0..n).map(|i| list.get(i)).collect()), finite)
        }
    }

    #[test]
    fn every_point_of_any_number_is_visited_once_in_every_width_and_alignment() {
        for n in [0, 1, 7, 8, 9, 16, 29] {
            let list = |f: fn(f64) -> f64| (0..n).map(|i| f(i as f64)).collect::<Vec<_>>();
            let wanted = [list(|i| i), list(|i| i.max(10.0)), list(|i| i.min(10.0))];
            for shift in [0, 1, 5] {
                run_all(&Sort(n, None, shift)).into_iter().for_each(|found| assert_eq!(found, (wanted.clone(), true)));
            }
        }
    }

    #[test]
    fn one_number_that_is_not_finite_is_seen_wherever_it_stands() {
        for n in [1, 7, 8, 9, 40, 43] {
            for i in 0..n {
                for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    assert!(
                        run_all(&Sort(n, Some((i, bad)), 0)).into_iter().all(|found| !found.1),
                        "{bad} at {i} of {n}"
                    );
                }
            }
        }
    }
}
