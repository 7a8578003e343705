//! Thin anti-aliased lines and small labels on an RGB picture.
//!
//! A pixel is covered by a line as far as its centre is inside the line's width, with a ramp of one pixel at the edge;
//! the joints of a chain are not covered twice. Every mark is drawn on a wider dark one, so that it is seen on bright and
//! dark ground alike.

use super::grey::Background;
use font8x8::UnicodeFonts;

/// An RGB colour.
pub(super) type Colour = [u8; 3];

/// Longest piece of a line that is drawn at once, px: keeps the area that is looked at small.
const PIECE_PX: f64 = 24.0;
/// How much wider the dark ground of a line is on each side, px.
const HALO_PX: f64 = 1.0;
/// Opacity of the dark ground.
const HALO_OPACITY: f32 = 0.55;

/// A picture being drawn; coordinates are px with (0, 0) the centre of the first pixel.
pub(super) struct Canvas {
    rgb: Vec<u8>,
    width: usize,
    height: usize,
    /// Coverage of the mark being drawn, 0 elsewhere.
    cover: Vec<f32>,
    touched: Vec<usize>,
}

impl Canvas {
    /// A picture of the background.
    pub(super) fn new(ground: &Background) -> Self {
        let (width, height) = (ground.width, ground.height);
        let rgb = ground.levels.iter().flat_map(|&g| [g, g, g]).collect();
        Self { rgb, width, height, cover: vec![0.0; width * height], touched: Vec::new() }
    }
    /// Width, height and the packed RGB samples.
    pub(super) fn into_rgb(self) -> (usize, usize, Vec<u8>) {
        (self.width, self.height, self.rgb)
    }

    /// A chain of lines through `points`, `width_px` wide.
    pub(super) fn chain(&mut self, points: &[[f64; 2]], closed: bool, width_px: f64, colour: Colour) {
        for (extra, colour, opacity) in [(2.0 * HALO_PX, [0, 0, 0], HALO_OPACITY), (0.0, colour, 1.0)] {
            for pair in points.windows(2) {
                self.cover_segment(pair[0], pair[1], width_px + extra);
            }
            if let (true, Some(&first), Some(&last)) = (closed, points.first(), points.last()) {
                self.cover_segment(last, first, width_px + extra);
            }
            self.blend(colour, opacity);
        }
    }

    /// One line of text in an 8x8 font times `scale`, its left upper corner at `at`; kept inside the picture where it fits.
    pub(super) fn text(&mut self, at: [f64; 2], text: &str, scale: usize, colour: Colour) {
        let glyph = 8 * scale;
        let room = |size: usize, need: usize, x: f64| x.round().clamp(1.0, size.saturating_sub(need + 1).max(1) as f64);
        let left = room(self.width, glyph * text.chars().count(), at[0]) as usize;
        let top = room(self.height, glyph, at[1]) as usize;
        for (grow, colour, opacity) in [(1, [0, 0, 0], 0.7), (0, colour, 1.0)] {
            for (i, c) in text.chars().enumerate() {
                self.cover_glyph(left + i * glyph, top, c, scale, grow);
            }
            self.blend(colour, opacity);
        }
    }

    fn cover_glyph(&mut self, left: usize, top: usize, c: char, scale: usize, grow: usize) {
        let rows = font8x8::BASIC_FONTS
            .get(c)
            .or_else(|| font8x8::LATIN_FONTS.get(c))
            .or_else(|| font8x8::GREEK_FONTS.get(c))
            .unwrap_or([0x7e, 0x42, 0x42, 0x42, 0x42, 0x42, 0x7e, 0]);
        for (y, row) in rows.into_iter().enumerate() {
            for x in (0..8).filter(|x| row >> x & 1 == 1) {
                let (u, v) = (left + x * scale, top + y * scale);
                for v in v.saturating_sub(grow)..v + scale + grow {
                    for u in u.saturating_sub(grow)..u + scale + grow {
                        self.cover_pixel(u, v, 1.0);
                    }
                }
            }
        }
    }

    fn cover_pixel(&mut self, u: usize, v: usize, cover: f32) {
        if u >= self.width || v >= self.height || cover <= 0.0 {
            return;
        }
        let i = v * self.width + u;
        if self.cover[i] == 0.0 {
            self.touched.push(i);
        }
        self.cover[i] = self.cover[i].max(cover);
    }

    fn cover_segment(&mut self, a: [f64; 2], b: [f64; 2], width_px: f64) {
        let reach = 1e6;
        if !a.iter().chain(&b).all(|x| x.abs() < reach) {
            return;
        }
        let (du, dv) = (b[0] - a[0], b[1] - a[1]);
        let pieces = (du.hypot(dv) / PIECE_PX).ceil().max(1.0);
        for i in 0..pieces as usize {
            let (s, t) = (i as f64 / pieces, (i + 1) as f64 / pieces);
            self.cover_piece([a[0] + s * du, a[1] + s * dv], [a[0] + t * du, a[1] + t * dv], width_px);
        }
    }

    fn cover_piece(&mut self, a: [f64; 2], b: [f64; 2], width_px: f64) {
        let reach = 0.5 * width_px + 0.5;
        let range = |i: usize, size: usize| {
            let (low, high) = (a[i].min(b[i]) - reach, a[i].max(b[i]) + reach);
            low.ceil().max(0.0) as usize..(high.floor() + 1.0).clamp(0.0, size as f64) as usize
        };
        let (du, dv) = (b[0] - a[0], b[1] - a[1]);
        let length2 = du * du + dv * dv;
        for v in range(1, self.height) {
            for u in range(0, self.width) {
                let (pu, pv) = (u as f64 - a[0], v as f64 - a[1]);
                let t = if length2 > 0.0 { ((pu * du + pv * dv) / length2).clamp(0.0, 1.0) } else { 0.0 };
                let distance = (pu - t * du).hypot(pv - t * dv);
                self.cover_pixel(u, v, (reach - distance).min(1.0) as f32);
            }
        }
    }

    /// Paints what is covered, and covers nothing again.
    fn blend(&mut self, colour: Colour, opacity: f32) {
        for i in self.touched.drain(..) {
            let k = self.cover[i] * opacity;
            self.cover[i] = 0.0;
            for (sample, goal) in self.rgb[3 * i..3 * i + 3].iter_mut().zip(colour) {
                let x = f32::from(*sample);
                *sample = (x + k * (f32::from(goal) - x)).round() as u8;
            }
        }
    }
}
