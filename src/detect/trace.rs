//! Zero lines of an image, followed to subpixel.
//!
//! Marching squares: a crossing lies on a lattice edge between a positive and a non-positive pixel, placed by linear
//! interpolation; from cell to cell the line is followed until it closes or leaves the image.

use crate::conic::{Cut, Ellipse, Frame};
use crate::detect::level::Level;

/// How far from a contour another view of it runs at most, px of the coarser level: blur and the curvature of the contour move it.
const BESIDE_PX: f64 = 1.25;

/// So many rows ahead of where a line is followed the image is brought near: in each row another piece of memory is waited for.
const AHEAD: usize = 8;

/// One zero line; the buffers are reused from line to line.
#[derive(Debug, Default, Clone)]
pub(crate) struct Line {
    /// Crossings, px.
    pub(crate) u: Vec<f32>,
    /// Crossings, px.
    pub(crate) v: Vec<f32>,
    /// Whether the line closes.
    pub(crate) closed: bool,
    /// Whether the field rises along the row of the first crossing.
    pub(crate) rising: bool,
}

/// Follows zero lines of the field of a level; remembers which lattice edges it has used.
pub(crate) struct Tracer<'a, L> {
    pub(crate) level: &'a L,
    /// One bit per lattice edge between a pixel and the next of its row.
    visited: Vec<u64>,
}

/// Sides of a cell, clockwise from the top, the left one being 3; the cell (u, v) has the pixel (u, v) as its top left corner.
const TOP: u8 = 0;
const RIGHT: u8 = 1;
const BOTTOM: u8 = 2;

impl<'a, L: Level> Tracer<'a, L> {
    pub(crate) fn new(level: &'a L) -> Self {
        Self { level, visited: level.marks() }
    }

    /// Gives the memory back.
    pub(crate) fn end(self) {
        self.level.keep_marks(self.visited);
    }

    /// Lines are not to start near a contour, px of the level: what runs along it is known. What lies beside small ones is not.
    pub(crate) fn pass_over(&mut self, e: &Ellipse) {
        if e.semi_minor_px < 2.0 * BESIDE_PX {
            return;
        }
        let frame = Frame::new(e);
        let [outer, inner] = [BESIDE_PX, -BESIDE_PX].map(|d| Cut::new(&frame, frame.a + d, frame.b + d));
        let half = ((frame.a + BESIDE_PX) * frame.sin).hypot((frame.b + BESIDE_PX) * frame.cos);
        let (first, end) = ((e.center_px.v_px - half).max(0.0), e.center_px.v_px + half + 1.0);
        for v in first as usize..(end as usize).min(self.level.height()) {
            let dv = v as f64 - e.center_px.v_px;
            let Some((left, right)) = outer.span(dv) else { continue };
            match inner.span(dv) {
                Some((from, to)) => {
                    self.visit(v, frame.u0 + left, frame.u0 + from);
                    self.visit(v, frame.u0 + to, frame.u0 + right);
                }
                None => self.visit(v, frame.u0 + left, frame.u0 + right),
            }
        }
    }

    /// As if the crossings between two places of a row had been followed.
    fn visit(&mut self, v: usize, from_px: f64, to_px: f64) {
        let width = self.level.width();
        // At either end those that lie there in part; none of what ends before the image.
        let (from, to) = (from_px.max(0.0) as usize, ((to_px + 1.0).max(0.0) as usize).min(width - 1));
        let mut at = v * width + from;
        let end = v * width + to;
        while at < end {
            let next = (at / 64 + 1) * 64;
            let bits = next.min(end) - at;
            self.visited[at / 64] |= (u64::MAX >> (64 - bits)) << (at % 64);
            at = next.min(end);
        }
    }

    /// Whether the crossing between a pixel `(u, v)` and the next of its row was not followed yet; its place is `v * width + u`.
    #[inline]
    pub(crate) fn fresh(&self, place: usize) -> bool {
        (self.visited[place / 64] >> (place % 64)) & 1 == 0
    }

    /// Follows the line through the crossing between (u, v) and (u + 1, v) into `line`.
    pub(crate) fn follow(&mut self, u: usize, v: usize, line: &mut Line) {
        line.u.clear();
        line.v.clear();
        (1..=AHEAD).for_each(|k| self.level.fetch(u, v + k));
        let [here, beside] = [u, u + 1].map(|u| self.level.field(u, v));
        line.rising = beside > 0.0;
        self.cross((u, v), line, between(here, beside));
        line.closed = self.walk((u, v), TOP, (u, v), line);
        if !line.closed {
            line.u.reverse();
            line.v.reverse();
            if v > 0 {
                self.walk((u, v - 1), BOTTOM, (u, v), line);
            }
        }
    }

