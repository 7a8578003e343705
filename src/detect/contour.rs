//! One ellipse cut into sectors of equal arc length, with what each sector needs to know of the geometry.
//!
//! A pixel finds its sector from the unit vector `(c, s)` of its foot point's eccentric angle without trigonometry, by the angle on
//! the diamond `|c| + |s| = 1`, which grows from 0 to 4 with the eccentric angle.

use crate::conic::{Ellipse, Frame};
use std::f64::consts::TAU;

/// Length of contour per sector, px.
const SECTOR_PX: f64 = 1.75;
/// Share of the gap to a neighbour that a sector may look into.
pub(crate) const NEIGHBOUR: f64 = 0.6;
/// Gap that is always granted, px.
const LEAST_GAP_PX: f64 = 2.0;
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
    /// First sector that a cell of the diamond may belong to.
    first: Vec<u32>,
    unit: Vec<(f64, f64)>,
    arc: Vec<f64>,
    /// Length of the contour, px.
    pub(crate) perimeter_px: f64,
}

/// Angle on the diamond, 0 to 4.
#[inline]
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
        self.lengths(e);
        let count = ((self.perimeter_px / SECTOR_PX).round() as usize).max(8);
        for list in [
            &mut self.cos,
            &mut self.sin,
            &mut self.u,
            &mut self.v,
            &mut self.normal_u,
            &mut self.normal_v,
            &mut self.end,
            &mut self.outer_px,
            &mut self.turn,
        ] {
            list.clear();
        }
        self.row.clear();
        self.climb.clear();
        let frame = Frame::new(e);
        for k in 0..count {
            let (s, c) = self.angle_at((k as f64 + 0.5) / count as f64).sin_cos();
            let foot = frame.on_contour(c, s);
            self.cos.push(c);
            self.sin.push(s);
            self.u.push(foot.u);
            self.v.push(foot.v);
            self.normal_u.push(foot.normal_u);
            self.normal_v.push(foot.normal_v);
            self.climb.push(foot.climb);
            self.turn.push(1.0 / (e.semi_major_px * s).hypot(e.semi_minor_px * c));
            self.row.push(foot.row);
            let (s, c) = self.angle_at((k as f64 + 1.0) / count as f64).sin_cos();
            self.end.push(if k + 1 == count { 4.0 } else { diamond(c, s) });
        }
        self.outer_px.resize(count, f64::INFINITY);
        for neighbour in neighbours {
            let other = Frame::new(neighbour);
            for k in 0..count {
                let gap = other.foot(self.u[k], self.v[k], None).distance;
                self.outer_px[k] = self.outer_px[k].min(NEIGHBOUR * gap.max(LEAST_GAP_PX));
            }
        }
        let cells = 2 * count;
        self.first.clear();
        let mut k = 0;
        for cell in 0..=cells {
            while k + 1 < count && self.end[k] <= 4.0 * cell as f64 / cells as f64 {
                k += 1;
            }
            self.first.push(k as u32);
        }
    }

    /// Sector of an angle on the diamond.
    #[inline]
    pub(crate) fn sector(&self, at: f64) -> usize {
        let cells = self.first.len() - 1;
        let mut k = self.first[((0.25 * at * cells as f64) as usize).min(cells)] as usize;
        while k + 1 < self.end.len() && at > self.end[k] {
            k += 1;
        }
        k
    }

    /// Arc length up to equal steps of the eccentric angle, px.
    fn lengths(&mut self, e: &Ellipse) {
        if self.unit.is_empty() {
            self.unit.extend((0..ARC_STEPS).map(|i| ((i as f64 + 0.5) / ARC_STEPS as f64 * TAU).sin_cos()));
        }
        let (a, b) = (e.semi_major_px, e.semi_minor_px);
        let mut sum = 0.0;
        self.arc.clear();
        self.arc.push(0.0);
        for (s, c) in &self.unit {
            sum += ((a * s) * (a * s) + (b * c) * (b * c)).sqrt();
            self.arc.push(sum);
        }
        self.perimeter_px = sum * TAU / ARC_STEPS as f64;
    }

    fn angle_at(&self, share: f64) -> f64 {
        let wanted = share * self.arc[ARC_STEPS];
        let j = self.arc.partition_point(|x| *x <= wanted).clamp(1, ARC_STEPS);
        let f = (wanted - self.arc[j - 1]) / (self.arc[j] - self.arc[j - 1]);
        (j as f64 - 1.0 + f) / ARC_STEPS as f64 * TAU
    }
}
