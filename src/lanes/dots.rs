//! Sums of products of lists, several at a time: a number once loaded serves all lists of the other side.

use super::{GROUP, Lanes, sum};

/// Sums of products of each list of `left` with each of `right`; all as long. Twelve sums fit the sixteen registers of AVX2.
#[inline(always)]
pub(crate) fn dots<L: Lanes, const A: usize, const B: usize>(left: [&[f64]; A], right: [&[f64]; B]) -> [[f64; B]; A] {
    let n = left[0].len();
    let whole = n / GROUP * GROUP;
    let mut sums = [[[0.0; GROUP]; B]; A];
    let mut part = 0;
    while part < GROUP && whole > 0 {
        let mut running = [[L::splat(0.0); B]; A];
        let mut at = part;
        while at < whole {
            let mut others = [L::splat(0.0); B];
            for l in 0..B {
                others[l] = L::load(&right[l][at..]);
            }
            for k in 0..A {
                let one = L::load(&left[k][at..]);
                for l in 0..B {
                    running[k][l] = one.fused(others[l], running[k][l]);
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
    let mut out = [[0.0; B]; A];
    for k in 0..A {
        for l in 0..B {
            for i in whole..n {
                sums[k][l][i - whole] = left[k][i].mul_add(right[l][i], sums[k][l][i - whole]);
            }
            out[k][l] = sum(&sums[k][l]);
        }
    }
    out
}
