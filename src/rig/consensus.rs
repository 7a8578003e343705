//! What the common views say about how the cameras stand to each other.
//!
//! Every view seen by both cameras votes with `M_v = right_from_target left_from_target^-1`, once for each way in which the labels of
//! its two images may belong together: with the discs of a pair exchanged, with an unmarked grid turned by quarter turns.
//! The right choice makes all M_v equal; a wrong one turns each about the normal of its own target. Where any dot may be the
//! origin, the shift that brings the target of a view to where the motion expects it is rounded to whole pitches. Choices
//! that differ little are left to the cost of the common adjustment.

use super::labels::{
    Extent, Size, any_origin, changed, extent, image_at, is_pair, labellings, labels, largest_of, sizes_of, slide,
};
use super::{Pose, RigProblem};
use crate::bundle::TargetShape;
use crate::detect::pattern::Relabelling;
use crate::frames::{Cam, Rig};
use crate::rigid::{Motion, rotation_log};
use nalgebra::{Matrix3, Vector3};

/// Motions of two views that differ by more than this contradict each other, rad. Poses of a camera calibrated alone are
/// good to a few tenths of a degree.
pub(super) const CONSENSUS_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// A choice that is worse than the best by less than this per view (of up to three) is its rival, rad.
const RIVAL_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// A target that misses its place by a whole pitch weighs like this turn, rad.
const PITCH_RAD: f64 = CONSENSUS_RAD;
/// Rivals that are tried.
const MOST_RIVALS: usize = 8;
/// Shifts that are tried each way.
const MOST_SHIFT: i32 = 8;

/// Poses of a camera in all views.
pub(super) type Poses = [Option<Pose>];

/// One way in which the two images of a view may belong together.
#[derive(Clone, Copy)]
pub(super) struct Vote {
    pub(super) view: usize,
    /// Change of the labels of each camera's image.
    pub(super) changes: [Relabelling; 2],
    /// Poses after the change.
    poses: [Pose; 2],
    /// The camera whose labels may be shifted besides, if any.
    slides: Option<usize>,
    /// Labels of each image after the change, and the columns and rows that both together may span.
    extents: [Extent; 2],
    size: Size,
    /// Middle of the dots seen, on the target, mm.
    middle: Vector3<f64>,
    /// Length of a shift that changes nothing, mm.
    step_mm: f64,
}

pub(super) fn angle(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    rotation_log(&(a * b.transpose())).norm()
}

impl Vote {
    pub(super) fn motion(&self) -> Motion<Cam, Rig> {
        let m = self.poses[1].0 * self.poses[0].0.inverse();
        Motion::new(m.rotation, m.translation_mm)
    }

    /// Whether labels of one of the images may be shifted.
    pub(super) fn may_slide(&self) -> bool {
        self.slides.is_some()
    }

    /// Disagreement with a motion, rad; labels that may slide are slid to agree best.
    fn against(&self, problem: &RigProblem, motion: &Motion<Cam, Rig>) -> (Self, f64) {
        let (turn, miss) = self.apart(motion);
        match miss {
            Some(miss) if turn < 2.0 * CONSENSUS_RAD => {
                let slid = self.slid(problem, self.nearest(problem, [miss.x, miss.y]));
                (slid, slid.gap(motion))
            }
            _ => (*self, self.gap(motion)),
        }
    }

    /// Disagreement with a motion, labels as they are, rad.
    fn gap(&self, motion: &Motion<Cam, Rig>) -> f64 {
        let (turn, miss) = self.apart(motion);
        match miss {
            Some(miss) if turn < 2.0 * CONSENSUS_RAD => turn + PITCH_RAD * miss.norm(),
            _ => turn + 0.3 * self.motion().translation_mm.angle(&motion.translation_mm),
        }
    }

    /// Angle to a motion, rad, and, where labels may slide, by how many shifts the target misses the place where the motion expects it.
    fn apart(&self, motion: &Motion<Cam, Rig>) -> (f64, Option<Vector3<f64>>) {
        let turn = angle(&self.motion().rotation, &motion.rotation);
        let [l, r] = [&self.poses[0].0, &self.poses[1].0];
        let miss = |camera: usize| {
            let expected = motion.apply(&l.apply(&self.middle));
            let off = if camera == 1 {
                r.rotation.transpose() * (r.apply(&self.middle) - expected)
            } else {
                l.rotation.transpose() * motion.rotation.transpose() * (expected - r.apply(&self.middle))
            };
            off / self.step_mm
        };
        (turn, self.slides.map(miss))
    }

