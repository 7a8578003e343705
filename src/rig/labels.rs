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
    /// One per image, in the order of `model.images`; empty where nothing is open. Pairs are always open.
    pub images: Vec<OpenImage>,
}

impl Default for OpenLabels {
    fn default() -> Self {
        Self { step_pitches: 1.0, images: vec![] }
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
