//! One ellipse cut into sectors of equal arc length, with what each sector needs to know of the geometry.
//!
//! A pixel finds its sector from the unit vector `(c, s)` of its foot point's eccentric angle without trigonometry, by the angle on
//! the diamond `|c| + |s| = 1`, which grows from 0 to 4 with the eccentric angle.

use crate::conic::{Ellipse, Frame};
use crate::detect::level::ROUND;
use crate::lanes::{self, GROUP, Kernel};
use std::f64::consts::TAU;

/// Length of contour per sector, px.
const SECTOR_PX: f64 = 1.75;
/// Share of the gap to a neighbour that a sector may look into.
pub(crate) const NEIGHBOUR: f64 = 0.6;
/// Gap that is always granted, px.
const LEAST_GAP_PX: f64 = 2.0;
/// How far a sector looks where a neighbour is `gap` px away, px.
#[inline(always)]
pub(crate) fn towards_px(gap: f64) -> f64 {
    NEIGHBOUR * gap.max(LEAST_GAP_PX)
}

/// Entries of the table from eccentric angle to arc length.
const ARC_STEPS: usize = 256;

/// The sectors of one ellipse, structure of arrays, reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Contour {
    /// Eccentric angle of the middle of each sector: cosine and sine.
    pub(crate) cos: Vec<f64>,
    pub(crate) sin: Vec<f64>,
    /// Middle of each sector, px.
    pub(crate) u: Vec<f64>,
    pub(crate) v: Vec<f64>,
    /// Outward normal there.
    pub(crate) normal_u: Vec<f64>,
    pub(crate) normal_v: Vec<f64>,
    /// The same in the frame of the axes, divided by the semi-axes: d(x/a, y/b)/d(distance), 1/px.
    pub(crate) climb: Vec<[f64; 2]>,
    /// d(eccentric angle)/d(arc length), 1/px.
    pub(crate) turn: Vec<f64>,
    /// Derivative of the distance of a fixed point with respect to the regular coordinates of the ellipse.
    pub(crate) row: Vec<[f64; 5]>,
    /// How far outwards a sector may look without meeting a neighbour, px.
    pub(crate) outer_px: Vec<f64>,
    /// End of each sector on the diamond.
    end: Vec<f64>,
    /// Equal cells of the diamond.
    cells: Vec<Cell>,
    unit: Vec<(f64, f64)>,
    arc: Vec<f64>,
    /// The step of the table in which the contour is so many half sectors long.
    step: Vec<u16>,
    /// Length of the contour, px.
    pub(crate) perimeter_px: f64,
}

/// One of equal cells of the diamond.
#[derive(Debug, Clone, Copy)]
struct Cell {
    /// First sector that reaches into it, and where this ends.
    first: usize,
    end: f64,
}

/// The cells of a contour.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cells<'a> {
    all: &'a [Cell],
    last: usize,
}

impl Cells<'_> {
    /// Sector of an angle on the diamond, whose cell is known.
    #[inline(always)]
    pub(crate) fn sector(&self, cell: usize, at: f64) -> usize {
        let cell = &self.all[cell.min(self.last)];
        // No cell, 1/n long for n sectors, reaches into a third sector. A sector has the arc L/n with L >= 4 a, so the eccentric angle
        // turns by L/(n a) >= 4/n at least, and the angle on the diamond by half of that, its slope being (|c| + |s|)^-2 >= 1/2.
        cell.first + usize::from(at > cell.end)
    }
}

/// Angle on the diamond, 0 to 4.
#[inline(always)]
pub(crate) fn diamond(c: f64, s: f64) -> f64 {
    let x = s / (c.abs() + s.abs());
    if c < 0.0 {
        2.0 - x
    } else if s < 0.0 {
        4.0 + x
    } else {
        x
    }
}

impl Contour {
    /// Number of sectors.
    pub(crate) fn len(&self) -> usize {
        self.cos.len()
    }

    /// Length of the gradient, along the normal, of a place in units of the semi-axes, 1/px.
    #[inline]
    pub(crate) fn steepness(&self, k: usize) -> f64 {
        self.climb[k][0].hypot(self.climb[k][1])
    }

    /// Cuts the ellipse anew; sectors do not look beyond the middle between them and the `neighbours`.
    pub(crate) fn cut(&mut self, e: &Ellipse, neighbours: &[Ellipse]) {
        self.cut_frame(&Frame::new(e), neighbours);
    }

