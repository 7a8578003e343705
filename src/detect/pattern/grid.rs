//! Dot grids: a lattice, then origin and axes from marks, from the size of the grid, or from what is up in the image.

use super::dots::{Dots, median};
use super::lattice::{self, Between, Cell, Lattice};
use super::{Labelling, Relabelling, pattern_error, rejected_in_words, turned};
use crate::detect::{Detection, LabelledDisc, Shape};
use crate::error::{Insufficient, Result};
use crate::target::{DotId, Grid, Mark, MarkKind};
use nalgebra::Vector2;

/// A dot is a `Large` mark if its radius exceeds that of its neighbours by this factor.
const LARGE: f64 = 1.25;
/// Dots of the grid proper have radii within these factors of their neighbours'.
const EQUAL: (f64, f64) = (0.7, 1.4);
/// A square or triangle stands in the place of a dot where it is no further off, cells.
const IN_PLACE: f64 = 0.2;
/// Fewest dots of a grid that is worth using.
const FEWEST: usize = 4;

/// A mark seen in a cell of the lattice.
struct Sighting {
    cell: Cell,
    kind: MarkKind,
}

/// A way to lay the target's labels over the lattice: `id = turn(cell) + shift`.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Placement {
    quarter_turns: u8,
    shift: Cell,
}

impl Placement {
    fn id(&self, cell: Cell) -> Cell {
        let (c, r) = turned(self.quarter_turns, cell);
        (c + self.shift.0, r + self.shift.1)
    }
    /// Smallest and largest label of a lattice.
    fn extent(&self, lattice: &Lattice) -> (Cell, Cell) {
        let (low, high) = lattice.extent();
        let (a, b) = (self.id(low), self.id(high));
        ((a.0.min(b.0), a.1.min(b.1)), (a.0.max(b.0), a.1.max(b.1)))
    }
    /// The change that leads from `self` to `other`.
    fn to(self, other: Self) -> Relabelling {
        let quarter_turns = (other.quarter_turns + 4 - self.quarter_turns) % 4;
        let moved = turned(quarter_turns, self.shift);
        let (columns, rows) = (other.shift.0 - moved.0, other.shift.1 - moved.1);
        Relabelling { quarter_turns, columns, rows, two_levels: false }
    }
}

pub(super) fn label(image: &str, detection: &Detection, target: &Grid) -> Result<Labelling> {
    let dots = Dots::new(detection);
    let free = vec![true; dots.len()];
    let found = if dots.len() < FEWEST { None } else { lattice::find(&dots, &free, Between::Nothing) };
    let Some(mut lattice) = found.filter(|l| l.nodes.len() >= FEWEST) else {
        return Err(no_grid(image, detection));
    };
    let seen = lattice.nodes.len();
    let sightings = sightings(&dots, detection, &mut lattice, &target.marks);
    if lattice.nodes.len() < FEWEST {
        return Err(pattern_error(
            image,
            format!(
                "of {seen} discs on a square grid {} differ in size from their neighbours by more than dots of one target do, and {FEWEST} are needed; \
                 check that the image shows the target described",
                seen - lattice.nodes.len()
            ),
        ));
    }
    let mut out = Labelling::default();
    let mut placements = placements(image, &lattice, &sightings, target, &mut out)?;
    // Up in the image is the last resort, and the order of preference among the alternatives.
    let up = |p: &Placement| lattice.upness(&dots, p.quarter_turns);
    placements.sort_by(|a, b| up(b).total_cmp(&up(a)).then(a.quarter_turns.cmp(&b.quarter_turns)));
    let Some(best) = placements.first().copied() else {
        return Err(crate::Error::Bug("no way to lay the labels over the grid".into()));
    };
    if placements.len() > 1 {
        out.warnings.push(format!(
            "the axes are taken from the image (target y up), {} other turns are possible; a mark or unequal columns and rows would decide",
            placements.len() - 1
        ));
    }
    out.alternatives = placements[1..].iter().map(|p| best.to(*p)).collect();
    // What makes a dot a mark, its size or the hole in it, makes its contour another than that of the others.
    let marked = |cell: &Cell| sightings.iter().any(|s| s.cell == *cell);
    for (cell, k) in &lattice.nodes {
        let (column, row) = best.id(*cell);
        match marked(cell) {
            true => out.marks.push(*k),
            false => out.discs.push(LabelledDisc { disc: *k, id: DotId { column, row, level: 0 } }),
        }
    }
    Ok(out)
}

