//! Two-level plates: two lattices with one pitch, staggered by half of it and shifted by parallax.
//!
//! Labels count half pitches: a dot of the front level has even column and row, one of the back level odd ones, so
//! (0, 0) is a front dot. Marks sit in the gaps, where column + row is odd; the level of [`crate::target::Mark::at`] says on which
//! level the mark is printed, hence which lattice predicts its place without parallax.
//!
//! The plate that LaVision sells as type 21 (seen in the 4th PIV Challenge, case E) carries the square on a front column
//! midway between two front dots and the triangle half a pitch right of and below it, on the back level. The world
//! origin of the challenge, 30 mm right of and 7.5 mm above the square at 15 mm pitch, makes them (-4, -1, 0) and (-3, -2, 1).

use super::dots::{Dots, median};
use super::lattice::{self, Between, Cell, Lattice};
use super::{Labelling, Relabelling, pattern_error, rejected_in_words, turned};
use crate::detect::{Detection, LabelledDisc, RejectionReason, Shape};
use crate::error::Result;
use crate::frames::Pixel;
use crate::target::{DotId, Mark, Plate};
use nalgebra::Vector2;

/// Fewest dots on each level.
const FEWEST: usize = 4;
/// A mark may be this far from its place, in half pitches.
const MARK_TOLERANCE: f64 = 0.4;
/// Size of a mark over that of a dot.
const MARK_SIZE: (f64, f64) = (0.4, 2.5);
/// Parallax between the levels, in half pitches, above which a mark says by its place which level it is on.
const TELLING_PARALLAX: f64 = 0.12;

/// Both lattices in the common frame of half pitches: a dot of level class k has coordinates `2 cell + k`.
struct TwoLevels<'a> {
    dots: &'a Dots,
    levels: [Lattice; 2],
    /// Cell offset of the second lattice: its cell c is at `2 (c + offset) + 1`.
    offset: Cell,
    /// Median shift of the second lattice against the middle of the first one's cells, half pitches.
    parallax: Vector2<f64>,
}

/// `id = turn(half pitches) + shift`; `front` is the class of the front level.
#[derive(Clone, Copy, PartialEq)]
struct Placement {
    quarter_turns: u8,
    shift: Cell,
    front: usize,
}

impl Placement {
    fn id(&self, half: Cell) -> Cell {
        let (c, r) = turned(self.quarter_turns, half);
        (c + self.shift.0, r + self.shift.1)
    }
}

impl TwoLevels<'_> {
    fn half(&self, class: usize, cell: Cell) -> Cell {
        if class == 0 {
            (2 * cell.0, 2 * cell.1)
        } else {
            (2 * (cell.0 + self.offset.0) + 1, 2 * (cell.1 + self.offset.1) + 1)
        }
    }
    /// Where an image point lies, in half pitches, if it is on the level of this class.
    fn locate(&self, class: usize, p: &Vector2<f64>) -> Option<Vector2<f64>> {
        let x = self.levels[class].locate(self.dots, p)?;
        let zero = self.half(class, (0, 0));
        Some(x * 2.0 + Vector2::new(f64::from(zero.0), f64::from(zero.1)))
    }
}

pub(super) fn label(image: &str, detection: &Detection, target: &Plate) -> Result<Labelling> {
    let dots = Dots::new(detection);
    let levels = two_levels(image, detection, &dots)?;
    let mut out = Labelling::default();
    let mut placements = placements(image, detection, &levels, target, &mut out)?;
    let up = |p: &Placement| levels.levels[0].upness(&dots, p.quarter_turns);
    placements.sort_by(|a, b| {
        up(b).total_cmp(&up(a)).then(a.quarter_turns.cmp(&b.quarter_turns)).then(a.front.cmp(&b.front))
    });
    let Some(best) = placements.first().copied() else {
        return Err(crate::Error::Bug("no way to lay the labels over the plate".into()));
    };
    if placements.len() > 1 {
        out.warnings.push(format!(
            "the axes of the plate are taken from the image (target y up), {} other labellings are possible; show square and triangle",
            placements.len() - 1
        ));
    }
    out.alternatives = placements[1..].iter().map(|p| change(&best, p)).collect();
    for (class, lattice) in levels.levels.iter().enumerate() {
        for (cell, k) in &lattice.nodes {
            let (column, row) = best.id(levels.half(class, *cell));
            out.discs.push(LabelledDisc { disc: *k, id: DotId { column, row, level: u8::from(class != best.front) } });
        }
    }
    Ok(out)
}

