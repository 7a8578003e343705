//! Numbers in somebody's memory: of any alignment, perhaps seen by others too.
//!
//! What a slice may not be a caller's memory can be: lists that are packed to single bytes, or that overlap. Numbers are read and written
//! one group at a time and never borrowed.

use super::Lanes;
use std::marker::PhantomData;

/// Numbers to read.
#[derive(Clone, Copy)]
pub(crate) struct Column<'a> {
    at: *const f64,
    len: usize,
    memory: PhantomData<&'a [f64]>,
}

/// Numbers to write.
pub(crate) struct ColumnMut<'a> {
    at: *mut f64,
    len: usize,
    memory: PhantomData<&'a mut [f64]>,
}

impl<'a> From<&'a [f64]> for Column<'a> {
    fn from(list: &'a [f64]) -> Self {
        Self { at: list.as_ptr(), len: list.len(), memory: PhantomData }
    }
}

impl<'a> From<&'a mut [f64]> for ColumnMut<'a> {
    fn from(list: &'a mut [f64]) -> Self {
        Self { at: list.as_mut_ptr(), len: list.len(), memory: PhantomData }
    }
}

impl Column<'_> {
    /// # Safety
    /// `len` numbers can be read at `at` as long as this lives; any alignment.
    pub(crate) unsafe fn new(at: *const f64, len: usize) -> Self {
        Self { at, len, memory: PhantomData }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    #[inline(always)]
    pub(crate) fn get(&self, i: usize) -> f64 {
        assert!(i < self.len);
        // SAFETY: inside the memory that `new` was told of.
        unsafe { self.at.add(i).read_unaligned() }
    }

    /// Number i and those after it, one per lane.
    #[inline(always)]
    pub(crate) fn lanes<L: Lanes>(&self, i: usize) -> L {
        assert!(i <= self.len && L::N <= self.len - i);
        // SAFETY: as above; lanes come in no wider types than this processor has (see the head of `x86`).
        unsafe { L::load_at(self.at.add(i)) }
    }

    /// `n` numbers from number `first` on.
    pub(crate) fn part(&self, first: usize, n: usize) -> Self {
        assert!(first <= self.len && n <= self.len - first);
        // SAFETY: inside the memory.
        Self { at: unsafe { self.at.add(first) }, len: n, ..*self }
    }
}

impl ColumnMut<'_> {
    /// # Safety
    /// `len` numbers can be read and written at `at` as long as this lives; any alignment.
    pub(crate) unsafe fn new(at: *mut f64, len: usize) -> Self {
        Self { at, len, memory: PhantomData }
    }

    #[inline(always)]
    pub(crate) fn get(&self, i: usize) -> f64 {
        assert!(i < self.len);
        // SAFETY: inside the memory that `new` was told of.
        unsafe { self.at.add(i).read_unaligned() }
    }

    #[inline(always)]
    pub(crate) fn set(&mut self, i: usize, x: f64) {
        assert!(i < self.len);
        // SAFETY: inside the memory.
        unsafe { self.at.add(i).write_unaligned(x) }
    }

    pub(crate) fn fill(&mut self, x: f64) {
        (0..self.len).for_each(|i| self.set(i, x));
    }

    /// Number i and those after it, one per lane.
    #[inline(always)]
    pub(crate) fn put<L: Lanes>(&mut self, i: usize, x: L) {
        assert!(i <= self.len && L::N <= self.len - i);
        // SAFETY: inside the memory; lanes as in `Column::lanes`.
        unsafe { x.store_at(self.at.add(i)) }
    }

    /// The same, `n` numbers from number `first` on.
    pub(crate) fn part(&mut self, first: usize, n: usize) -> ColumnMut<'_> {
        assert!(first <= self.len && n <= self.len - first);
        // SAFETY: inside the memory.
        ColumnMut { at: unsafe { self.at.add(first) }, len: n, memory: PhantomData }
    }
}
