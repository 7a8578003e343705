//! From discs in no order to discs that know their place on the target.
//!
//! A printed dot is a circle, so its ellipse says how the plane is foreshortened around it: divided by the square root
//! of the local shape matrix, a square lattice is square again, however oblique the view. There a lattice is found by
//! its nearest neighbours (`lattice`), grown cell by cell with a prediction fitted to the labelled neighbourhood, and
//! every dot that its neighbours do not predict is dropped. Marks then fix origin and axes (`grid`, `plate`).
//!
//! | symbol | identifier | shape | unit | frame | meaning |
//! |---|---|---|---|---|---|
//! | M | `shape` | 2x2 | px^2 | `Sensor` | `R diag(a^2, b^2) R'` of an ellipse |
//! | d' = M^-1/2 d | `rounded` | 2 | radii | - | a difference of positions with the foreshortening taken out |
//! | (i, j) | cell | 2 | pitch | lattice | as found; j is left of i for the viewer, as target y is of target x |
//!
//! The front of a target is seen, never its back: a lattice found is right-handed for the viewer, and a set of marks that
//! fits only as a mirror image is refused.
//!
//! Where it is not valid: fewer than two rows or columns; lens distortion so strong that a pitch changes by more than a
//! fifth from one cell to the next; dots whose ellipse is too poor to show the foreshortening (semi-axes below about 1 px).

mod dots;
mod grid;
mod lattice;
mod pair;
mod plate;

use super::{Detection, LabelledDisc, missing_words};
use crate::error::{Insufficient, Result};
use crate::target::{DotId, Target};

/// Another labelling that the image allows: `id' = turn(id) + shift`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Relabelling {
    /// Quarter turns from target x to target y, 0 to 3.
    pub quarter_turns: u8,
    /// Added to the turned column.
    pub columns: i32,
    /// Added to the turned row.
    pub rows: i32,
    /// Whether the level follows from the parity of the column (two-level plate).
    pub two_levels: bool,
}

impl Relabelling {
    /// No change.
    pub const NONE: Self = Self { quarter_turns: 0, columns: 0, rows: 0, two_levels: false };

    /// First `self`, then `next`.
    pub fn then(&self, next: &Self) -> Self {
        let (c, r) = turned(next.quarter_turns, (self.columns, self.rows));
        Self {
            quarter_turns: (self.quarter_turns + next.quarter_turns) % 4,
            columns: c + next.columns,
            rows: r + next.rows,
            two_levels: self.two_levels || next.two_levels,
        }
    }

    /// The change that takes this one back.
    pub fn inverse(&self) -> Self {
        let quarter_turns = (4 - self.quarter_turns % 4) % 4;
        let (c, r) = turned(quarter_turns, (self.columns, self.rows));
        Self { quarter_turns, columns: -c, rows: -r, ..*self }
    }

    /// Whether a two-level plate would change its front level for its back.
    pub fn exchanges_levels(&self) -> bool {
        self.two_levels && self.columns.rem_euclid(2) == 1
    }

    /// The label after this change.
    pub fn apply(&self, id: DotId) -> DotId {
        let (c, r) = turned(self.quarter_turns, (id.column, id.row));
        let column = c + self.columns;
        let level = if self.two_levels { u8::from(column.rem_euclid(2) == 1) } else { id.level };
        DotId { column, row: r + self.rows, level }
    }
}

/// The discs of an image with their labels, and how sure these are.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labelling {
    /// Discs that belong to the pattern, ordered by label.
    pub discs: Vec<LabelledDisc>,
    /// Indices of accepted discs that are marks of the pattern.
    pub marks: Vec<usize>,
    /// Indices of accepted discs that do not belong to the pattern.
    pub left_over: Vec<usize>,
    /// Other labellings that the image alone allows as well; empty where marks decide. The other camera, or the cost
    /// of the adjustment, must choose.
    pub alternatives: Vec<Relabelling>,
    /// Whether the origin is an arbitrary dot of this image (no mark, and the grid is not seen whole).
    pub origin_is_arbitrary: bool,
    /// What the image alone leaves open and how it was taken, in words for the report; void once other images decide.
    pub warnings: Vec<String>,
}

impl Labelling {
    /// The discs relabelled by one of [`Labelling::alternatives`].
    pub fn relabelled(&self, change: &Relabelling) -> Vec<LabelledDisc> {
        let mut out: Vec<_> =
            self.discs.iter().map(|d| LabelledDisc { disc: d.disc, id: change.apply(d.id) }).collect();
        out.sort_by_key(|d| d.id);
        out
    }

    fn finish(mut self, detection: &Detection) -> Self {
        self.discs.sort_by_key(|d| d.id);
        let mut used = vec![false; detection.discs.len()];
        self.discs.iter().map(|d| d.disc).chain(self.marks.iter().copied()).for_each(|i| used[i] = true);
        self.left_over = (0..used.len()).filter(|i| !used[*i]).collect();
        self
    }
}

/// Finds the target's pattern among the discs of one image.
///
/// `image` is the name used in messages.
///
/// # Errors
/// [`Insufficient::TooFewDiscs`] and [`Insufficient::Pattern`], with what was seen and what to do.
pub fn label_discs(image: &str, detection: &Detection, target: &Target) -> Result<Labelling> {
    let labelling = match target {
        Target::TwoDiscs(p) => pair::label(image, detection, p, "two discs"),
        Target::Bubbles(p) => pair::label(image, detection, p, "two bubbles"),
        Target::DotGrid(g) => grid::label(image, detection, g),
        Target::TwoLevelPlate(p) => plate::label(image, detection, p),
    }?;
    Ok(labelling.finish(detection))
}

/// `(column, row)` after quarter turns from x to y.
fn turned(quarter_turns: u8, (i, j): (i32, i32)) -> (i32, i32) {
    match quarter_turns % 4 {
        0 => (i, j),
        1 => (-j, i),
        2 => (-i, -j),
        _ => (j, -i),
    }
}

fn pattern_error(image: &str, message: String) -> crate::Error {
    Insufficient::Pattern { image: image.to_owned(), message }.into()
}

/// What was turned down, in words, for messages about missing discs.
fn rejected_in_words(detection: &Detection) -> String {
    match missing_words(&detection.rejections) {
        words if words.is_empty() => "nothing else was seen".into(),
        words => format!("turned down: {words}"),
    }
}

#[cfg(test)]
pub(super) mod tests;