    /// The same of the ellipse of a frame.
    pub(crate) fn cut_frame(&mut self, frame: &Frame, neighbours: &[Ellipse]) {
        lanes::run(Cut { contour: self, frame });
        self.outer_px.clear();
        self.outer_px.resize(self.len(), f64::INFINITY);
        if !neighbours.is_empty() {
            lanes::run(Gaps { contour: self, neighbours });
        }
        let count = self.len();
        self.cells.clear();
        for (first, end) in self.end[..count - 1].iter().enumerate() {
            // Cells are 1/n long and begin before the end of their first sector.
            let whole = (end * count as f64) as usize;
            let before = whole + usize::from((whole as f64) < end * count as f64);
            self.cells.resize(before.max(self.cells.len()), Cell { first, end: *end });
        }
        self.cells.resize(4 * count + 1, Cell { first: count - 1, end: self.end[count - 1] });
    }

    /// Sector of an angle on the diamond.
    #[inline(always)]
    pub(crate) fn sector(&self, at: f64) -> usize {
        self.cells().sector((at * self.cells_per_angle()) as usize, at)
    }

    /// The cells, for angles whose cell is known.
    pub(crate) fn cells(&self) -> Cells<'_> {
        Cells { all: &self.cells, last: self.cells.len() - 1 }
    }

    /// Equal cells of the diamond in a unit of the angle.
    pub(crate) fn cells_per_angle(&self) -> f64 {
        0.25 * (self.cells.len() - 1) as f64
    }

    /// Arc length up to equal steps of the eccentric angle, px.
    #[inline(always)]
    fn lengths(&mut self, Frame { a, b, .. }: &Frame) {
        if self.unit.is_empty() {
            self.unit.extend((0..ARC_STEPS).map(|i| ((i as f64 + 0.5) / ARC_STEPS as f64 * TAU).sin_cos()));
        }
        let mut sum = 0.0;
        self.arc.resize(ARC_STEPS + 1, 0.0);
        // The quarters are alike, or mirrored.
        const QUARTER: usize = ARC_STEPS / 4;
        let mut length = [0.0; QUARTER];
        for (length, (s, c)) in length.iter_mut().zip(&self.unit) {
            *length = ((a * s) * (a * s) + (b * c) * (b * c)).sqrt();
        }
        for (quarter, arc) in self.arc[1..].as_chunks_mut::<QUARTER>().0.iter_mut().enumerate() {
            for i in 0..QUARTER {
                sum += length[if quarter % 2 == 0 { i } else { QUARTER - 1 - i }];
                arc[i] = sum;
            }
        }
        self.perimeter_px = sum * TAU / ARC_STEPS as f64;
    }

    /// Room for so many sectors.
    fn resize(&mut self, count: usize) {
        for list in [
            &mut self.cos,
            &mut self.sin,
            &mut self.u,
            &mut self.v,
            &mut self.normal_u,
            &mut self.normal_v,
            &mut self.end,
            &mut self.turn,
        ] {
            list.resize(count, 0.0);
        }
        self.row.resize(count, [0.0; 5]);
        self.climb.resize(count, [0.0; 2]);
    }
}

/// Of so many equal parts of a contour the step of the table in which each ends, from that of length zero on. Without a search, whose ends no processor
/// foretells: each step knows the first part that ends behind where it begins.
#[inline(always)]
fn find_steps(arc: &[f64; ARC_STEPS + 1], parts: usize, step: &mut Vec<u16>) {
    step.clear();
    step.resize(parts + 1, 0);
    let per_px = parts as f64 / arc[ARC_STEPS];
    let mut part = [0; ARC_STEPS];
    for i in 0..ARC_STEPS {
        part[i] = ((arc[i] * per_px).ceil() + ROUND).to_bits() as u32;
    }
    for (i, part) in part.iter().enumerate() {
        step[(*part as usize).min(parts)] = i as u16;
    }
    let mut last = 0;
    for step in step {
        last = last.max(*step);
        *step = last;
    }
}

