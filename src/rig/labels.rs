//! Which disc is which: what images leave open, and what a change of labels does to discs and poses.
//!
//! A change is `id' = turn(id) + shift` ([`Relabelling`]). On the target it is the motion `T p = Rz(90 q) p + shift`, so a pose
//! found with the old labels is `pose T^-1` for the new ones. The exchange of a pair's discs is one of them: half a turn and
//! one column.

use super::{Pose, RigProblem};
use crate::bundle::{Node, TargetShape};
use crate::detect::pattern::Relabelling;
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use crate::target::DotId;
use nalgebra::{Matrix3, Vector3};

/// Exchange of the two discs of a pair.
pub(super) const EXCHANGE: Relabelling = Relabelling { quarter_turns: 2, columns: 1, rows: 0, two_levels: false };

/// What the images leave open about the labels of their discs.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenLabels {
    /// Length of one step of a label: 1 pitch, half a pitch on a two-level plate.
    pub step_pitches: f64,
    /// Columns and rows of a grid without marks, where they are known: labels of a view cannot span more.
    pub size: [Option<usize>; 2],
    /// One per image, in the order of `model.images`; empty where nothing is open. Pairs are always open.
    pub images: Vec<OpenImage>,
}

impl Default for OpenLabels {
    fn default() -> Self {
        Self { step_pitches: 1.0, size: [None; 2], images: vec![] }
    }
}

/// What one image leaves open.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OpenImage {
    /// Other labellings that it allows as well.
    pub alternatives: Vec<Relabelling>,
    /// Whether any dot may be the origin: the shifts of the alternatives mean nothing.
    pub any_origin: bool,
}

pub(super) fn is_pair(problem: &RigProblem) -> bool {
    matches!(problem.model.target.shape, TargetShape::Pair { .. })
}

/// Labellings of image `k`, the given one first.
pub(super) fn labellings(problem: &RigProblem, k: usize) -> Vec<Relabelling> {
    let mut out = vec![Relabelling::NONE];
    if is_pair(problem) {
        out.push(EXCHANGE);
    } else if let Some(open) = problem.open.images.get(k) {
        // Another level in front is no motion of the target: no vote can follow it.
        out.extend(open.alternatives.iter().filter(|a| !a.exchanges_levels()));
    }
    out
}

/// Whether any dot of image `k` may be the origin.
pub(super) fn any_origin(problem: &RigProblem, k: usize) -> bool {
    problem.open.images.get(k).is_some_and(|o| o.any_origin)
}

/// Smallest and largest label along columns and rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extent([[i32; 2]; 2]);

impl Extent {
    /// Of some labels; empty without any.
    pub(super) fn of(ids: impl Iterator<Item = DotId>) -> Self {
        let empty = [i32::MAX, i32::MIN];
        Self(ids.fold([empty; 2], |[c, r], id| {
            [[c[0].min(id.column), c[1].max(id.column)], [r[0].min(id.row), r[1].max(id.row)]]
        }))
    }

    /// Of both.
    pub(super) fn with(self, other: Self) -> Self {
        Self([0, 1].map(|a| [self.0[a][0].min(other.0[a][0]), self.0[a][1].max(other.0[a][1])]))
    }

    pub(super) fn middle(self) -> [i32; 2] {
        self.0.map(|[low, high]| low.midpoint(high))
    }

    pub(super) fn shifted(self, by: [i32; 2]) -> Self {
        Self([0, 1].map(|a| self.0[a].map(|x| x + by[a])))
    }

    /// Whether a target of this size has so many columns and rows.
    pub(super) fn fits(self, size: [Option<usize>; 2]) -> bool {
        size.iter()
            .zip(self.0)
            .all(|(size, [low, high])| size.is_none_or(|n| i64::from(high) - i64::from(low) < n as i64))
    }

    /// Shifts along columns or rows (0, 1), in steps of one label, after which `other` and this together fit; any where none does.
    pub(super) fn fitting_shifts(self, other: Self, size: [Option<usize>; 2], axis: usize) -> [i32; 2] {
        let ([low, high], [l, h]) = (other.0[axis], self.0[axis]);
        let most = size[axis].map_or(i32::MAX / 4, |n| n as i32 - 1);
        let range = [high.saturating_sub(most).saturating_sub(l), low.saturating_add(most).saturating_sub(h)];
        if range[0] <= range[1] { range } else { [i32::MIN / 4, i32::MAX / 4] }
    }
}