fn no_grid(image: &str, detection: &Detection) -> crate::Error {
    let found = detection.discs.len();
    if found < FEWEST {
        let hint = format!("{}; light the target evenly and focus it", rejected_in_words(detection));
        return Insufficient::TooFewDiscs { image: image.to_owned(), found, needed: FEWEST, hint }.into();
    }
    pattern_error(
        image,
        format!(
            "{found} discs were found, but no four of them lie on a square grid ({}); check the kind of target and its polarity",
            rejected_in_words(detection)
        ),
    )
}

/// Squares and triangles in the place of a dot, within the lattice or beside its rim.
fn shapes_in_place(dots: &Dots, detection: &Detection, lattice: &Lattice, marks: &[Mark]) -> Vec<Sighting> {
    let (low, high) = lattice.extent();
    let one = |shape: &Shape| {
        let p = Vector2::new(shape.center_px.u_px, shape.center_px.v_px);
        let x = marks.iter().any(|m| m.kind == shape.mark).then(|| lattice.locate(dots, &p))??;
        let cell = (x.x.round() as i32, x.y.round() as i32);
        let off = (x - Vector2::new(f64::from(cell.0), f64::from(cell.1))).norm();
        let inside = (low.0 - 1..=high.0 + 1).contains(&cell.0) && (low.1 - 1..=high.1 + 1).contains(&cell.1);
        let free = !lattice.nodes.contains_key(&cell);
        (off < IN_PLACE && inside && free).then_some(Sighting { cell, kind: shape.mark })
    };
    detection.shapes.iter().filter_map(one).collect()
}

/// Marks on the lattice; dots whose size is neither the grid's nor a mark's leave the lattice.
fn sightings(dots: &Dots, detection: &Detection, lattice: &mut Lattice, marks: &[Mark]) -> Vec<Sighting> {
    let wanted = |kind: MarkKind| marks.iter().any(|m| m.kind == kind);
    let mut out = Vec::new();
    let mut large: Vec<(f64, Cell)> = Vec::new();
    let mut odd: Vec<Cell> = Vec::new();
    for (cell, k) in &lattice.nodes {
        let near: Vec<f64> = (cell.0 - 2..=cell.0 + 2)
            .flat_map(|i| lattice.nodes.range((i, cell.1 - 2)..=(i, cell.1 + 2)))
            .filter(|(c, _)| *c != cell)
            .map(|(_, n)| dots.radius(*n))
            .collect();
        let ratio = dots.radius(*k) / median(near);
        match detection.discs[*k].mark {
            Some(kind) if wanted(kind) => out.push(Sighting { cell: *cell, kind }),
            _ if ratio > LARGE && wanted(MarkKind::Large) => large.push((ratio, *cell)),
            _ if ratio < EQUAL.0 || ratio > EQUAL.1 => odd.push(*cell),
            _ => {}
        }
    }
    let expected = marks.iter().filter(|m| m.kind == MarkKind::Large).count();
    large.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    odd.extend(large.iter().skip(expected).map(|(_, cell)| *cell));
    out.extend(large.iter().take(expected).map(|(_, cell)| Sighting { cell: *cell, kind: MarkKind::Large }));
    odd.iter().for_each(|cell| {
        lattice.nodes.remove(cell);
    });
    out.extend(shapes_in_place(dots, detection, lattice, marks));
    out
}

/// All ways to lay the labels that agree best with what was seen.
fn placements(
    image: &str,
    lattice: &Lattice,
    sightings: &[Sighting],
    target: &Grid,
    out: &mut Labelling,
) -> Result<Vec<Placement>> {
    if target.marks.is_empty() {
        return unmarked(image, lattice, target, out);
    }
    let (matched, best) = by_marks(sightings, &target.marks, false);
    let (mirrored, _) = by_marks(sightings, &target.marks, true);
    if mirrored > matched {
        return Err(pattern_error(
            image,
            format!(
                "{mirrored} marks fit the target only as a mirror image: the image is mirrored, or the plate is seen from behind; \
                 turn the image over, or exchange the x and y marks in the description of the target"
            ),
        ));
    }
    let needed = target.marks.len();
    if matched == 0 {
        return Err(pattern_error(
            image,
            format!(
                "a grid of {} dots was found, but none of its {needed} marks; show the marks in every image, or describe the target without marks",
                lattice.nodes.len()
            ),
        ));
    }
    if matched < needed || sightings.len() > matched {
        out.warnings.push(format!("{matched} of {needed} marks found, {} dots look like marks", sightings.len()));
    }
    let best = if best.len() > 1 {
        let fitting: Vec<_> = best.iter().copied().filter(|p| fits_size(p, lattice, target)).collect();
        if fitting.is_empty() {
            return Err(larger_than_stated(image, lattice, target));
        }
        fitting
    } else {
        best
    };
    let best = kept(best, |p| starts_at_origin(p, lattice));
    let distinct_turns = (0..4).all(|k| best.iter().filter(|p| p.quarter_turns == k).count() <= 1);
    if !distinct_turns {
        return Err(pattern_error(
            image,
            format!(
                "only {matched} of {needed} marks were found, which leaves the origin open between {} places; show more marks in every image",
                best.len()
            ),
        ));
    }
    Ok(best)
}