fn change(from: &Placement, to: &Placement) -> Relabelling {
    let quarter_turns = (to.quarter_turns + 4 - from.quarter_turns) % 4;
    let moved = turned(quarter_turns, from.shift);
    Relabelling { quarter_turns, columns: to.shift.0 - moved.0, rows: to.shift.1 - moved.1, two_levels: true }
}

fn two_levels<'a>(image: &str, detection: &Detection, dots: &'a Dots) -> Result<TwoLevels<'a>> {
    let refused = |what: &str| {
        pattern_error(
            image,
            format!(
                "{} discs were found, but {what} ({}); a two-level plate needs at least two rows and columns of dots on each level",
                dots.len(),
                rejected_in_words(detection)
            ),
        )
    };
    let mut free = vec![true; dots.len()];
    let first = lattice::find(dots, &free, Between::OneDot)
        .filter(|l| l.nodes.len() >= FEWEST)
        .ok_or_else(|| refused("no square lattice with the dots of a second level between its own"))?;
    first.nodes.values().for_each(|k| free[*k] = false);
    let second = second_lattice(dots, &free, &first)
        .filter(|l| l.nodes.len() >= FEWEST)
        .ok_or_else(|| refused("the dots of the second level do not form a lattice"))?;
    let inside: Vec<Vector2<f64>> = second
        .nodes
        .iter()
        .filter_map(|(c, k)| {
            let x = first.locate(dots, &dots.at[*k])?;
            Some(x - Vector2::new(f64::from(c.0), f64::from(c.1)))
        })
        .collect();
    let at = Vector2::new(median(inside.iter().map(|x| x.x).collect()), median(inside.iter().map(|x| x.y).collect()));
    let offset = (at.x.floor() as i32, at.y.floor() as i32);
    let middle = Vector2::new(f64::from(offset.0) + 0.5, f64::from(offset.1) + 0.5);
    let parallax = (at - middle) * 2.0;
    if parallax.amax() > 0.85 {
        let message = "the depth of the plate shifts its levels by almost half a pitch against each other, so that which dot lies beside which is not \
                       certain; look at it less obliquely, or tilt it towards the camera"
            .into();
        return Err(pattern_error(image, message));
    }
    Ok(TwoLevels { dots, levels: [first, second], offset, parallax })
}

/// The lattice with the steps of `first` among the dots that are still free.
fn second_lattice(dots: &Dots, free: &[bool], first: &Lattice) -> Option<Lattice> {
    let center = first.center(dots);
    let mut start: Vec<usize> = (0..dots.len()).filter(|k| free[*k]).collect();
    start.sort_by(|a, b| (dots.at[*a] - center).norm().total_cmp(&(dots.at[*b] - center).norm()).then(a.cmp(b)));
    let mut best: Option<Lattice> = None;
    for k in start.into_iter().take(12) {
        let Some(seed) = seed_like(dots, free, first, k) else { continue };
        let grown = lattice::grown(dots, free, seed);
        if best.as_ref().is_none_or(|b| grown.nodes.len() > b.nodes.len()) {
            best = Some(grown);
        }
    }
    best
}

