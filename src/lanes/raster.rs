//! Grey levels of an image in its own depth, read window by window.

use super::{Greys, SINGLES};
use std::marker::PhantomData;

/// A grey level.
pub(crate) trait Level: Copy + Send + Sync {
    /// As a number.
    fn number(self) -> f32;
}

impl Level for u8 {
    #[inline(always)]
    fn number(self) -> f32 {
        f32::from(self)
    }
}

impl Level for u16 {
    #[inline(always)]
    fn number(self) -> f32 {
        f32::from(self)
    }
}

impl Level for f32 {
    #[inline(always)]
    fn number(self) -> f32 {
        self
    }
}

/// Samples of a row from which numbers are picked.
pub(crate) const LINE: usize = 2 * SINGLES;

/// Samples whose rows begin `stride` samples apart, read in windows of T rows of T samples.
#[derive(Clone, Copy)]
pub(crate) struct Raster<'a, S, const T: usize> {
    samples: &'a [S],
    stride: usize,
    /// Where the last window begins.
    last: usize,
}

/// What is left of one of its windows: rows of T samples are taken from above.
pub(crate) struct Window<'a, S, const T: usize> {
    next: *const S,
    left: usize,
    stride: usize,
    memory: PhantomData<&'a [S]>,
}

impl<'a, S: Level, const T: usize> Raster<'a, S, T> {
    /// `None` where the samples are fewer than those of one window.
    pub(crate) fn new(samples: &'a [S], stride: usize) -> Option<Self> {
        let span = stride.checked_mul(T - 1)?.checked_add(T)?;
        Some(Self { samples, stride, last: samples.len().checked_sub(span)? })
    }

    /// The window that begins at a sample.
    #[inline(always)]
    pub(crate) fn window(&self, start: usize) -> Window<'a, S, T> {
        assert!(start <= self.last);
        // SAFETY: inside the slice.
        Window { next: unsafe { self.samples.as_ptr().add(start) }, left: T, stride: self.stride, memory: PhantomData }
    }
}

/// Has the line with a sample brought near that is read soon, where there is one; nothing where the processor cannot be asked.
#[inline(always)]
pub(crate) fn fetch<S>(samples: &[S], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(sample) = samples.get(at) {
        // SAFETY: every processor of this kind can be asked; nothing is read.
        unsafe {
            std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(std::ptr::from_ref(sample).cast())
        };
    }
}

/// What is left of eight windows of eight rows.
pub(crate) struct Windows<'a, S> {
    next: [*const S; 8],
    left: usize,
    stride: usize,
    memory: PhantomData<&'a [S]>,
}

impl<'a, S: Level> Raster<'a, S, 8> {
    /// The windows that begin at eight samples.
    #[inline(always)]
    pub(crate) fn windows(&self, starts: [usize; 8]) -> Windows<'a, S> {
        let mut next = [self.samples.as_ptr(); 8];
        for k in 0..8 {
            assert!(starts[k] <= self.last);
            // SAFETY: inside the slice.
            next[k] = unsafe { next[k].add(starts[k]) };
        }
        Windows { next, left: 8, stride: self.stride, memory: PhantomData }
    }

    /// Samples from one row to the next.
    #[inline(always)]
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Number of the sample in a column and a row, whole numbers.
    #[inline(always)]
    pub(crate) fn sample(&self, column: f32, row: f32) -> usize {
        row as usize * self.stride + column as usize
    }

    /// Has a line brought near, as [`fetch`].
    #[inline(always)]
    pub(crate) fn fetch(&self, start: usize) {
        fetch(self.samples, start);
    }

    /// As many rows of thirty-two samples from one on; `None` where the image ends before.
    #[inline(always)]
    pub(crate) fn lines(&self, start: usize, rows: usize) -> Option<Window<'_, S, LINE>> {
        let end = start + (rows - 1) * self.stride + LINE;
        // SAFETY: what begins in front of `end` lies in the slice.
        (end <= self.samples.len()).then(|| Window {
            next: unsafe { self.samples.as_ptr().add(start) },
            left: rows,
            stride: self.stride,
            memory: PhantomData,
        })
    }
}

impl<S: Level, const T: usize> Window<'_, S, T> {
    // Pointers from row to row: multiples of the stride would be kept and read again for every window.
    #[inline(always)]
    fn row(&mut self) -> [S; T] {
        assert!(self.left > 0);
        self.left -= 1;
        // SAFETY: `Raster::window` or `Raster::lines` saw to it that all rows lie in the slice; the pointer may wrap behind the last.
        unsafe {
            let row = self.next.cast::<[S; T]>().read_unaligned();
            self.next = self.next.wrapping_add(self.stride);
            row
        }
    }
}

impl<S: Level> Windows<'_, S> {
    /// The next row of each.
    #[inline(always)]
    pub(crate) fn greys<G: Greys>(&mut self) -> [G; 8] {
        assert!(self.left > 0);
        self.left -= 1;
        let mut out = [G::splat(0.0); 8];
        for k in 0..8 {
            // SAFETY: as of one window.
            let row = unsafe { self.next[k].cast::<[S; 8]>().read_unaligned() };
            self.next[k] = self.next[k].wrapping_add(self.stride);
            out[k] = greys(row);
        }
        out
    }
}

/// Eight numbers of a list.
#[inline(always)]
fn greys<S: Level, G: Greys>(row: [S; 8]) -> G {
    let mut out = [0.0; 8];
    for i in 0..8 {
        out[i] = row[i].number();
    }
    G::load(&out)
}

/// Eight numbers of two lists of four.
#[inline(always)]
fn both<S: Level, G: Greys>(a: [S; 4], b: [S; 4]) -> G {
    let mut out = [0.0; 8];
    for i in 0..4 {
        out[i] = a[i].number();
        out[i + 4] = b[i].number();
    }
    G::load(&out)
}

impl<S: Level> Window<'_, S, LINE> {
    /// The next row.
    #[inline(always)]
    pub(crate) fn samples(&mut self) -> [S; LINE] {
        self.row()
    }
}

impl<S: Level> Window<'_, S, 4> {
    /// The next row of this window, then that of another.
    #[inline(always)]
    pub(crate) fn greys<G: Greys>(&mut self, other: &mut Self) -> G {
        both(self.row(), other.row())
    }
}

impl<S: Level> Window<'_, S, 2> {
    /// Both rows of this window, then both of another.
    #[inline(always)]
    pub(crate) fn greys<G: Greys>(mut self, mut other: Self) -> G {
        let ([a, b], [c, d]) = (self.row(), self.row());
        let ([e, f], [g, h]) = (other.row(), other.row());
        both([a, b, c, d], [e, f, g, h])
    }
}

impl<S: Level> Window<'_, S, 1> {
    /// The sample.
    #[inline(always)]
    pub(crate) fn number(mut self) -> f32 {
        self.row()[0].number()
    }
}