/// Refusal where no turn of the lattice fits the stated size.
fn larger_than_stated(image: &str, lattice: &Lattice, target: &Grid) -> crate::Error {
    let (low, high) = lattice.extent();
    let stated = |n: Option<usize>| n.map_or("any number of".into(), |n| n.to_string());
    pattern_error(
        image,
        format!(
            "the grid seen spans {} x {} dots, more than the stated {} columns and {} rows; correct columns and rows, or cover what looks like dots beside the grid",
            high.0 - low.0 + 1,
            high.1 - low.1 + 1,
            stated(target.columns),
            stated(target.rows)
        ),
    )
}

/// Those that pass, or all where none passes (a wish, not a condition).
fn kept(all: Vec<Placement>, wish: impl Fn(&Placement) -> bool) -> Vec<Placement> {
    let passed: Vec<_> = all.iter().copied().filter(|p| wish(p)).collect();
    if passed.is_empty() { all } else { passed }
}

/// Whether the lattice is not larger than the stated grid.
fn fits_size(p: &Placement, lattice: &Lattice, target: &Grid) -> bool {
    let (low, high) = p.extent(lattice);
    let within = |span: i32, count: Option<usize>| count.is_none_or(|n| (span as usize) < n);
    within(high.0 - low.0, target.columns) && within(high.1 - low.1, target.rows)
}

/// Whether all labels count up from the origin: the mark in a corner.
fn starts_at_origin(p: &Placement, lattice: &Lattice) -> bool {
    let (low, _) = p.extent(lattice);
    low.0 >= 0 && low.1 >= 0
}

/// Placements (or their mirror images) under which most sightings are marks of the target, and how many are.
fn by_marks(sightings: &[Sighting], marks: &[Mark], mirror: bool) -> (usize, Vec<Placement>) {
    let flip = |c: Cell| if mirror { (c.1, c.0) } else { c };
    let mut best: (usize, Vec<Placement>) = (0, Vec::new());
    for quarter_turns in 0..4 {
        for s in sightings {
            for m in marks.iter().filter(|m| m.kind == s.kind) {
                let t = turned(quarter_turns, flip(s.cell));
                let p = Placement { quarter_turns, shift: (m.at.column - t.0, m.at.row - t.1) };
                let is_mark = |s: &&Sighting| {
                    let id = p.id(flip(s.cell));
                    marks.iter().any(|m| m.kind == s.kind && (m.at.column, m.at.row) == id)
                };
                let matched = sightings.iter().filter(is_mark).count();
                if matched > best.0 {
                    best = (matched, Vec::new());
                }
                if matched == best.0 && !best.1.contains(&p) {
                    best.1.push(p);
                }
            }
        }
    }
    best
}

/// Without marks the lower left dot is the origin, in every turn that the stated size allows.
fn unmarked(image: &str, lattice: &Lattice, target: &Grid, out: &mut Labelling) -> Result<Vec<Placement>> {
    let all: Vec<Placement> = (0..4)
        .map(|quarter_turns| {
            let (low, _) = Placement { quarter_turns, shift: (0, 0) }.extent(lattice);
            Placement { quarter_turns, shift: (-low.0, -low.1) }
        })
        .collect();
    let whole = |p: &Placement| {
        let (_, high) = p.extent(lattice);
        target.columns == Some(high.0 as usize + 1) && target.rows == Some(high.1 as usize + 1)
    };
    if !all.iter().any(whole) {
        out.origin_is_arbitrary = true;
        out.warnings.push(
            "the grid has no marks and is not seen whole: its lower left dot in this image is called (0, 0); the same dot may be called otherwise in other images".into(),
        );
        let fitting: Vec<_> = all.into_iter().filter(|p| fits_size(p, lattice, target)).collect();
        return if fitting.is_empty() { Err(larger_than_stated(image, lattice, target)) } else { Ok(fitting) };
    }
    Ok(kept(all, whole))
}
