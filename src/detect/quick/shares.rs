//! What a fit leaves of the grey values, shared out among the sectors of the contour.

use super::columns::{BLOCK, Columns};
use super::{ALL, M, N};
use crate::detect::contour::Contour;
use crate::detect::exact::Share;
use crate::lanes::{Kernel, Lanes, SINGLES, Several};

/// Shares out what the columns times the unknowns `found`, each at the place of its column, leave of the first `count` grey values.
pub(super) struct ShareOut<'a> {
    pub(super) columns: &'a mut Columns,
    pub(super) found: &'a [f64; ALL],
    pub(super) bent: bool,
    pub(super) count: usize,
    pub(super) contour: &'a Contour,
    pub(super) shares: &'a mut [Share],
}

impl Kernel for ShareOut<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { columns, found, bent, count, contour, shares } = self;
        leave::<L>(columns, found, bent, count);
        let Columns { diamond, response, left, cell, .. } = columns;
        if cell.len() < count {
            cell.resize(count, 0);
        }
        let (diamond, response, left) = (&diamond[..count], &response[..count], &left[..count]);
        let cell = &mut cell[..count];
        let cells_per_angle = contour.cells_per_angle() as f32;
        for i in 0..count {
            // Neither negative nor large: converted as a signed number, several at once.
            cell[i] = (diamond[i] * cells_per_angle) as i32 as u32;
        }
        // Neighbours mostly go to one sector, whose sums would wait for each other: pixels of the upper and the lower half in turns.
        let half = count.div_ceil(2);
        for k in 0..count {
            let i = k / 2 + (k % 2) * half;
            let sector = contour.sector_from(cell[i] as usize, f64::from(diamond[i]));
            shares[sector].push(f64::from(response[i]), f64::from(left[i]), 1.0);
        }
    }
}

#[inline(always)]
fn leave<L: Lanes>(columns: &mut Columns, found: &[f64; ALL], bent: bool, count: usize) {
    let Columns { values, left, .. } = columns;
    let n = count.div_ceil(SINGLES) * SINGLES;
    if left.len() < n {
        left.resize(n, 0.0);
    }
    let mut less = [L::Single::splat(0.0); ALL];
    for k in 0..ALL {
        less[k] = L::Single::splat(-found[k] as f32);
    }
    let mut at = 0;
    while at < n {
        let (block, i) = (&values[at / BLOCK], at % BLOCK);
        let mut sum = L::Single::load(&block[N][i..]);
        for k in 0..N {
            sum = less[k].fused(L::Single::load(&block[k][i..]), sum);
        }
        if bent {
            for k in M..ALL {
                sum = less[k].fused(L::Single::load(&block[k][i..]), sum);
            }
        }
        sum.store(&mut left[at..]);
        at += L::Single::N;
    }
}
