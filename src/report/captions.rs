//! Words on a picture, where they cover neither lines nor each other; those without room are counted.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | - | `Room::taken` | | cells of `CELL` x `CELL` px that a line or words are on |

use super::overlay::{OverlayShapes, cross_px, ellipse_points};

/// Side of a cell, px.
const CELL: f64 = 4.0;

/// Words and where they stand.
pub(super) struct Caption<'a> {
    /// Left upper corner, px.
    pub(super) at_px: [f64; 2],
    pub(super) text: &'a str,
    /// Whether they say why a candidate was turned down.
    pub(super) reason: bool,
}

/// Names and reasons, in letters of this width and height, with lines of this thickness, px, beside the notes in the left lower corner; and how
/// many of them have no room.
pub(super) fn arrange(
    shapes: &OverlayShapes,
    (width, height): (usize, usize),
    notes_px: [f64; 2],
    letter_px: [f64; 2],
    line_px: f64,
) -> (Vec<Caption<'_>>, usize) {
    let mut room = Room::new(width, height);
    room.reserve(notes_px);
    room.lines_of(shapes, line_px);
    let names = shapes.labels.iter().map(|l| (l.at_px, l.reach_px, l.text.as_str(), false));
    let reasons = shapes.rejected.iter().map(|m| (m.at_px, cross_px(m, line_px), m.reason.as_str(), true));
    let (mut placed, mut silent) = (Vec::new(), 0);
    for (about_px, reach_px, text, reason) in names.chain(reasons) {
        let size = [letter_px[0] * text.chars().count() as f64, letter_px[1]];
        match room.place(about_px, reach_px + CELL + line_px, size) {
            Some(at_px) => placed.push(Caption { at_px, text, reason }),
            None => silent += 1,
        }
    }
    (placed, silent)
}

/// Which parts of a picture are free.
pub(super) struct Room {
    columns: usize,
    rows: usize,
    taken: Vec<bool>,
}

