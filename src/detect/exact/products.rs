//! Products of the columns of many pixels.

use crate::lanes::{Kernel, Lanes, dots};

/// Pixels whose columns are stored before their products are taken: long enough that adding up the running sums costs little.
pub(super) const CHUNK: usize = 256;
/// Columns of a tile on either side: numbers once loaded serve all of them.
const ROWS: usize = 4;
const TILE: usize = 3;
/// Columns that stay in the second cache while all others pass by; a multiple of `ROWS` and `TILE`.
const BLOCK: usize = 48;

/// Adds the products of the first `used` entries of all pairs of `n` columns to the lower triangle, row by row.
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
        for block in (0..self.n).step_by(BLOCK) {
            let end = (block + BLOCK).min(self.n);
            let mut first = block;
            while first + ROWS <= self.n {
                self.row::<L, ROWS>(first, (block, end));
                first += ROWS;
            }
            for first in first..self.n {
                self.row::<L, 1>(first, (block, end));
            }
        }
    }
}

impl Products<'_> {
    /// Those of `A` columns from `first` on with all of a block that do not lie behind them.
    #[inline(always)]
    fn row<L: Lanes, const A: usize>(&mut self, first: usize, (block, end): (usize, usize)) {
        let end = end.min(first + A);
        let mut second = block;
        while second + TILE <= end {
            self.tile::<L, A, TILE>(first, second);
            second += TILE;
        }
        for second in second..end {
            self.tile::<L, A, 1>(first, second);
        }
    }

    /// Those of `A` columns from `first` on with `B` columns from `second` on.
    #[inline(always)]
    fn tile<L: Lanes, const A: usize, const B: usize>(&mut self, first: usize, second: usize) {
        let (columns, used) = (self.columns, self.used.min(CHUNK));
        let (mut left, mut right) = ([columns; A], [columns; B]);
        for k in 0..A {
            left[k] = &columns[(first + k) * CHUNK..][..used];
        }
        for l in 0..B {
            right[l] = &columns[(second + l) * CHUNK..][..used];
        }
        let sums = dots::<L, A, B>(left, right);
        for k in 0..A {
            for l in 0..B {
                let (i, j) = (first + k, second + l);
                if j <= i {
                    self.gram[i * self.n + j] += sums[k][l];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes;

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
        for (n, used) in [(19, 64), (4, 8), (22, CHUNK), (101, 40)] {
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