/// Dot `k` and its eight neighbours at the steps that `first` has there.
fn seed_like(dots: &Dots, free: &[bool], first: &Lattice, k: usize) -> Option<Lattice> {
    let x = first.locate(dots, &dots.at[k])?;
    let basis = first.predict(dots, (x.x.round() as i32, x.y.round() as i32))?.basis;
    let mut seed = Lattice::default();
    seed.nodes.insert((0, 0), k);
    for i in -1..=1 {
        for j in -1..=1 {
            let at = dots.at[k] + basis * Vector2::new(f64::from(i), f64::from(j));
            let reach = 0.15 * basis.column(0).norm().min(basis.column(1).norm());
            let near = dots.within(&at, reach).into_iter().filter(|n| free[*n] && *n != k);
            if let Some(n) = near.min_by(|a, b| (dots.at[*a] - at).norm().total_cmp(&(dots.at[*b] - at).norm())) {
                seed.nodes.entry((i, j)).or_insert(n);
            }
        }
    }
    (seed.nodes.len() >= FEWEST).then_some(seed)
}

/// Every labelling that explains most marks; all of the parity rule where there are no marks.
fn placements(
    image: &str,
    detection: &Detection,
    levels: &TwoLevels<'_>,
    target: &Plate,
    out: &mut Labelling,
) -> Result<Vec<Placement>> {
    let shapes = plausible_shapes(detection, levels);
    let mut best: (usize, Vec<(Placement, f64)>) = (0, Vec::new());
    for quarter_turns in 0..4 {
        for front in 0..2 {
            for shape in &shapes {
                for mark in target.marks.iter().filter(|m| m.kind == shape.mark) {
                    let Some(p) = anchored(levels, quarter_turns, front, shape, mark) else { continue };
                    let (matched, miss) = explained(levels, &p, &shapes, &target.marks);
                    if matched > best.0 {
                        best = (matched, Vec::new());
                    }
                    if matched == best.0 && matched > 0 && !best.1.iter().any(|(q, _)| *q == p) {
                        best.1.push((p, miss));
                    }
                }
            }
        }
    }
    let (matched, mut found) = best;
    let needed = target.marks.len();
    if matched == 0 {
        if needed > 0 {
            return Err(pattern_error(
                image,
                format!(
                    "both levels of the plate were found, but none of its {needed} marks in its place; show the square or the triangle in every image"
                ),
            ));
        }
        out.origin_is_arbitrary = true;
        out.warnings.push(
            "the plate has no marks: which level is in front, and the origin, are arbitrary; list its square and triangle in [target] marks".into(),
        );
        return Ok(unmarked());
    }
    if matched < needed {
        out.warnings.push(format!("{matched} of {needed} marks of the plate found"));
    }
    // Where parallax moves the levels apart, a mark fits its own level better than the other.
    if levels.parallax.norm() > TELLING_PARALLAX {
        let least = found.iter().map(|f| f.1).fold(f64::INFINITY, f64::min);
        found.retain(|f| f.1 <= least + 0.5 * levels.parallax.norm() * matched as f64);
    }
    let placements = hinted(detection, levels, target, found.into_iter().map(|f| f.0).collect());
    if (0..4).any(|k| placements.iter().filter(|p| p.quarter_turns == k).count() > 1) {
        return Err(pattern_error(
            image,
            format!(
                "{} places of the marks fit the plate equally well; are kind, column, row and level of the marks in the rig file those of the plate? Else cover \
                 stray squares and triangles",
                placements.len()
            ),
        ));
    }
    Ok(placements)
}

/// Those under which most of the unseen marks fall on something that is there but neither disc nor clear mark.
///
/// A blurred triangle is often turned down; that it is there still tells one turn of the plate from another.
fn hinted(detection: &Detection, levels: &TwoLevels<'_>, target: &Plate, placements: Vec<Placement>) -> Vec<Placement> {
    if placements.len() < 2 {
        return placements;
    }
    let blobs: Vec<Vector2<f64>> = detection
        .rejections
        .iter()
        .filter(|r| matches!(r.reason, RejectionReason::NotElliptical { .. } | RejectionReason::TooSmall { .. }))
        .filter(|r| plausible_size(levels, &r.center_px, r.radius_px))
        .map(|r| Vector2::new(r.center_px.u_px, r.center_px.v_px))
        .chain(detection.shapes.iter().map(|s| Vector2::new(s.center_px.u_px, s.center_px.v_px)))
        .collect();
    let there = |p: &Placement| {
        let at = |m: &&Mark| blobs.iter().any(|b| miss(levels, p, m, b).is_some_and(|off| off < MARK_TOLERANCE));
        target.marks.iter().filter(at).count()
    };
    let most = placements.iter().map(there).max().unwrap_or(0);
    placements.into_iter().filter(|p| there(p) == most).collect()
}

