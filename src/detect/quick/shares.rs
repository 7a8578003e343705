//! What a fit leaves of the grey values, shared out among the sectors of the contour.
//!
//! Sums over the ten or twenty pixels of a sector are in single precision: what they are wrong by is a millionth of what they say.

use super::columns::{BLOCK, Columns};
use super::{ALL, M, N};
use crate::detect::contour::Contour;
use crate::detect::exact::Share;
use crate::lanes::{Kernel, Lanes, SINGLES, Several};

/// Added to a number between 0 and 2^22 it leaves the nearest whole one in these bits.
const WHOLE: f32 = 12_582_912.0;
const WHOLE_BITS: u32 = 0x3f_ffff;

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
        let Columns { diamond, response, left, cell, terms, sums, .. } = columns;
        if cell.len() < count {
            cell.resize(count, 0);
        }
        let (diamond, response, left) = (&diamond[..count], &response[..count], &left[..count]);
        let cell = &mut cell[..count];
        let cells_per_angle = contour.cells_per_angle() as f32;
        for i in 0..count {
            // Neither negative nor large: half less and rounded by what single precision can hold, several at once. At the end of a cell it
            // may be the one before, which knows the sector of its end as well.
            cell[i] = (diamond[i] * cells_per_angle - 0.5 + WHOLE).to_bits() & WHOLE_BITS;
        }
        if terms.len() < count {
            terms.resize(count, [0.0; 4]);
        }
        let terms = &mut terms[..count];
        for i in 0..count {
            terms[i] = [response[i] * left[i], response[i] * response[i], left[i] * left[i], 1.0];
        }
        sums.clear();
        sums.resize(shares.len(), [0.0; 4]);
        let (cells, of_sectors) = (contour.cells(), &mut sums[..]);
        let mut add = |cell: u32, diamond: f32, term: &[f32; 4]| {
            let sum = &mut of_sectors[cells.sector(cell as usize, f64::from(diamond))];
            for k in 0..4 {
                sum[k] += term[k];
            }
        };
        // Neighbours mostly go to one sector, whose sums would wait for each other: pixels of the upper and the lower half in turns.
        let half = count / 2;
        let ((c0, c1), (d0, d1), (t0, t1)) = (cell.split_at(half), diamond.split_at(half), terms.split_at(half));
        for ((c, d), t) in (c0.iter().zip(c1)).zip(d0.iter().zip(d1)).zip(t0.iter().zip(t1)) {
            add(*c.0, *d.0, t.0);
            add(*c.1, *d.1, t.1);
        }
        if count % 2 == 1 {
            add(c1[half], d1[half], &t1[half]);
        }
        for (share, sum) in shares.iter_mut().zip(sums) {
            share.add(sum.map(f64::from));
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
