//! The pixels around one ellipse with their distances from it, eight at a time.

use crate::conic::{Ellipse, Frame};
use crate::detect::contour::{Contour, diamond};
use crate::image::{GrayView, Samples};

/// Pixels worked on together.
pub(crate) const LANES: usize = 8;

/// Pixels of the band around one ellipse, structure of arrays padded to whole lanes, reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Band {
    pub(crate) grey: Vec<f64>,
    /// Signed distance from the ellipse, px; NaN in the padding and beyond the reach.
    pub(crate) distance: Vec<f64>,
    /// Curvature of the ellipse at the foot point, 1/px.
    pub(crate) curvature: Vec<f64>,
    /// Sector of the foot point.
    pub(crate) sector: Vec<u32>,
    /// Eccentric angle of the foot point: cosine and sine.
    pub(crate) cos: Vec<f64>,
    pub(crate) sin: Vec<f64>,
    /// Place in the frame of the axes, px.
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
}

/// How far the band reaches from the ellipse, px.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    pub(crate) inner_px: f64,
    pub(crate) outer_px: f64,
}

impl Band {
    /// Number of places, padding included.
    pub(crate) fn len(&self) -> usize {
        self.grey.len()
    }

    /// Collects the pixels of the image within `reach` of the ellipse, which `contour` has cut into sectors.
    pub(crate) fn collect(&mut self, view: &GrayView, ellipse: &Ellipse, contour: &Contour, reach: Reach) {
        let frame = Frame::new(ellipse);
        for list in [&mut self.grey, &mut self.x, &mut self.y] {
            list.clear();
        }
        // The parallel curve of an ellipse lies inside the ellipse with both axes grown by this much.
        let bulge = (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt());
        let (outer, inner) = (reach.outer_px * bulge, reach.inner_px * bulge);
        let (ao, bo) = (frame.a + outer, frame.b + outer);
        let (ai, bi) = (frame.a - inner, frame.b - inner);
        let half_height = (ao * frame.sin).hypot(bo * frame.cos);
        let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
        let (v_lo, v_hi) = ((frame.v0 - half_height).ceil().max(0.0), (frame.v0 + half_height).floor().min(v_last));
        let rows = if v_hi < v_lo { 0..0 } else { v_lo as usize..v_hi as usize + 1 };
        for v in rows {
            let dv = v as f64 - frame.v0;
            let Some((lo, hi)) = frame.row_span(dv, ao, bo) else { continue };
            let (lo, hi) = ((frame.u0 + lo).ceil().max(0.0), (frame.u0 + hi).floor().min(u_last));
            if hi < lo {
                continue;
            }
            let (lo, hi) = (lo as usize, hi as usize);
            let hole = if ai > 0.0 && bi > 0.0 { frame.row_span(dv, ai, bi) } else { None };
            match hole {
                // Columns strictly inside the hole are left out.
                Some((l, h)) => {
                    let left = (frame.u0 + l).floor().clamp(lo as f64 - 1.0, hi as f64);
                    let right = (frame.u0 + h).ceil().clamp(left + 1.0, hi as f64 + 1.0);
                    self.push(view, &frame, v, lo, (left + 1.0) as usize);
                    self.push(view, &frame, v, right as usize, hi + 1);
                }
                None => self.push(view, &frame, v, lo, hi + 1),
            }
        }
        self.measure(&frame, contour, reach);
    }

    /// Takes the columns `from..to` of a row.
    fn push(&mut self, view: &GrayView, frame: &Frame, v: usize, from: usize, to: usize) {
        if from >= to {
            return;
        }
        let row = v * view.stride();
        match view.samples() {
            Samples::U8(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x))),
            Samples::U16(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x))),
            Samples::F32(s) => self.grey.extend(s[row + from..row + to].iter().map(|x| f64::from(*x))),
        }
        let dv = v as f64 - frame.v0;
        let (x0, y0) = (frame.sin * dv - frame.cos * frame.u0, frame.cos * dv + frame.sin * frame.u0);
        self.x.extend((from..to).map(|u| x0 + frame.cos * u as f64));
        self.y.extend((from..to).map(|u| y0 - frame.sin * u as f64));
    }

    /// Leaves only pixels within the reach and in sectors that are kept; returns how many. The padding to whole lanes repeats the first.
    pub(crate) fn compact(&mut self, keep: &[bool]) -> usize {
        let mut n = 0;
        for i in 0..self.len() {
            if self.distance[i].is_nan() || !keep[self.sector[i] as usize] {
                continue;
            }
            for list in self.lists() {
                list[n] = list[i];
            }
            self.sector[n] = self.sector[i];
            n += 1;
        }
        let padded = n.div_ceil(LANES) * LANES;
        self.sector.truncate(padded);
        self.sector[n..].fill(0);
        for list in self.lists() {
            list.truncate(padded);
            let first = list.first().copied().unwrap_or(0.0);
            list[n..].fill(first);
        }
        n
    }

    fn lists(&mut self) -> [&mut Vec<f64>; 7] {
        let Self { grey, distance, curvature, cos, sin, x, y, .. } = self;
        [grey, distance, curvature, cos, sin, x, y]
    }

    /// Distances, curvatures and sectors of all pixels.
    fn measure(&mut self, frame: &Frame, contour: &Contour, reach: Reach) {
        let seen = self.grey.len();
        let n = seen.div_ceil(LANES) * LANES;
        self.grey.resize(n, 0.0);
        self.x.resize(n, frame.a);
        self.y.resize(n, 0.0);
        for list in [&mut self.distance, &mut self.curvature, &mut self.cos, &mut self.sin] {
            list.clear();
            list.resize(n, 0.0);
        }
        self.sector.clear();
        for at in (0..n).step_by(LANES) {
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            x.copy_from_slice(&self.x[at..at + LANES]);
            y.copy_from_slice(&self.y[at..at + LANES]);
            let feet = frame.feet(&x, &y);
            for i in 0..LANES {
                let d = feet.distance[i];
                let mut kept = at + i < seen && d >= -reach.inner_px && d <= reach.outer_px;
                let mut sector = 0;
                if kept {
                    sector = contour.sector(diamond(feet.cos[i], feet.sin[i]));
                    kept = d <= contour.outer_px[sector];
                }
                self.distance[at + i] = if kept { d } else { f64::NAN };
                self.sector.push(sector as u32);
            }
            self.curvature[at..at + LANES].copy_from_slice(&feet.curvature);
            self.cos[at..at + LANES].copy_from_slice(&feet.cos);
            self.sin[at..at + LANES].copy_from_slice(&feet.sin);
        }
    }
}