/// Distance of an image point from the place of a mark, half pitches.
fn miss(levels: &TwoLevels<'_>, p: &Placement, mark: &Mark, at: &Vector2<f64>) -> Option<f64> {
    let x = levels.locate(class_of(mark, p.front), at)?;
    // Turn the place of the mark back onto the lattice.
    let back = turned(4 - p.quarter_turns, (mark.at.column - p.shift.0, mark.at.row - p.shift.1));
    Some((x - Vector2::new(f64::from(back.0), f64::from(back.1))).norm())
}

/// Whether something is about as large as the dots near it.
fn plausible_size(levels: &TwoLevels<'_>, at: &Pixel, radius_px: f64) -> bool {
    let near = levels.dots.nearest(&Vector2::new(at.u_px, at.v_px), 9);
    let ratio = radius_px / median(near.into_iter().map(|k| levels.dots.radius(k)).collect());
    ratio > MARK_SIZE.0 && ratio < MARK_SIZE.1
}

/// Shapes about as large as the dots near them.
fn plausible_shapes<'a>(detection: &'a Detection, levels: &TwoLevels<'_>) -> Vec<&'a Shape> {
    detection.shapes.iter().filter(|s| plausible_size(levels, &s.center_px, s.radius_px)).collect()
}

/// The lattice class on which a mark is printed.
fn class_of(mark: &Mark, front: usize) -> usize {
    if mark.at.level == 0 { front } else { 1 - front }
}

/// The labelling that puts `shape` on `mark`, where parities allow it.
fn anchored(levels: &TwoLevels<'_>, quarter_turns: u8, front: usize, shape: &Shape, mark: &Mark) -> Option<Placement> {
    let p = Vector2::new(shape.center_px.u_px, shape.center_px.v_px);
    let x = levels.locate(class_of(mark, front), &p)?;
    let half = (x.x.round() as i32, x.y.round() as i32);
    if (x - Vector2::new(f64::from(half.0), f64::from(half.1))).norm() > MARK_TOLERANCE {
        return None;
    }
    let t = turned(quarter_turns, half);
    let placement = Placement { quarter_turns, shift: (mark.at.column - t.0, mark.at.row - t.1), front };
    // A front dot must get an even column and row.
    let (c, r) = placement.id(levels.half(front, (0, 0)));
    (c.rem_euclid(2) == 0 && r.rem_euclid(2) == 0).then_some(placement)
}

/// How many marks are in their place, and by how much they miss it together, half pitches.
fn explained(levels: &TwoLevels<'_>, p: &Placement, shapes: &[&Shape], marks: &[Mark]) -> (usize, f64) {
    let (mut matched, mut total) = (0, 0.0);
    for mark in marks {
        let off = |s: &&Shape| miss(levels, p, mark, &Vector2::new(s.center_px.u_px, s.center_px.v_px));
        let least = shapes.iter().filter(|s| s.mark == mark.kind).filter_map(off).fold(f64::INFINITY, f64::min);
        if least < MARK_TOLERANCE {
            matched += 1;
            total += least;
        }
    }
    (matched, total)
}

/// Every turn, and either level in front.
fn unmarked() -> Vec<Placement> {
    let each = |quarter_turns| {
        [0, 1].map(|front: usize| {
            let shift = if front == 0 { (0, 0) } else { (1, 1) };
            Placement { quarter_turns, shift, front }
        })
    };
    (0..4).flat_map(each).collect()
}