    /// The shift nearest to the one wished after which both images' labels fit into the target.
    fn nearest(&self, problem: &RigProblem, wished: [f64; 2]) -> [i32; 2] {
        let n = slide(problem);
        let Some(c) = self.slides else { return [0; 2] };
        [0, 1].map(|axis| {
            let [low, high] = self.extents[c].fitting_shifts(self.extents[1 - c], self.size, axis);
            let (low, high) = (-(-low).div_euclid(n), high.div_euclid(n));
            (wished[axis].round() as i32).max(low).min(high)
        })
    }

    /// The vote with the labels of the sliding camera shifted.
    fn slid(&self, problem: &RigProblem, by: [i32; 2]) -> Self {
        let Some(c) = self.slides.filter(|_| by != [0, 0]) else { return *self };
        let n = slide(problem);
        let shift = Relabelling { columns: n * by[0], rows: n * by[1], ..Relabelling::NONE };
        let mut out = *self;
        out.changes[c] = self.changes[c].then(&shift);
        out.poses[c] = changed(problem, &self.poses[c], &shift);
        out.extents[c] = self.extents[c].shifted([shift.columns, shift.rows]);
        out
    }

    /// Whether both images' labels fit into the target.
    fn fits(&self) -> bool {
        self.extents[0].with(self.extents[1]).fits(self.size)
    }

    /// How far the labels are from those given: turns first, then shifts.
    fn strangeness(&self) -> i64 {
        let of = |c: &Relabelling| {
            1000 * i64::from(c.quarter_turns.min(4 - c.quarter_turns))
                + i64::from(c.columns).pow(2)
                + i64::from(c.rows).pow(2)
        };
        self.changes.iter().map(of).sum()
    }
}

/// How the labels of the two images of a view may belong together, each relation once.
fn relations(problem: &RigProblem, images: [usize; 2], any: bool) -> Vec<[Relabelling; 2]> {
    let own = images.map(|k| labellings(problem, k));
    let slides = any || images.iter().any(|k| any_origin(problem, *k));
    let mut out: Vec<([Relabelling; 2], Relabelling)> = vec![];
    if any && !is_pair(problem) {
        return (0..4).map(|q| [Relabelling::NONE, Relabelling { quarter_turns: q, ..Relabelling::NONE }]).collect();
    }
    // The second camera's labels change first: the first camera's are the reference where it is free to be.
    for left in &own[0] {
        for right in &own[1] {
            let mut relation = left.inverse().then(right);
            if slides {
                (relation.columns, relation.rows) = (0, 0);
            }
            if !out.iter().any(|o| o.1 == relation) {
                out.push(([*left, *right], relation));
            }
        }
    }
    out.into_iter().map(|o| o.0).collect()
}

fn middle(problem: &RigProblem, image: usize, change: &Relabelling, shape: &[f64; 3]) -> Vector3<f64> {
    let discs = &problem.model.images[image].discs;
    let sum: Vector3<f64> = discs.iter().map(|d| problem.model.target.nominal_disc(d.disc, shape).0).sum();
    let mean = sum / discs.len().max(1) as f64;
    // The pose takes the old place to the camera, the new pose the new place.
    let old = changed(problem, &(Motion::identity(), *shape), change).0;
    old.inverse().apply(&mean)
}

/// All votes; `any`: as if nothing were known about the labels (for mirrored images).
pub(super) fn votes(problem: &RigProblem, left: &Poses, right: &Poses, any: bool) -> Vec<Vote> {
    let mut out = vec![];
    let ids = labels(problem);
    for (view, (l, r)) in left.iter().zip(right).enumerate() {
        let (Some(l), Some(r)) = (l, r) else { continue };
        let (Some(a), Some(b)) = (image_at(problem, 0, view), image_at(problem, 1, view)) else { continue };
        let lattice = matches!(problem.model.target.shape, TargetShape::Lattice(_));
        let slides = if lattice && (any || any_origin(problem, b)) {
            Some(1)
        } else if lattice && any_origin(problem, a) {
            Some(0)
        } else {
            None
        };
        let sizes = if any { vec![] } else { sizes_of(problem, &[a, b]) };
        for changes in relations(problem, [a, b], any) {
            let extents = [extent(problem, &ids, a, &changes[0]), extent(problem, &ids, b, &changes[1])];
            out.push(Vote {
                view,
                changes,
                poses: [changed(problem, l, &changes[0]), changed(problem, r, &changes[1])],
                slides,
                extents,
                size: largest_of(&sizes, &extents),
                middle: middle(problem, a, &changes[0], &l.1),
                step_mm: f64::from(slide(problem)) * problem.open.step_pitches * l.1[0],
            });
        }
    }
    out
}