/// Labels of image `k` after a change.
pub(super) fn extent(problem: &RigProblem, ids: &[DotId], k: usize, change: &Relabelling) -> Extent {
    Extent::of(problem.model.images[k].discs.iter().map(|d| change.apply(ids[d.disc])))
}

/// Columns and rows of a target; none where they are not known.
pub(super) type Size = [Option<usize>; 2];

/// Columns and rows that labels of these images together may span: as stated, or exchanged where a quarter turn may have exchanged them.
pub(super) fn sizes_of(problem: &RigProblem, images: &[usize]) -> Vec<Size> {
    let quarter = |k: &usize| labellings(problem, *k).iter().any(|a| a.quarter_turns % 2 == 1);
    let [columns, rows] = problem.open.size;
    let mut out = vec![[columns, rows]];
    if columns != rows && images.iter().any(quarter) {
        out.push([rows, columns]);
    }
    out
}

/// The larger of each way of those sizes into which each of these labels fits; any size where there is none.
pub(super) fn largest_of(sizes: &[Size], extents: &[Extent]) -> Size {
    let fitting = sizes.iter().filter(|size| extents.iter().all(|e| e.fits(**size)));
    let larger = |a: Size, b: &Size| [0, 1].map(|i| a[i].zip(b[i]).map(|(a, b)| a.max(b)));
    fitting.copied().reduce(|a, b| larger(a, &b)).unwrap_or([None; 2])
}

/// The image of `camera` in `view`.
pub(super) fn image_at(problem: &RigProblem, camera: usize, view: usize) -> Option<usize> {
    problem.model.images.iter().position(|i| i.camera == camera && i.view == view)
}

/// Labels by which the lattice looks the same again: one, or two half pitches on a two-level plate.
pub(super) fn slide(problem: &RigProblem) -> i32 {
    match &problem.model.target.shape {
        TargetShape::Lattice(nodes) if nodes.iter().any(|n| n.level > 0.0) => 2,
        _ => 1,
    }
}

/// The change as a motion of the target, for a pitch (or a pair's spacing) in mm.
pub(super) fn turned_target(change: &Relabelling, step_mm: f64) -> Motion<Target, Target> {
    let (c, s) = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][usize::from(change.quarter_turns % 4)];
    let shift = Vector3::new(f64::from(change.columns), f64::from(change.rows), 0.0) * step_mm;
    Motion::new(Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0), shift)
}

/// A pose found with the old labels, for the new ones.
pub(super) fn changed(problem: &RigProblem, pose: &Pose, change: &Relabelling) -> Pose {
    if *change == Relabelling::NONE {
        return *pose;
    }
    let (m, shape) = pose;
    let moved: Motion<Cam, Target> = *m * turned_target(change, problem.open.step_pitches * shape[0]).inverse();
    (moved, if is_pair(problem) { [shape[0], shape[2], shape[1]] } else { *shape })
}

/// Label of every disc of the target.
pub(super) fn labels(problem: &RigProblem) -> Vec<DotId> {
    let step = problem.open.step_pitches;
    match &problem.model.target.shape {
        TargetShape::Pair { .. } => [0, 1].map(|column| DotId { column, row: 0, level: 0 }).into(),
        TargetShape::Lattice(nodes) => nodes
            .iter()
            .map(|n| DotId {
                column: (n.x / step).round() as i32,
                row: (n.y / step).round() as i32,
                level: u8::from(n.level > 0.0),
            })
            .collect(),
    }
}