/// Sines and cosines of the eccentric angles up to which the contour is so long, which lie in these steps.
#[inline(always)]
fn units_at(
    (arc, unit): (&[f64; ARC_STEPS + 1], &[(f64, f64); ARC_STEPS]),
    wanted: &[f64; GROUP],
    step: &[u16; GROUP],
) -> [[f64; GROUP]; 2] {
    let (mut begin, mut end, mut s, mut c) = ([0.0; GROUP], [0.0; GROUP], [0.0; GROUP], [0.0; GROUP]);
    for i in 0..GROUP {
        let at = usize::from(step[i]).min(ARC_STEPS - 1);
        (begin[i], end[i], (s[i], c[i])) = (arc[at], arc[at + 1], unit[at]);
    }
    for i in 0..GROUP {
        let f = (wanted[i] - begin[i]) / (end[i] - begin[i]);
        // From the middle of the step: the angle is below 0.013, and what the series leave out below 1e-16.
        let d = (f - 0.5) * (TAU / ARC_STEPS as f64);
        let d2 = d * d;
        let sin = d * (1.0 - d2 * (1.0 / 6.0) * (1.0 - d2 * (1.0 / 20.0)));
        let cos = 1.0 - 0.5 * d2 * (1.0 - d2 * (1.0 / 12.0) * (1.0 - d2 * (1.0 / 30.0)));
        (s[i], c[i]) = (s[i] * cos + c[i] * sin, c[i] * cos - s[i] * sin);
    }
    [s, c]
}

/// Cuts an ellipse into sectors, as wide as the processor is.
struct Cut<'a> {
    contour: &'a mut Contour,
    frame: &'a Frame,
}

impl Kernel for Cut<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        let Self { contour, frame } = self;
        contour.lengths(frame);
        let count = ((contour.perimeter_px / SECTOR_PX).round() as usize).max(8);
        contour.resize(count);
        let Contour { cos, sin, u, v, normal_u, normal_v, end, turn, climb, row, arc, unit, step, .. } = contour;
        // Said so that no place needs to be checked.
        let [cos, sin, u, v, normal_u, normal_v, end, turn] =
            [cos, sin, u, v, normal_u, normal_v, end, turn].map(|list| &mut list[..count]);
        let (climb, row) = (&mut climb[..count], &mut row[..count]);
        if let (Some(arc), Some(unit)) = (arc.first_chunk(), unit.first_chunk()) {
            find_steps(arc, 2 * count, step);
            let half = arc[ARC_STEPS] / (2 * count) as f64;
            for from in (0..count).step_by(GROUP) {
                let n = GROUP.min(count - from);
                // Middles, then ends; what only fills the last group is the last once more.
                let mut found = [[[0.0; GROUP]; 2]; 2];
                for (of_end, found) in found.iter_mut().enumerate() {
                    let (mut wanted, mut steps) = ([0.0; GROUP], [0; GROUP]);
                    for i in 0..GROUP {
                        let part = 2 * (from + i.min(n - 1)) + 1 + of_end;
                        (wanted[i], steps[i]) = (part as f64 * half, step[part]);
                    }
                    *found = units_at((arc, unit), &wanted, &steps);
                }
                let [[s, c], [end_s, end_c]] = found;
                let mut ends = [0.0; GROUP];
                for i in 0..GROUP {
                    ends[i] = diamond(end_c[i], end_s[i]);
                }
                for (list, own) in [(&mut *sin, &s), (&mut *cos, &c), (&mut *end, &ends)] {
                    list[from..from + n].copy_from_slice(&own[..n]);
                }
            }
            end[count - 1] = 4.0;
        }
        for k in 0..count {
            let foot = frame.on_contour(cos[k], sin[k]);
            (u[k], v[k], normal_u[k], normal_v[k]) = (foot.u, foot.v, foot.normal_u, foot.normal_v);
            (climb[k], turn[k], row[k]) = (foot.climb, foot.turn, foot.row);
        }
    }
}

/// How far the sectors may look for the `neighbours`, as wide as the processor is.
struct Gaps<'a> {
    contour: &'a mut Contour,
    neighbours: &'a [Ellipse],
}