/// A motion and the vote of each view that agrees with it best.
#[derive(Clone)]
pub(super) struct Choice {
    /// The vote at the centre.
    pub(super) center: Vote,
    /// Per view its best vote and its disagreement, rad.
    pub(super) best: Vec<Option<(Vote, f64)>>,
    cost: f64,
}

impl Choice {
    fn around(problem: &RigProblem, votes: &[Vote], center: &Vote) -> Self {
        let motion = center.motion();
        let mut best: Vec<Option<(Vote, f64)>> = vec![None; problem.model.views.len()];
        for v in votes {
            let (v, gap) = v.against(problem, &motion);
            if best[v.view].is_none_or(|(_, g)| gap < g) {
                best[v.view] = Some((v, gap));
            }
        }
        let cost = best.iter().flatten().map(|(_, g)| g.min(CONSENSUS_RAD)).sum();
        Self { center: *center, best, cost }
    }

    /// The same with one view's labels shifted by one each way, as far as they fit, for every view whose labels may be.
    pub(super) fn shifted_by_one(&self, problem: &RigProblem) -> Vec<Self> {
        let motion = self.center.motion();
        let mut out = vec![];
        for (vote, _) in self.best.iter().flatten().filter(|(v, _)| v.may_slide()) {
            for by in (-1..=1).flat_map(|i| [-1, 0, 1].map(|j| [i, j])).filter(|by| *by != [0, 0]) {
                let slid = vote.slid(problem, by);
                if slid.fits() {
                    let mut other = self.clone();
                    other.best[vote.view] = Some((slid, slid.gap(&motion)));
                    out.push(other);
                }
            }
        }
        out
    }

    /// How many views both cameras have.
    pub(super) fn common(&self) -> usize {
        self.best.iter().flatten().count()
    }

    /// Views that disagree.
    pub(super) fn outside(&self) -> Vec<usize> {
        self.best.iter().flatten().filter(|(_, g)| *g > CONSENSUS_RAD).map(|(v, _)| v.view).collect()
    }

    /// Median disagreement, rad.
    pub(super) fn spread(&self) -> f64 {
        let mut gaps: Vec<f64> = self.best.iter().flatten().map(|(_, g)| *g).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    fn strangeness(&self) -> i64 {
        self.best.iter().flatten().map(|(v, _)| v.strangeness()).sum()
    }

    fn is_same(&self, other: &Self) -> bool {
        let labels = |c: &Self| -> Vec<[Relabelling; 2]> { c.best.iter().flatten().map(|(v, _)| v.changes).collect() };
        labels(self) == labels(other)
    }
}

/// Sorted by disagreement, each set of labels once.
fn distinct(mut all: Vec<Choice>, rival_rad: f64) -> Vec<Choice> {
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.strangeness().cmp(&b.strangeness())));
    let mut out: Vec<Choice> = vec![];
    for c in all {
        if out.first().is_some_and(|best| c.cost > best.cost + rival_rad) {
            break;
        }
        if !out.iter().any(|o| o.is_same(&c)) {
            out.push(c);
        }
    }
    out
}

/// The motion that most views support, and rivals that support nearly as well; empty without a common view.
pub(super) fn choices(problem: &RigProblem, votes: &[Vote]) -> Vec<Choice> {
    let around: Vec<Choice> = votes.iter().map(|v| Choice::around(problem, votes, v)).collect();
    let common = around.first().map_or(0, |c| c.best.iter().flatten().count());
    let rival_rad = RIVAL_RAD * common.min(3) as f64;
    let mut out = distinct(around, rival_rad);
    if out.iter().any(|c| c.center.may_slide()) {
        let mut slid = out.clone();
        for c in out.iter().filter(|c| c.center.may_slide()) {
            for i in -MOST_SHIFT..=MOST_SHIFT {
                for j in -MOST_SHIFT..=MOST_SHIFT {
                    let center = c.center.slid(problem, [i, j]);
                    if center.fits() {
                        slid.push(Choice::around(problem, votes, &center));
                    }
                }
            }
        }
        out = distinct(slid, rival_rad);
    }
    // Within a tenth of a degree per view the votes cannot tell: the labels nearest to those given come first.
    let near = out.first().map_or(0.0, |c| c.cost) + 0.1 * rival_rad;
    let told = out.iter().take_while(|c| c.cost <= near).count();
    out[..told].sort_by_key(Choice::strangeness);
    out.truncate(MOST_RIVALS);
    out
}
