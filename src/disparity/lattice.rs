//! Where windows lie: on a regular lattice, centred in the field.

/// Windows of one size, x fastest, from the top down.
pub(super) struct Lattice {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) first_px: [usize; 2],
    pub(super) window_px: usize,
    pub(super) step_px: usize,
}

impl Lattice {
    /// As many as a field of this size holds; none where it is smaller than a window.
    pub(super) fn centred(size_px: [usize; 2], window_px: usize, step_px: usize) -> Self {
        let count = |n: usize| n.checked_sub(window_px).map_or(0, |rest| rest / step_px + 1);
        let first = |n: usize| n.saturating_sub(window_px + count(n).saturating_sub(1) * step_px) / 2;
        let [columns, rows] = size_px.map(count);
        Self { columns, rows, first_px: size_px.map(first), window_px, step_px }
    }

    pub(super) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// First pixel of a window.
    pub(super) fn corner(&self, k: usize) -> [usize; 2] {
        [self.first_px[0] + (k % self.columns) * self.step_px, self.first_px[1] + (k / self.columns) * self.step_px]
    }

    /// Middle of a window.
    pub(super) fn middle(&self, k: usize) -> [f64; 2] {
        self.corner(k).map(|c| c as f64 + 0.5 * (self.window_px - 1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_fill_the_field_and_leave_as_much_on_either_side() {
        let l = Lattice::centred([103, 64], 32, 16);
        assert_eq!([l.columns, l.rows, l.len()], [5, 3, 15]);
        assert_eq!((l.corner(0), l.corner(14), l.middle(0)), ([3, 0], [67, 32], [18.5, 15.5]));
        assert_eq!(Lattice::centred([103, 20], 32, 16).len(), 0);
    }
}
