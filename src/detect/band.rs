//! The pixels around one ellipse with their distances from it, eight at a time.

use crate::conic::{Cut, Ellipse, Frame};
use crate::detect::contour::{Contour, diamond};
use crate::image::{GrayView, Samples};
use crate::lanes::{self, Kernel};
use std::f64::consts::SQRT_2;

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
        // So does the rectangle around it inside the ellipse around that: less of a flat one.
        let (box_a, box_b) = (frame.a + reach.outer_px, frame.b + reach.outer_px);
        let (ao, bo) = if (frame.a + outer) * (frame.b + outer) < 2.0 * box_a * box_b {
            (frame.a + outer, frame.b + outer)
        } else {
            (SQRT_2 * box_a, SQRT_2 * box_b)
        };
        let (ai, bi) = (frame.a - inner, frame.b - inner);
        let half_height = (ao * frame.sin).hypot(bo * frame.cos);
        let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
        let (v_lo, v_hi) = ((frame.v0 - half_height).ceil().max(0.0), (frame.v0 + half_height).floor().min(v_last));
        let rows = if v_hi < v_lo { 0..0 } else { v_lo as usize..v_hi as usize + 1 };
        let (whole, hole) = (Cut::new(&frame, ao, bo), Cut::new(&frame, ai, bi));
        for v in rows {
            let dv = v as f64 - frame.v0;
            let Some((lo, hi)) = whole.span(dv) else { continue };
            let (lo, hi) = ((frame.u0 + lo).ceil().max(0.0), (frame.u0 + hi).floor().min(u_last));
            if hi < lo {
                continue;
            }
            let (lo, hi) = (lo as usize, hi as usize);
            match hole.span(dv) {
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
        self.sector.resize(n, 0);
        lanes::run(Measure { band: self, seen, frame, contour, reach });
    }
}

/// Foot points of all pixels and what follows from them, as wide as the processor is.
struct Measure<'a> {
    band: &'a mut Band,
    /// Pixels; behind them padding.
    seen: usize,
    frame: &'a Frame,
    contour: &'a Contour,
    reach: Reach,
}

impl Kernel for Measure<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        let Self { band, seen, frame, contour, reach } = self;
        for at in (0..band.grey.len()).step_by(LANES) {
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            x.copy_from_slice(&band.x[at..at + LANES]);
            y.copy_from_slice(&band.y[at..at + LANES]);
            let feet = frame.feet(&x, &y);
            for i in 0..LANES {
                let d = feet.distance[i];
                let mut kept = at + i < seen && d >= -reach.inner_px && d <= reach.outer_px;
                if kept {
                    let sector = contour.sector(diamond(feet.cos[i], feet.sin[i]));
                    band.sector[at + i] = sector as u32;
                    kept = d <= contour.outer_px[sector];
                }
                band.distance[at + i] = if kept { d } else { f64::NAN };
            }
            band.curvature[at..at + LANES].copy_from_slice(&feet.curvature);
            band.cos[at..at + LANES].copy_from_slice(&feet.cos);
            band.sin[at..at + LANES].copy_from_slice(&feet.sin);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pixel;

    const SIZE: usize = 64;

    fn collected(e: &Ellipse, reach_px: f64) -> (Band, Contour) {
        let grey = vec![7u8; SIZE * SIZE];
        let view = GrayView::new(Samples::U8(&grey), SIZE, SIZE, SIZE).unwrap();
        let (mut band, mut contour) = (Band::default(), Contour::default());
        contour.cut(e, &[]);
        band.collect(&view, e, &contour, Reach { inner_px: reach_px, outer_px: reach_px });
        (band, contour)
    }

    /// Every pixel within the reach, and its foot point as plain numbers have it, to the bit.
    #[test]
    fn the_band_holds_what_is_near_and_measures_it_alike_at_any_width() {
        let e = Ellipse { center_px: Pixel::new(30.3, 33.1), semi_major_px: 14.2, semi_minor_px: 9.7, angle_rad: 0.6 };
        let (reach_px, frame) = (3.0, Frame::new(&e));
        let (band, _) = collected(&e, reach_px);
        let near = (0..SIZE * SIZE)
            .filter(|i| frame.foot((i % SIZE) as f64, (i / SIZE) as f64, None).distance.abs() < reach_px)
            .count();
        assert_eq!(band.distance.iter().filter(|d| d.is_finite()).count(), near);
        for at in (0..band.len()).step_by(LANES) {
            let eight = |list: &[f64]| -> [f64; LANES] { list[at..at + LANES].try_into().unwrap() };
            let feet = frame.feet(&eight(&band.x), &eight(&band.y));
            let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| a.is_nan() || a.to_bits() == b.to_bits());
            assert!(same(&eight(&band.distance), &feet.distance) && same(&eight(&band.curvature), &feet.curvature));
            assert!(same(&eight(&band.cos), &feet.cos) && same(&eight(&band.sin), &feet.sin));
            assert!(feet.cos.iter().zip(&feet.sin).all(|(c, s)| (c.hypot(*s) - 1.0).abs() < 1e-12));
        }
    }

    /// An ellipse that has all but collapsed: its band was the whole image.
    #[test]
    fn the_band_of_a_flat_ellipse_stays_near_it() {
        let e = Ellipse { center_px: Pixel::new(32.0, 32.0), semi_major_px: 5.0, semi_minor_px: 1e-4, angle_rad: 0.3 };
        let (band, _) = collected(&e, 4.0);
        assert!(band.len() < 300, "{} pixels", band.len());
        // All but a line.
        let (sin, cos) = e.angle_rad.sin_cos();
        let away = |u: f64, v: f64| {
            let (x, y) = (cos * u + sin * v, cos * v - sin * u);
            (x.abs() - e.semi_major_px).max(0.0).hypot(y)
        };
        let near = (0..SIZE * SIZE).filter(|i| away((i % SIZE) as f64 - 32.0, (i / SIZE) as f64 - 32.0) < 4.0).count();
        assert_eq!(band.distance.iter().filter(|d| d.is_finite()).count(), near);
    }
}