/// Gives the discs of each image their new labels; the target gets the discs that then exist.
pub(super) fn relabel(problem: &mut RigProblem, changes: &[Relabelling]) {
    if changes.iter().all(|c| *c == Relabelling::NONE) {
        return;
    }
    let old = labels(problem);
    let images = || problem.model.images.iter().zip(changes);
    let mut all: Vec<DotId> = images().flat_map(|(i, c)| i.discs.iter().map(|d| c.apply(old[d.disc]))).collect();
    all.sort_unstable();
    all.dedup();
    let step = problem.open.step_pitches;
    for (image, change) in problem.model.images.iter_mut().zip(changes) {
        for d in &mut image.discs {
            // Every new label was collected above.
            d.disc = all.binary_search(&change.apply(old[d.disc])).unwrap_or(d.disc);
        }
    }
    if let TargetShape::Lattice(nodes) = &mut problem.model.target.shape {
        let node =
            |l: &DotId| Node { x: step * f64::from(l.column), y: step * f64::from(l.row), level: f64::from(l.level) };
        *nodes = all.iter().map(node).collect();
    }
    for (open, change) in problem.open.images.iter_mut().zip(changes) {
        let back = change.inverse();
        let given = open.alternatives.iter().map(|a| back.then(a));
        open.alternatives = given.chain([back]).filter(|a| *a != Relabelling::NONE).collect();
    }
}

/// Labels the larger disc of each pair as the model's larger one; equal discs keep their order.
pub(super) fn order_pairs(problem: &mut RigProblem) -> Vec<Relabelling> {
    let count = problem.model.images.len();
    let mut changes = vec![Relabelling::NONE; count];
    if is_pair(problem) {
        let first_is_smaller = matches!(problem.shape_mm, [_, Some(r0), Some(r1)] if r0 < r1);
        for k in 0..count {
            let size = |disc: usize| {
                let at = problem.model.images[k].discs.iter().position(|d| d.disc == disc);
                at.map(|i| problem.ellipses[k][i].semi_major_px)
            };
            if let (Some(a), Some(b)) = (size(0), size(1)) {
                if (a < b) != first_is_smaller {
                    changes[k] = EXCHANGE;
                }
            }
        }
        relabel(problem, &changes);
    }
    changes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(columns: [i32; 2], rows: [i32; 2]) -> Extent {
        let corners = [(columns[0], rows[0]), (columns[1], rows[1])];
        Extent::of(corners.into_iter().map(|(column, row)| DotId { column, row, level: 0 }))
    }

    /// Against every shift tried.
    #[test]
    fn shifts_that_fit_are_those_that_keep_both_inside() {
        let size = [Some(16), Some(7)];
        for (own, other) in [
            (ids([0, 14], [0, 6]), ids([0, 15], [0, 6])),
            (ids([0, 14], [0, 5]), ids([0, 13], [0, 6])),
            (ids([-3, 2], [4, 5]), ids([5, 9], [-2, 0])),
        ] {
            for axis in 0..2 {
                let fits = |i: i32| {
                    let mut by = [0; 2];
                    by[axis] = i;
                    let mut one = [None; 2];
                    one[axis] = size[axis];
                    own.shifted(by).with(other).fits(one)
                };
                let wanted: Vec<i32> = (-40..=40).filter(|i| fits(*i)).collect();
                let [low, high] = own.fitting_shifts(other, size, axis);
                assert_eq!((low..=high).collect::<Vec<_>>(), wanted, "{own:?} {other:?} {axis}");
                assert!(!wanted.is_empty());
            }
        }
        assert!(!ids([0, 16], [0, 6]).fits(size) && ids([0, 15], [0, 6]).fits(size));
        assert!(ids([0, 90], [0, 6]).fits([None, Some(7)]));
        let [low, high] = ids([0, 20], [0, 6]).fitting_shifts(ids([0, 20], [0, 6]), size, 0);
        assert!(low < -1000 && high > 1000, "what fits nowhere may be anywhere");
    }

    #[test]
    fn an_image_that_shows_all_columns_tells_which_way_a_grid_lies() {
        let sizes = [[Some(12), Some(11)], [Some(11), Some(12)]];
        let [whole, square] = [ids([0, 11], [0, 10]), ids([0, 10], [0, 10])];
        assert_eq!(largest_of(&sizes, &[whole, square]), sizes[0]);
        assert_eq!(largest_of(&sizes, &[square, ids([3, 13], [0, 11])]), sizes[1]);
        assert_eq!(largest_of(&sizes, &[square, square]), [Some(12), Some(12)]);
        assert_eq!(
            largest_of(&sizes, &[whole, ids([0, 10], [0, 11])]),
            [None; 2],
            "one way for one, the other for the other"
        );
        assert_eq!(largest_of(&[[None, Some(7)], [Some(7), None]], &[ids([0, 5], [0, 5])]), [None; 2]);
    }
}
