//! Products and inverses of matrices with few columns, in tiles and rows as wide as the processor computes.
//!
//! ```text
//! Take:          S -= Y^T Y
//! InverseRoot:   R = L^-1, row k = (e_k - sum_(m < k) L_km row m) / L_kk;   (L L^T)^-1 = R^T R
//! ```

use crate::lanes::{GROUP, Kernel, Lanes};

/// Number of columns up to which tiles are used; beyond, blocked code is faster than its call is dear.
pub(super) const FEW: usize = 48;

/// Takes `Y^T Y` from the lower triangle of the n x n matrix `s`; `y` holds rows of Y, each filled up with zeros to whole groups. Every element is
/// summed over the rows in their order, whatever the width.
pub(super) struct Take<'a> {
    pub(super) y: &'a [f64],
    pub(super) s: &'a mut [f64],
    pub(super) n: usize,
}

impl Kernel for Take<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let width = self.n.next_multiple_of(GROUP);
        for j in (0..self.n).step_by(4) {
            // Tiles from the group on that holds the diagonal.
            for i in (j / L::N * L::N..self.n).step_by(L::N) {
                let mut tile = [L::splat(0.0); 4];
                for row in self.y.chunks_exact(width) {
                    let (left, right) = (L::load(&row[i..]), &row[j..j + 4]);
                    for b in 0..4 {
                        tile[b] = tile[b] + left * L::splat(right[b]);
                    }
                }
                for (b, tile) in tile.into_iter().enumerate().take(self.n - j) {
                    let mut sums = [0.0; GROUP];
                    tile.store(&mut sums);
                    let (column, rows) = (j + b, i.max(j + b)..(i + L::N).min(self.n));
                    rows.for_each(|r| self.s[column * self.n + r] -= sums[r - i]);
                }
            }
        }
    }
}

/// Writes the rows of `L^-1` of a lower n x n factor, which stands column by column, to `rows`: zeros that are filled up to whole groups.
pub(super) struct InverseRoot<'a> {
    pub(super) l: &'a [f64],
    pub(super) rows: &'a mut [f64],
    pub(super) n: usize,
}

impl Kernel for InverseRoot<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (n, width) = (self.n, self.n.next_multiple_of(GROUP));
        for k in 0..n {
            let (before, row) = self.rows.split_at_mut(k * width);
            row[k] = 1.0;
            let inverse = L::splat(1.0 / self.l[k * n + k]);
            for i in (0..=k).step_by(L::N) {
                let mut sum = L::load(&row[i..]);
                // Row m ends at its column m.
                for m in i..k {
                    sum = sum - L::splat(self.l[m * n + k]) * L::load(&before[m * width + i..]);
                }
                (sum * inverse).store(&mut row[i..]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes;

    /// Rows of Y with many zeros where they are filled up.
    fn rows(n: usize) -> Vec<f64> {
        let width = n.next_multiple_of(GROUP);
        (0..7 * width).map(|i| if i % width < n { ((i * 31) as f64).sin() } else { 0.0 }).collect()
    }

    #[derive(Clone)]
    struct Taken(usize);
    impl Kernel for Taken {
        type Output = Vec<f64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<f64> {
            let mut s = vec![1.0; self.0 * self.0];
            Take { y: &rows(self.0), s: &mut s, n: self.0 }.run::<L>();
            s
        }
    }

    #[test]
    fn tiles_take_the_product_from_the_lower_triangle_alone() {
        for n in [0, 1, 3, 8, 11, 22, FEW] {
            let (all, y) = (lanes::run_all(&Taken(n)), rows(n));
            for s in &all {
                assert_eq!(*s, all[0]);
            }
            let width = n.next_multiple_of(GROUP).max(1);
            for (at, s) in all[0].iter().enumerate() {
                let (i, j) = (at % n, at / n);
                let product: f64 = y.chunks_exact(width).map(|row| row[i] * row[j]).sum();
                let wanted = if i >= j { 1.0 - product } else { 1.0 };
                assert!((s - wanted).abs() < 1e-14, "{n}: {i} {j}");
            }
        }
    }

    #[derive(Clone)]
    struct Root(Vec<f64>, usize);
    impl Kernel for Root {
        type Output = Vec<f64>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<f64> {
            let n = self.1;
            let mut rows = vec![0.0; n * n.next_multiple_of(GROUP)];
            InverseRoot { l: &self.0, rows: &mut rows, n }.run::<L>();
            rows
        }
    }

    #[test]
    fn the_root_of_the_inverse_undoes_the_factor_in_all_widths() {
        for n in [0, 1, 3, 8, 11, 22, FEW] {
            // What stands above the diagonal is not read.
            let element = |i: usize, j: usize| {
                if i == j { 2.0 + (i as f64).cos() } else { ((7 * i + 3 * j) as f64).sin() / n as f64 }
            };
            let l: Vec<f64> =
                (0..n * n).map(|at| if at % n < at / n { f64::NAN } else { element(at % n, at / n) }).collect();
            let all = lanes::run_all(&Root(l, n));
            let width = n.next_multiple_of(GROUP);
            for one in &all {
                assert_eq!(*one, all[0]);
            }
            for i in 0..n {
                for j in 0..width {
                    let product: f64 = (0..=i).map(|k| element(i, k) * all[0][k * width + j]).sum();
                    let wanted = if i == j { 1.0 } else { 0.0 };
                    assert!((product - wanted).abs() < 1e-14, "{n}: {i} {j}: {product}");
                }
            }
        }
    }
}