impl Kernel for Gaps<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        let Contour { u, v, outer_px, .. } = self.contour;
        for neighbour in self.neighbours {
            let other = Frame::new(neighbour);
            for at in (0..u.len()).step_by(GROUP) {
                let (mut x, mut y) = ([0.0; GROUP], [0.0; GROUP]);
                for i in 0..GROUP {
                    let k = (at + i).min(u.len() - 1);
                    (x[i], y[i]) = other.inside(u[k], v[k]);
                }
                let gap = other.feet(&x, &y).distance;
                for (outer, gap) in outer_px[at..].iter_mut().zip(gap) {
                    *outer = outer.min(towards_px(gap));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    /// Neighbours on two sides, by the plain foot points; the last group of sectors is not whole.
    #[test]
    fn sectors_look_no_further_than_a_part_of_the_gap() {
        let disc = |u: f64, v: f64| Ellipse {
            center_px: Pixel::new(u, v),
            semi_major_px: 9.0,
            semi_minor_px: 6.0,
            angle_rad: 0.4,
        };
        let (e, neighbours) = (disc(30.0, 30.0), [disc(52.0, 31.0), disc(29.0, 46.0)]);
        let mut contour = Contour::default();
        contour.cut(&e, &neighbours);
        assert!(!contour.len().is_multiple_of(GROUP), "{} sectors", contour.len());
        let frames = neighbours.map(|n| Frame::new(&n));
        for k in 0..contour.len() {
            let gap = |f: &Frame| f.foot(contour.u[k], contour.v[k], None).distance.max(LEAST_GAP_PX);
            let wanted = NEIGHBOUR * gap(&frames[0]).min(gap(&frames[1]));
            assert!((contour.outer_px[k] - wanted).abs() < 1e-5, "sector {k}: {} not {wanted}", contour.outer_px[k]);
        }
    }

    /// Sectors of one length, by chords of tiny steps along the contour.
    #[test]
    fn sectors_have_equal_lengths() {
        let e = Ellipse { center_px: Pixel::new(7.0, 9.0), semi_major_px: 24.0, semi_minor_px: 9.0, angle_rad: 0.3 };
        let mut contour = Contour::default();
        contour.cut(&e, &[]);
        let count = contour.len();
        let steps = 200_000;
        let mut lengths = vec![0.0; count];
        let frame = Frame::new(&e);
        for i in 0..steps {
            let t = (f64::from(i) + 0.5) / f64::from(steps) * TAU;
            let (s, c) = t.sin_cos();
            lengths[contour.sector(diamond(c, s))] += (frame.a * s).hypot(frame.b * c) * TAU / f64::from(steps);
        }
        let mean = contour.perimeter_px / count as f64;
        assert!(count > 50);
        lengths.iter().for_each(|x| assert!((x / mean - 1.0).abs() < 2e-3, "{x} of {mean}"));
        for k in 0..count {
            assert!((contour.cos[k].hypot(contour.sin[k]) - 1.0).abs() < 1e-14);
            assert_eq!(contour.sector(diamond(contour.cos[k], contour.sin[k])), k);
        }
    }

    /// The steps in which parts of a contour end against a search, on contours of few and many sectors.
    #[test]
    fn steps_are_those_of_a_search() {
        for (a, b) in [(3.0, 2.9), (13.0, 11.0), (40.0, 2.0), (300.0, 6.0), (2000.0, 1900.0)] {
            let e = Ellipse { center_px: Pixel::new(7.0, 9.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.3 };
            let mut contour = Contour::default();
            contour.cut(&e, &[]);
            let parts = 2 * contour.len();
            assert_eq!(contour.step.len(), parts + 1);
            for part in 1..parts {
                let length = part as f64 * contour.arc[ARC_STEPS] / parts as f64;
                let step = usize::from(contour.step[part]);
                let within = 1e-9 * length;
                assert!(
                    contour.arc[step] <= length + within && length <= contour.arc[step + 1] + within,
                    "{a} x {b} px, part {part} of {parts}"
                );
            }
        }
    }

    /// The table of cells against a search through all ends, however long the ellipse.
    #[test]
    fn cells_know_the_sector_of_every_angle() {
        let mut contour = Contour::default();
        for (a, b) in [(3.0, 2.9), (9.0, 3.0), (40.0, 2.0), (300.0, 6.0), (250.0, 249.0)] {
            let e = Ellipse { center_px: Pixel::new(7.0, 9.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.3 };
            contour.cut(&e, &[]);
            let count = contour.len();
            let between = (0..=100_000).map(|i| f64::from(i) / 25_000.0);
            for at in between.chain(contour.end.iter().copied()).chain([f64::NAN]) {
                let searched = (0..count - 1).find(|k| !(at > contour.end[*k])).unwrap_or(count - 1);
                assert_eq!(contour.sector(at), searched, "{a} x {b} px, {count} sectors, at {at}");
            }
        }
    }
}
