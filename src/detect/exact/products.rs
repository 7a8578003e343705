//! Products of the columns of many pixels.

use crate::lanes::{self, GROUP, Kernel, Lanes};

/// Pixels whose columns are stored before their products are taken: long enough that adding up the running sums costs little, few enough that 250
/// columns stay in the second cache.
pub(super) const CHUNK: usize = 256;
/// Columns of a tile on either side: numbers once loaded serve all of them.
const TILE: usize = 4;

/// Adds the products of the first `used` entries of all pairs of `n` columns to the lower triangle, row by row; `used` is a multiple of [`GROUP`].
pub(super) struct Products<'a> {
    pub(super) columns: &'a [f64],
    pub(super) used: usize,
    pub(super) n: usize,
    pub(super) gram: &'a mut [f64],
}

impl Kernel for Products<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let whole = self.n / TILE * TILE;
        for first in (0..whole).step_by(TILE) {
            for second in (0..=first).step_by(TILE) {
                self.tile::<L, TILE, TILE>(first, second);
            }
        }
        for first in whole..self.n {
            for second in (0..whole).step_by(TILE) {
                self.tile::<L, 1, TILE>(first, second);
            }
            for second in whole..=first {
                self.tile::<L, 1, 1>(first, second);
            }
        }
    }
}

impl Products<'_> {
    /// Those of `A` columns from `first` on with `B` columns from `second` on.
    #[inline(always)]
    fn tile<L: Lanes, const A: usize, const B: usize>(&mut self, first: usize, second: usize) {
        let (columns, used) = (self.columns, self.used.min(CHUNK));
        let mut sums = [[[0.0; GROUP]; B]; A];
        let mut part = 0;
        while part < GROUP {
            let mut running = [[L::splat(0.0); B]; A];
            let mut at = part;
            while at < used {
                let mut right = [L::splat(0.0); B];
                for l in 0..B {
                    right[l] = L::load(&columns[(second + l) * CHUNK + at..]);
                }
                for k in 0..A {
                    let left = L::load(&columns[(first + k) * CHUNK + at..]);
                    for l in 0..B {
                        running[k][l] = left.fused(right[l], running[k][l]);
                    }
                }
                at += GROUP;
            }
            for k in 0..A {
                for l in 0..B {
                    running[k][l].store(&mut sums[k][l][part..]);
                }
            }
            part += L::N;
        }
        for k in 0..A {
            for l in 0..B {
                let (i, j) = (first + k, second + l);
                if j <= i {
                    self.gram[i * self.n + j] += lanes::sum(&sums[k][l]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone)]
    struct Made {
        columns: Vec<f64>,
        used: usize,
        n: usize,
    }
    impl Kernel for Made {
        type Output = Vec<u64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u64> {
            let mut gram = vec![1.0; self.n * self.n];
            Products { columns: &self.columns, used: self.used, n: self.n, gram: &mut gram }.run::<L>();
            gram.into_iter().map(f64::to_bits).collect()
        }
    }

    #[test]
    fn products_are_those_of_plain_sums_and_all_widths_agree() {
        for (n, used) in [(19, 64), (4, 8), (22, CHUNK)] {
            let columns: Vec<f64> = (0..n * CHUNK).map(|i| (i as f64 * 0.618).fract() - 0.4).collect();
            let all = lanes::run_all(&Made { columns: columns.clone(), used, n });
            all.iter().for_each(|one| assert_eq!(*one, all[0]));
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let plain: f64 = (0..used).map(|p| columns[i * CHUNK + p] * columns[j * CHUNK + p]).sum();
                let expected = if j <= i { 1.0 + plain } else { 1.0 };
                assert!((f64::from_bits(all[0][i * n + j]) - expected).abs() < 1e-12, "{i} {j}");
            }
        }
    }
}