impl Room {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let count = |size: usize| (size as f64 / CELL).ceil() as usize;
        let (columns, rows) = (count(width), count(height));
        Self { columns, rows, taken: vec![false; columns * rows] }
    }

    /// Cells of a rectangle; none where it leaves the picture.
    fn cells(&self, [left, top]: [f64; 2], [width, height]: [f64; 2]) -> Option<[usize; 4]> {
        let (right, bottom) = ((left + width) / CELL, (top + height) / CELL);
        let within = left >= 0.0 && top >= 0.0 && right < self.columns as f64 && bottom < self.rows as f64;
        within.then_some([(left / CELL) as usize, (top / CELL) as usize, right as usize, bottom as usize])
    }

    /// Nothing else stands in a rectangle in the left lower corner.
    fn reserve(&mut self, [width, height]: [f64; 2]) {
        let (columns, rows) = ((width / CELL).ceil() as usize, (height / CELL).ceil() as usize);
        for row in self.rows.saturating_sub(rows)..self.rows {
            self.taken[row * self.columns..][..columns.min(self.columns)].fill(true);
        }
    }

    /// A line is drawn along these points.
    fn line(&mut self, points: impl Iterator<Item = [f64; 2]>, closed: bool) {
        let (mut first, mut before): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
        for point in points {
            self.stretch(before.unwrap_or(point), point);
            first.get_or_insert(point);
            before = Some(point);
        }
        if let (true, Some(a), Some(b)) = (closed, before, first) {
            self.stretch(a, b);
        }
    }

    fn stretch(&mut self, a: [f64; 2], b: [f64; 2]) {
        // What lies far off the picture, or nowhere, is not followed.
        let size = (self.columns + self.rows) as f64 * CELL;
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        if !(length <= 2.0 * size) {
            return;
        }
        let steps = (length / CELL).ceil().max(1.0);
        for i in 0..=steps as usize {
            let k = i as f64 / steps;
            if let Some([column, row, ..]) = self.cells([a[0] + k * (b[0] - a[0]), a[1] + k * (b[1] - a[1])], [0.0; 2])
            {
                self.taken[row * self.columns + column] = true;
            }
        }
    }

    fn lines_of(&mut self, shapes: &OverlayShapes, line_px: f64) {
        for line in shapes.contours.iter().chain(&shapes.predicted).chain(&shapes.lines) {
            self.line(line.points(), line.closed);
        }
        for ellipse in &shapes.ellipses {
            self.line(ellipse_points(ellipse).into_iter(), true);
        }
        for mark in &shapes.rejected {
            let (at, r) = (mark.at_px, cross_px(mark, line_px));
            for slope in [-r, r] {
                self.line([[at[0] - r, at[1] - slope], [at[0] + r, at[1] + slope]].into_iter(), false);
            }
        }
    }

    /// Takes a rectangle where all of it is free.
    fn take(&mut self, at: [f64; 2], size: [f64; 2]) -> bool {
        let Some([left, top, right, bottom]) = self.cells(at, size) else { return false };
        let row = |row: usize| row * self.columns + left..row * self.columns + right + 1;
        if (top..=bottom).any(|y| self.taken[row(y)].contains(&true)) {
            return false;
        }
        (top..=bottom).for_each(|y| self.taken[row(y)].fill(true));
        true
    }

    /// Left upper corner for a rectangle: in the middle of what it is about, below, above, right or left of it, where there is room first.
    pub(super) fn place(&mut self, [x, y]: [f64; 2], reach: f64, size: [f64; 2]) -> Option<[f64; 2]> {
        let (left, top) = (x - 0.5 * size[0], y - 0.5 * size[1]);
        let (above, before) = (y - reach - size[1], x - reach - size[0]);
        let places = [[left, top], [left, y + reach], [left, above], [x + reach, top], [before, top]];
        places.into_iter().find(|at| self.take(*at, size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_stand_where_there_is_room_and_nowhere_else() {
        let mut room = Room::new(200, 100);
        let size = [40.0, 8.0];
        assert!(room.take([80.0, 40.0], size));
        assert!(!room.take([100.0, 44.0], size), "on other words");
        assert!(room.take([80.0, 60.0], size));
        assert!(!room.take([-1.0, 0.0], size) && !room.take([170.0, 0.0], size), "beyond the picture");
        room.line([[0.0, 80.0], [199.0, 80.0]].into_iter(), false);
        assert!(!room.take([20.0, 76.0], size), "on a line");
        assert!(room.take([20.0, 86.0], size));
        room.line([[f64::NAN, 1e300], [1e300, 5.0], [-1e9, 5.0]].into_iter(), true);
        assert!(room.take([0.0, 0.0], size), "what is nowhere takes no room");
    }

    #[test]
    fn nothing_stands_on_the_notes() {
        for (side, kept) in [(200, 60.0), (40, 60.0)] {
            let mut room = Room::new(side, 100);
            room.reserve([kept, 20.0]);
            assert!(!room.take([4.0, 74.0], [30.0, 8.0]) && room.take([4.0, 66.0], [30.0, 8.0]));
            assert_eq!(room.take([64.0, 84.0], [40.0, 8.0]), side == 200);
        }
    }

    #[test]
    fn what_has_no_room_is_counted() {
        use crate::report::{Label, RejectedMark};
        let mut shapes = OverlayShapes::default();
        for i in 0..40 {
            let at_px = [100.0 + f64::from(i), 50.0];
            shapes.labels.push(Label { at_px, reach_px: 2.0, text: i.to_string() });
        }
        shapes.rejected.push(RejectedMark { at_px: [100.0, 80.0], radius_px: 5.0, reason: "too faint".into() });
        let (placed, silent) = arrange(&shapes, (200, 100), [0.0; 2], [8.0, 8.0], 1.0);
        assert_eq!(placed.len() + silent, 41);
        assert!(silent > 0 && placed.iter().filter(|c| c.reason).count() == 1);
        let apart = |a: &Caption, b: &Caption| {
            let wide = |c: &Caption| 8.0 * c.text.len() as f64;
            let (dx, dy) = (b.at_px[0] - a.at_px[0], (b.at_px[1] - a.at_px[1]).abs());
            dy >= 8.0 || dx >= wide(a) || -dx >= wide(b)
        };
        for (i, a) in placed.iter().enumerate() {
            assert!(placed[..i].iter().all(|b| apart(a, b)), "{} covers other words", a.text);
        }
    }
}