    /// Walks from cell to cell; true where it comes back to the top side of the cell `home`.
    fn walk(&mut self, start: (usize, usize), entry: u8, home: (usize, usize), line: &mut Line) -> bool {
        let (mut u, mut v) = start;
        let level = self.level;
        let (last_u, last_v) = (level.width() - 1, level.height() - 1);
        if u >= last_u || v >= last_v {
            return false;
        }
        // Corners clockwise from the side of the entry on; the line runs between the first two.
        let (mut entry, mut corner) = (entry, level.corners(u, v));
        corner.rotate_left(entry as usize);
        loop {
            let turn = turn(&corner, entry);
            let (before, behind) = (corner[turn as usize], corner[(turn as usize + 1) % 4]);
            let exit = (entry + turn) % 4;
            // The next cell has those two, in turns, and two others.
            let (third, fourth);
            match exit {
                TOP => {
                    if (u, v) == home {
                        return true;
                    }
                    self.cross((u, v), line, between(before, behind));
                    if v == 0 {
                        return false;
                    }
                    v -= 1;
                    level.fetch(u, v.saturating_sub(AHEAD));
                    (third, fourth) = (level.field(u, v), level.field(u + 1, v));
                }
                RIGHT => {
                    line.push(number(u + 1), number(v) + between(before, behind));
                    u += 1;
                    if u == last_u {
                        return false;
                    }
                    (third, fourth) = (level.field(u + 1, v), level.field(u + 1, v + 1));
                }
                BOTTOM => {
                    v += 1;
                    level.fetch(u, v + AHEAD);
                    if (u, v) == home {
                        return true;
                    }
                    self.cross((u, v), line, between(behind, before));
                    if v == last_v {
                        return false;
                    }
                    (third, fourth) = (level.field(u + 1, v + 1), level.field(u, v + 1));
                }
                _ => {
                    line.push(number(u), number(v) + between(behind, before));
                    if u == 0 {
                        return false;
                    }
                    u -= 1;
                    (third, fourth) = (level.field(u, v + 1), level.field(u, v));
                }
            }
            corner = [behind, before, third, fourth];
            entry = (exit + 2) % 4;
        }
    }

    /// Appends the crossing so far behind the pixel (u, v) of its row.
    #[inline(always)]
    fn cross(&mut self, (u, v): (usize, usize), line: &mut Line, behind: f32) {
        let i = v * self.level.width() + u;
        self.visited[i / 64] |= 1 << (i % 64);
        line.push(number(u) + behind, number(v));
    }
}

impl Line {
    #[inline(always)]
    fn push(&mut self, u: f32, v: f32) {
        self.u.push(u);
        self.v.push(v);
    }
}

/// A place of an image, below 2^31: as a signed number it is converted at once.
#[inline(always)]
fn number(x: usize) -> f32 {
    x as i32 as f32
}

/// Where between two values the zero is.
#[inline(always)]
fn between(a: f32, b: f32) -> f32 {
    a / (a - b)
}

/// How many sides after the `entry` the line leaves a cell with these corners, clockwise from the entry on. Branches on few numbers: they are foretold
/// better than tables are read.
#[inline(always)]
fn turn(corner: &[f32; 4], entry: u8) -> u8 {
    let second = corner[1] > 0.0;
    match ((corner[2] > 0.0) == second, (corner[3] > 0.0) == second) {
        (true, true) => 3,
        (true, false) => 2,
        (false, false) => 1,
        (false, true) => {
            // A saddle: the mean decides which diagonal is connected.
            let mut own = *corner;
            own.rotate_right(entry as usize);
            let top_left_cut_off = (own[0] > 0.0) != (own.iter().sum::<f32>() > 0.0);
            if top_left_cut_off == (entry & 1 == 0) { 3 } else { 1 }
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::detect::plane::{Floats, Source};
    use crate::frames::Pixel;
    use crate::image::{GrayView, Samples};

    /// Crossings near a contour are passed over, wherever on it, and no others.
    #[test]
    fn lines_do_not_start_beside_a_known_contour() {
        let (width, height) = (130, 50);
        let grey = vec![7u8; width * height];
        let view = GrayView::new(Samples::U8(&grey), width, height, width).expect("an image");
        let level = Floats::new(Source::View(&view), 1.0);
        // One of them leaves the image, one is too small.
        for (u, v, a, b) in [(66.3, 24.8, 30.0, 12.0), (5.0, 6.0, 20.0, 15.0), (60.2, 20.1, 5.0, 2.4)] {
            let e = Ellipse { center_px: Pixel::new(u, v), semi_major_px: a, semi_minor_px: b, angle_rad: 0.4 };
            let mut tracer = Tracer::new(&level);
            tracer.pass_over(&e);
            let (frame, mut passed) = (Frame::new(&e), 0);
            for (u, v) in (0..height).flat_map(|v| (0..width - 1).map(move |u| (u, v))) {
                let (x, y) = frame.inside(u as f64 + 0.5, v as f64);
                let within = |d: f64| a + d > 0.0 && b + d > 0.0 && (x / (a + d)).hypot(y / (b + d)) < 1.0;
                // A crossing lies up to half a pixel from the middle.
                let (surely, perhaps) = (within(0.65) && !within(-0.65), within(1.9) && !within(-1.9));
                let fresh = tracer.fresh(v * width + u);
                assert!(!(surely && fresh && b > 2.5), "({u}, {v}) beside {a} x {b} px");
                assert!(fresh || perhaps, "({u}, {v}) far from {a} x {b} px");
                passed += usize::from(!fresh);
            }
            assert_eq!(passed > 20, b > 2.5, "{passed} of {a} x {b} px");
        }
    }
}
