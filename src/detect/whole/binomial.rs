//! The binomial blur of rows of whole numbers.

use super::Rows;
use crate::detect::plane::repeat_ends;
use crate::image::Samples;
use crate::lanes::{Kernel, Lanes};

/// Blurs rows from `first` on, as many as `out` has room for.
pub(super) struct Smooth<'a> {
    pub(super) rows: Rows<'a>,
    pub(super) first: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) out: &'a mut [u16],
    /// Every second pixel of the rows with an even number, for the next level; no room where there is none.
    pub(super) halved: &'a mut [u16],
    /// For rows of this width.
    pub(super) blur: &'a mut Blur,
}

impl Kernel for Smooth<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { rows, first, width, height, out, halved, blur } = self;
        let mut halves = halved.chunks_exact_mut(width.div_ceil(2));
        for (v, out) in (first..).zip(out.chunks_exact_mut(width)) {
            blur.row(rows, v, height, out);
            // While it is near.
            if v.is_multiple_of(2)
                && let Some(half) = halves.next()
            {
                halve(out, half);
            }
        }
    }
}

/// Every second number of a row, its first and, of an odd row, its last among them.
#[inline(always)]
fn halve(row: &[u16], half: &mut [u16]) {
    // Whole pairs in a plain loop, for vectors.
    let pairs = row.chunks_exact(2);
    if let ([last], Some(o)) = (pairs.remainder(), half.last_mut()) {
        *o = *last;
    }
    for (o, x) in half.iter_mut().zip(pairs) {
        *o = x[0];
    }
}

/// A row blurred down the columns, used again from row to row.
pub(super) struct Blur {
    narrow: Vec<u16>,
    wide: Vec<u32>,
}

impl Blur {
    pub(super) fn new(width: usize) -> Self {
        Self { narrow: vec![0; width + 4], wide: vec![0; width + 4] }
    }

    /// Row `v` of the blurred image.
    #[inline(always)]
    fn row(&mut self, rows: Rows, v: usize, height: usize, out: &mut [u16]) {
        let (width, last) = (out.len(), height - 1);
        let near = [v.saturating_sub(2), v.saturating_sub(1), v, (v + 1).min(last), (v + 2).min(last)];
        match rows {
            Rows::Samples(view, shift) => match view.samples() {
                Samples::U8(s) => self.of_bytes(near.map(|k| &s[k * view.stride()..][..width]), out),
                Samples::U16(s) => self.of_wide(near.map(|k| &s[k * view.stride()..][..width]), shift, out),
                // `rows` makes none of these.
                Samples::F32(_) => {}
            },
            Rows::Finer(finer) => self.of_wide(near.map(|k| &finer.halved[k * width..][..width]), 0, out),
        }
    }

    /// Bytes: every sum fits 16 bits, and the last one is the result in units of 1/256.
    #[inline(always)]
    fn of_bytes(&mut self, r: [&[u8]; 5], out: &mut [u16]) {
        let n = self.narrow.len() - 4;
        let (r0, r1, r2, r3, r4) = (&r[0][..n], &r[1][..n], &r[2][..n], &r[3][..n], &r[4][..n]);
        // One end for all lists, so that nothing is left over of whole vectors.
        let rows = r0.iter().zip(r1).zip(r2).zip(r3).zip(r4);
        for (o, ((((a, b), c), d), e)) in self.narrow[2..n + 2].iter_mut().zip(rows) {
            let (outer, inner) = (u16::from(*a) + u16::from(*e), u16::from(*b) + u16::from(*d));
            *o = outer + 4 * inner + 6 * u16::from(*c);
        }
        repeat_ends(&mut self.narrow, 2);
        let c = &self.narrow;
        let beside = c[..n].iter().zip(&c[1..=n]).zip(&c[2..n + 2]).zip(&c[3..n + 3]).zip(&c[4..n + 4]);
        for (o, ((((a, b), c), d), e)) in out[..n].iter_mut().zip(beside) {
            *o = a + e + 4 * (b + d) + 6 * c;
        }
    }

    /// Sixteen bits, times two to the power `shift`: sums of 32, rounded.
    #[inline(always)]
    fn of_wide(&mut self, r: [&[u16]; 5], shift: u32, out: &mut [u16]) {
        let n = self.wide.len() - 4;
        let (r0, r1, r2, r3, r4) = (&r[0][..n], &r[1][..n], &r[2][..n], &r[3][..n], &r[4][..n]);
        let rows = r0.iter().zip(r1).zip(r2).zip(r3).zip(r4);
        for (o, ((((a, b), c), d), e)) in self.wide[2..n + 2].iter_mut().zip(rows) {
            let (outer, inner) = (u32::from(*a) + u32::from(*e), u32::from(*b) + u32::from(*d));
            *o = (outer + 4 * inner + 6 * u32::from(*c)) << shift;
        }
        repeat_ends(&mut self.wide, 2);
        let c = &self.wide;
        let beside = c[..n].iter().zip(&c[1..=n]).zip(&c[2..n + 2]).zip(&c[3..n + 3]).zip(&c[4..n + 4]);
        for (o, ((((a, b), c), d), e)) in out[..n].iter_mut().zip(beside) {
            *o = ((a + e + 4 * (b + d) + 6 * c + 128) >> 8) as u16;
        }
    }
}
