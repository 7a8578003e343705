//! What a zero line looks like: a disc, a square, a triangle, two discs in one, or nothing of interest.
//!
//! A filled region has affine invariants: with area `A` and second central moments `m`, `det(m) / A^4` is `1 / (16 pi^2)` for
//! every ellipse. The largest triangle and the largest quadrilateral inscribed in the convex hull fill
//! 0.41 and 0.64 of an ellipse, 0.5 and 1 of a parallelogram, 1 and 1 of a triangle; blur rounds corners, so the limits lie between.

mod looks;

use crate::conic::{Ellipse, Frame, fit_direct};
use crate::detect::level::Level;
use crate::detect::slim::{SHOWN_SLIMMER, slim_disc};
use crate::detect::trace::Line;
use crate::detect::{DetectOptions, RejectionReason};
use crate::frames::Pixel;
use crate::lanes::{self, GROUP, Kernel, Lanes};
use crate::target::MarkKind;
pub(super) use looks::LOOK_PX;
use looks::edge_strength;

/// A region that may be a disc.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    pub(crate) ellipse: Ellipse,
    pub(crate) blur_px: f64,
    pub(crate) bright: bool,
    /// Inside minus outside at the contour, grey, positive.
    pub(crate) contrast: f64,
    /// Root mean square distance of the line from the ellipse, px.
    pub(crate) rms_px: f64,
    /// Pyramid level at which it was seen.
    pub(crate) level: u32,
}

/// What a line is.
#[derive(Debug, Clone)]
pub(crate) enum Verdict {
    Disc(Candidate),
    Mark(Candidate, MarkKind),
    Rejected(Candidate, RejectionReason),
    /// Two discs that touch or overlap.
    Overlap([Candidate; 2]),
    /// No plain ellipse; [`judge_odd`] says more where the contrast makes it worth the time.
    Odd(Odd),
    Nothing,
}

/// A closed line that no ellipse fits as a whole.
#[derive(Debug, Clone)]
pub(crate) struct Odd {
    /// The ellipse of equal moments.
    pub(crate) rough: Candidate,
    u: Vec<f64>,
    v: Vec<f64>,
    /// Share of the line along which the grey falls outwards.
    share: f64,
}

/// Area, centre and the ellipse of equal second moments of a closed line.
struct Moments {
    doubled_area: f64,
    ellipse: Option<Ellipse>,
}

/// Limits in the grey levels of one pyramid level.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strength {
    /// Least gradient of an edge, grey/px.
    pub(crate) gradient: f64,
}

/// Judges a line traced at `level` on `smooth`; coordinates come back in pixels of the image. `known` says whether a region with such an
/// ellipse, bright or not, was seen before.
pub(crate) fn judge(
    line: &Line,
    smooth: &impl Level,
    strength: Strength,
    level: u32,
    options: &DetectOptions,
    known: &impl Fn(&Ellipse, bool) -> bool,
) -> Verdict {
    let scale = f64::from(1u32 << level);
    let least = 0.6 * options.min_semi_minor_px / scale;
    if line.u.len() < 6 {
        return Verdict::Nothing;
    }
    if !line.closed {
        return judge_open(line, smooth, strength, level, options);
    }
    let m = moments(line);
    let Some(rough) = m.ellipse else { return Verdict::Nothing };
    if rough.semi_minor_px < least || rough.semi_major_px * scale > options.max_semi_major_px * 1.3 {
        return Verdict::Nothing;
    }
    let turn = m.doubled_area.signum();
    // The region enclosed is the positive one.
    let bright = (m.doubled_area < 0.0) == line.rising;
    if known(&scaled(&rough, scale), bright) {
        return Verdict::Nothing;
    }
    let (edge, share) = edge_strength(line, smooth, strength, if bright { turn } else { -turn });
    if share < 0.6 {
        return Verdict::Nothing;
    }
    let (u, v) = thinned(line, 96);
    let found = |ellipse: &Ellipse, rms_px: f64| Candidate {
        ellipse: scaled(ellipse, scale),
        blur_px: edge.blur_px * scale,
        bright,
        contrast: edge.contrast,
        rms_px: rms_px * scale,
        level,
    };
    let radius = rough.mean_radius_px();
    let limit = 0.5 + 0.05 * radius;
    let direct = fit_direct(&u, &v).unwrap_or(rough);
    let rms = rms_gap(&direct, &u, &v);
    let ratio = direct.semi_minor_px / direct.semi_major_px;
    let slim = ratio < options.min_axis_ratio;
    let area = 0.5 * m.doubled_area.abs();
    let edgy = rms > 0.25 + 0.015 * radius && radius >= 4.0 && !slim;
    if let Some(kind) = edgy.then(|| polygon_kind(&u, &v, area)).flatten() {
        return Verdict::Mark(found(&rough, rms), kind);
    }
    if rms < limit && ratio >= SHOWN_SLIMMER * options.min_axis_ratio {
        if direct.semi_minor_px * scale < 0.8 * options.min_semi_minor_px {
            let semi_minor_px = direct.semi_minor_px * scale;
            return Verdict::Rejected(found(&direct, rms), RejectionReason::TooSmall { semi_minor_px });
        }
        return Verdict::Disc(found(&direct, rms));
    }
    if rms < limit && direct.semi_minor_px * scale >= options.min_semi_minor_px {
        return slim_disc(found(&direct, rms), share, options.min_axis_ratio);
    }
    if radius < 4.0 || slim {
        return Verdict::Nothing;
    }
    Verdict::Odd(Odd { rough: found(&rough, rms), u, v, share })
}

/// Two discs in one, a disc with part of its contour spoilt, or neither.
pub(crate) fn judge_odd(odd: &Odd, options: &DetectOptions) -> Verdict {
    let Odd { rough, u, v, share } = odd;
    let scale = f64::from(1u32 << rough.level);
    let found = |ellipse: &Ellipse, rms_px: f64| Candidate {
        ellipse: scaled(ellipse, scale),
        rms_px: rms_px * scale,
        ..*rough
    };
    if let Some(parts) = two_in_one(u, v, options.min_axis_ratio) {
        return Verdict::Overlap(parts.map(|e| found(&e, rough.rms_px / scale)));
    }
    if let Some(ellipse) = robust_ellipse(u, v, options.min_axis_ratio) {
        return Verdict::Disc(found(&ellipse, rms_gap(&ellipse, u, v)));
    }
    let limit_px = 0.5 * scale + 0.05 * rough.ellipse.mean_radius_px();
    let reason = RejectionReason::NotElliptical { rms_px: rough.rms_px, limit_px };
    if *share > 0.9 { Verdict::Rejected(*rough, reason) } else { Verdict::Nothing }
}

/// A line that leaves the image: a disc cut by the border, or nothing.
fn judge_open(line: &Line, smooth: &impl Level, strength: Strength, level: u32, options: &DetectOptions) -> Verdict {
    let scale = f64::from(1u32 << level);
    let (u, v) = thinned(line, 96);
    let Ok(ellipse) = fit_direct(&u, &v) else { return Verdict::Nothing };
    let rms = rms_gap(&ellipse, &u, &v);
    let ratio = ellipse.semi_minor_px / ellipse.semi_major_px;
    let fits = rms < 0.5 + 0.03 * ellipse.semi_minor_px
        && ellipse.semi_minor_px * scale > options.min_semi_minor_px.max(3.0)
        && ratio > options.min_axis_ratio.max(0.3);
    // An arc must show a good part of the contour, else any bent edge would pass for a disc.
    let seen = line_length(&u, &v) / ellipse.perimeter_px();
    if !fits || seen < 0.3 || ellipse.semi_major_px > 0.4 * smooth.width().min(smooth.height()) as f64 {
        return Verdict::Nothing;
    }
    let inside = Pixel::new(ellipse.center_px.u_px, ellipse.center_px.v_px);
    let turn = arc_turn(&u, &v, inside);
    let (dark, dark_share) = edge_strength(line, smooth, strength, -turn);
    let (bright, bright_share) = edge_strength(line, smooth, strength, turn);
    if dark_share.max(bright_share) < 0.75 {
        return Verdict::Nothing;
    }
    let is_bright = bright_share > dark_share;
    let edge = if is_bright { bright } else { dark };
    let candidate = Candidate {
        ellipse: scaled(&ellipse, scale),
        blur_px: edge.blur_px * scale,
        bright: is_bright,
        contrast: edge.contrast,
        rms_px: rms * scale,
        level,
    };
    Verdict::Rejected(candidate, RejectionReason::CutByBorder)
}

/// Sense of turning of an open arc about a point, +1 or -1.
fn arc_turn(u: &[f64], v: &[f64], about: Pixel) -> f64 {
    let sum: f64 = (1..u.len())
        .map(|i| (u[i - 1] - about.u_px) * (v[i] - about.v_px) - (u[i] - about.u_px) * (v[i - 1] - about.v_px))
        .sum();
    sum.signum()
}

fn line_length(u: &[f64], v: &[f64]) -> f64 {
    (1..u.len()).map(|i| (u[i] - u[i - 1]).hypot(v[i] - v[i - 1])).sum()
}

/// An ellipse in pixels of another size.
pub(super) fn scaled(e: &Ellipse, scale: f64) -> Ellipse {
    Ellipse {
        center_px: Pixel::new(e.center_px.u_px * scale, e.center_px.v_px * scale),
        semi_major_px: e.semi_major_px * scale,
        semi_minor_px: e.semi_minor_px * scale,
        angle_rad: e.angle_rad,
    }
}

/// At most `most` points of a line, evenly taken.
fn thinned(line: &Line, most: usize) -> (Vec<f64>, Vec<f64>) {
    let n = line.u.len();
    let at: Vec<usize> = if n > most { evenly(n, most).collect() } else { vec![] };
    let of = |x: &[f32]| -> Vec<f64> {
        if n > most { at.iter().map(|i| f64::from(x[*i])).collect() } else { x.iter().map(|x| f64::from(*x)).collect() }
    };
    (of(&line.u), of(&line.v))
}

/// `k n / take` for each `k` below `take`, without dividing each.
fn evenly(n: usize, take: usize) -> impl Iterator<Item = usize> {
    let (step, more) = (n / take.max(1), n % take.max(1));
    let (mut at, mut rest) = (0, 0);
    (0..take).map(move |_| {
        let own = at;
        (at, rest) = (at + step, rest + more);
        if rest >= take {
            (at, rest) = (at + 1, rest - take);
        }
        own
    })
}

/// Sums over the triangles of a closed line and its first point: of their doubled areas, and of these times what makes moments of them.
#[derive(Clone)]
struct Triangles<'a> {
    u: &'a [f32],
    v: &'a [f32],
}

impl Kernel for Triangles<'_> {
    type Output = [f64; 6];
    #[inline(always)]
    fn run<L: Lanes>(self) -> [f64; 6] {
        let Self { u, v } = self;
        let (u0, v0) = (f64::from(u[0]), f64::from(v[0]));
        let mut sums = [[0.0; GROUP]; 6];
        // From each point to the next; the first and the last lie on the line from the first point. What only fills the last group has no area.
        for from in (0..u.len()).step_by(GROUP) {
            let last = u.len() - 1;
            let (mut x, mut y) = ([u[last]; GROUP + 1], [v[last]; GROUP + 1]);
            let count = (GROUP + 1).min(u.len() - from);
            x[..count].copy_from_slice(&u[from..from + count]);
            y[..count].copy_from_slice(&v[from..from + count]);
            let mut ends = [[0.0; GROUP]; 4];
            for i in 0..GROUP {
                ends[0][i] = f64::from(x[i]) - u0;
                ends[1][i] = f64::from(y[i]) - v0;
            }
            for i in 0..GROUP {
                ends[2][i] = f64::from(x[i + 1]) - u0;
                ends[3][i] = f64::from(y[i + 1]) - v0;
            }
            let mut part = 0;
            while part < GROUP {
                let (x, y) = (L::load(&ends[0][part..]), L::load(&ends[1][part..]));
                let (x1, y1) = (L::load(&ends[2][part..]), L::load(&ends[3][part..]));
                let w = x * y1 - x1 * y;
                let (xy, yx, two) = (x * y1, x1 * y, L::splat(2.0));
                let of = [
                    w,
                    w * (x + x1),
                    w * (y + y1),
                    w * (x * x + x * x1 + x1 * x1),
                    w * (two * x * y + xy + yx + two * x1 * y1),
                    w * (y * y + y * y1 + y1 * y1),
                ];
                for k in 0..6 {
                    (L::load(&sums[k][part..]) + of[k]).store(&mut sums[k][part..]);
                }
                part += L::N;
            }
        }
        let mut out = [0.0; 6];
        for k in 0..6 {
            out[k] = lanes::sum(&sums[k]);
        }
        out
    }
}

fn moments(line: &Line) -> Moments {
    let (u0, v0) = (f64::from(line.u[0]), f64::from(line.v[0]));
    let [a2, su, sv, suu, suv, svv] = lanes::run(Triangles { u: &line.u, v: &line.v });
    let area = 0.5 * a2;
    let (cu, cv) = (su / (6.0 * area), sv / (6.0 * area));
    let (muu, mvv, muv) = (suu / (12.0 * area) - cu * cu, svv / (12.0 * area) - cv * cv, suv / (24.0 * area) - cu * cv);
    let (half, diff) = (0.5 * (muu + mvv), (0.5 * (muu - mvv)).hypot(muv));
    let (hi, lo) = (half + diff, half - diff);
    let ellipse = if lo > 0.0 {
        let angle = 0.5 * (2.0 * muv).atan2(muu - mvv);
        Ellipse::new(Pixel::new(u0 + cu, v0 + cv), 2.0 * hi.sqrt(), 2.0 * lo.sqrt(), angle).ok()
    } else {
        None
    };
    Moments { doubled_area: a2, ellipse }
}

/// First-order distance of a point from an ellipse, px.
fn gap(e: &Ellipse, (s, c): (f64, f64), u: f64, v: f64) -> f64 {
    let (du, dv) = (u - e.center_px.u_px, v - e.center_px.v_px);
    let (x, y) = ((c * du + s * dv) / e.semi_major_px, (c * dv - s * du) / e.semi_minor_px);
    let q = (x * x + y * y).sqrt();
    if q == 0.0 {
        return -e.semi_minor_px;
    }
    let (gx, gy) = (x / e.semi_major_px, y / e.semi_minor_px);
    (q - 1.0) * q / (gx * gx + gy * gy).sqrt()
}

/// Root mean square of the first-order distances of points from an ellipse, px.
fn rms_gap(e: &Ellipse, u: &[f64], v: &[f64]) -> f64 {
    (lanes::run(SquaredGaps { frame: &Frame::new(e), u, v }) / u.len() as f64).sqrt()
}

/// The sum of the squares of [`gap`].
#[derive(Clone)]
struct SquaredGaps<'a> {
    frame: &'a Frame,
    u: &'a [f64],
    v: &'a [f64],
}

impl Kernel for SquaredGaps<'_> {
    type Output = f64;
    #[inline(always)]
    fn run<L: Lanes>(self) -> f64 {
        let Self { frame, u, v } = self;
        let [a, b] = lanes::splats([1.0 / frame.a, 1.0 / frame.b]);
        let mut sum = [0.0; GROUP];
        for from in (0..u.len()).step_by(GROUP) {
            // What only fills the last group lies on the ellipse.
            let (mut x, mut y) = ([frame.a; GROUP], [0.0; GROUP]);
            for i in 0..GROUP.min(u.len() - from) {
                (x[i], y[i]) = frame.inside(u[from + i], v[from + i]);
            }
            let mut part = 0;
            while part < GROUP {
                let (x, y) = (L::load(&x[part..]) * a, L::load(&y[part..]) * b);
                let (gx, gy) = (x * a, y * b);
                let (square, steep) = (x.fused(x, y * y), gx.fused(gx, gy * gy));
                let off = square - square.sqrt();
                let at_centre = steep.below(L::splat(f64::MIN_POSITIVE));
                let gap = L::select(at_centre, L::splat(frame.b * frame.b), off * off / steep);
                (L::load(&sum[part..]) + gap).store(&mut sum[part..]);
                part += L::N;
            }
        }
        lanes::sum(&sum)
    }
}

/// An ellipse that most of the line follows, found by trying subsets in a fixed order.
fn robust_ellipse(u: &[f64], v: &[f64], min_axis_ratio: f64) -> Option<Ellipse> {
    let n = u.len();
    if n < 24 {
        return None;
    }
    let mut best: Option<(usize, Ellipse)> = None;
    let near = |e: &Ellipse| 0.5 + 0.03 * e.semi_minor_px;
    for trial in 0..60usize {
        // Runs of neighbouring points in three places: one odd run spoils only some of the trials.
        let (mut su, mut sv) = (Vec::with_capacity(18), Vec::with_capacity(18));
        let run = n / 12 + 2;
        for third in 0..3usize {
            let at = third * n / 3 + (trial * (7 + 4 * third)) % (n / 2);
            for k in 0..run {
                su.push(u[(at + k) % n]);
                sv.push(v[(at + k) % n]);
            }
        }
        let Ok(e) = fit_direct(&su, &sv) else { continue };
        if e.semi_minor_px < min_axis_ratio * e.semi_major_px {
            continue;
        }
        let sc = e.angle_rad.sin_cos();
        let count = (0..n).filter(|i| gap(&e, sc, u[*i], v[*i]).abs() < near(&e)).count();
        if best.as_ref().is_none_or(|b| count > b.0) {
            best = Some((count, e));
        }
    }
    let (_, mut e) = best?;
    for _ in 0..3 {
        let sc = e.angle_rad.sin_cos();
        let (iu, iv): (Vec<f64>, Vec<f64>) =
            u.iter().zip(v).filter(|(u, v)| gap(&e, sc, **u, **v).abs() < near(&e)).map(|(u, v)| (*u, *v)).unzip();
        e = fit_direct(&iu, &iv).ok()?;
    }
    let covered = covered_share(&e, u, v, near(&e));
    (covered > 0.55 && e.semi_minor_px >= min_axis_ratio * e.semi_major_px).then_some(e)
}

/// Share of 36 directions in which the line lies within `near` of the ellipse.
fn covered_share(e: &Ellipse, u: &[f64], v: &[f64], near: f64) -> f64 {
    let sc = e.angle_rad.sin_cos();
    let mut seen = [false; 36];
    for (u, v) in u.iter().zip(v) {
        if gap(e, sc, *u, *v).abs() < near {
            let (du, dv) = (u - e.center_px.u_px, v - e.center_px.v_px);
            let x = (sc.1 * du + sc.0 * dv) / e.semi_major_px;
            let y = (sc.1 * dv - sc.0 * du) / e.semi_minor_px;
            let t = y.atan2(x) / std::f64::consts::TAU + 0.5;
            seen[((t * 36.0) as usize).min(35)] = true;
        }
    }
    seen.iter().filter(|s| **s).count() as f64 / 36.0
}

/// Splits the line at its two deepest dents; the discs of the two parts, where both are arcs of discs.
fn two_in_one(u: &[f64], v: &[f64], min_axis_ratio: f64) -> Option<[Ellipse; 2]> {
    let n = u.len();
    if n < 24 {
        return None;
    }
    let dents = dents(u, v);
    let (first, depth) = *dents.first()?;
    let second = dents.iter().find(|d| {
        let apart = (d.0 + n - first) % n;
        apart > n / 8 && apart < n - n / 8
    })?;
    let radius = 0.25 * line_length(u, v) / std::f64::consts::PI;
    if depth.min(second.1) < 0.5 + 0.02 * radius {
        return None;
    }
    let (a, b) = (first.min(second.0), first.max(second.0));
    // The dents themselves are rounded by blur; a few points beside each do not belong to either arc.
    let skip = n / 32 + 1;
    let arc = |from: usize, to: usize| -> Option<Ellipse> {
        let (from, to) = (from + skip, to - skip.min(to));
        if to < from + 8 {
            return None;
        }
        let (au, av): (Vec<f64>, Vec<f64>) = (from..to).map(|i| (u[i % n], v[i % n])).unzip();
        let e = fit_direct(&au, &av).ok()?;
        let good = rms_gap(&e, &au, &av) < 0.5 + 0.04 * e.semi_minor_px
            && e.semi_minor_px > min_axis_ratio.max(0.25) * e.semi_major_px;
        // A smear that touches a disc follows some ellipse too; a second disc shows much of its own contour.
        let shown = line_length(&au, &av) > 0.35 * e.perimeter_px();
        (good && shown).then_some(e)
    };
    let (one, two) = (arc(a, b)?, arc(b, a + n)?);
    let ratio = one.semi_minor_px / two.semi_minor_px;
    (0.3..3.4).contains(&ratio).then_some([one, two])
}

/// Local maxima of the depth below the convex hull, (index, depth px), deepest first.
fn dents(u: &[f64], v: &[f64]) -> Vec<(usize, f64)> {
    let n = u.len();
    let mut hull = convex_hull(u, v);
    hull.sort_unstable();
    let mut found = Vec::new();
    for k in 0..hull.len() {
        let (i, j) = (hull[k], hull[(k + 1) % hull.len()]);
        let span = (j + n - i) % n;
        let (du, dv) = (u[j] - u[i], v[j] - v[i]);
        let length = du.hypot(dv);
        if span < 2 || length == 0.0 {
            continue;
        }
        let depth = |m: usize| ((u[m % n] - u[i]) * dv - (v[m % n] - v[i]) * du).abs() / length;
        if let Some(m) = (i + 1..i + span).max_by(|x, y| depth(*x).total_cmp(&depth(*y))) {
            found.push((m % n, depth(m)));
        }
    }
    found.sort_by(|x, y| y.1.total_cmp(&x.1));
    found
}

/// Indices of the convex hull (Andrew's chain).
fn convex_hull(u: &[f64], v: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..u.len()).collect();
    order.sort_by(|i, j| u[*i].total_cmp(&u[*j]).then(v[*i].total_cmp(&v[*j])));
    let cross = |o: usize, a: usize, b: usize| (u[a] - u[o]) * (v[b] - v[o]) - (v[a] - v[o]) * (u[b] - u[o]);
    let mut hull: Vec<usize> = Vec::new();
    for pass in 0..2 {
        let floor = hull.len() + 1;
        let walk: Box<dyn Iterator<Item = &usize>> =
            if pass == 0 { Box::new(order.iter()) } else { Box::new(order.iter().rev().skip(1)) };
        for &i in walk {
            while hull.len() > floor.max(1) && cross(hull[hull.len() - 2], hull[hull.len() - 1], i) <= 0.0 {
                hull.pop();
            }
            hull.push(i);
        }
    }
    hull.pop();
    hull
}

/// Square or triangle, by the largest polygons inscribed in the hull.
fn polygon_kind(u: &[f64], v: &[f64], area: f64) -> Option<MarkKind> {
    let hull = convex_hull(u, v);
    let step = hull.len().div_ceil(40).max(1);
    let corners: Vec<(f64, f64)> = hull.iter().step_by(step).map(|i| (u[*i], v[*i])).collect();
    let n = corners.len();
    if n < 3 {
        return None;
    }
    let hull_area = polygon_area(&corners);
    if area < 0.84 * hull_area {
        return None;
    }
    let doubled = |a: usize, b: usize, c: usize| {
        let ((ax, ay), (bx, by), (cx, cy)) = (corners[a], corners[b], corners[c]);
        ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)).abs()
    };
    let (mut triangle, mut quadrilateral) = (0.0_f64, 0.0_f64);
    for i in 0..n {
        for j in i + 1..n {
            let left = (i + 1..j).map(|k| doubled(i, j, k)).fold(0.0, f64::max);
            let right = (j + 1..n).chain(0..i).map(|k| doubled(i, j, k)).fold(0.0, f64::max);
            triangle = triangle.max(0.5 * left.max(right));
            quadrilateral = quadrilateral.max(0.5 * (left + right));
        }
    }
    let (triangle, quadrilateral) = (triangle / hull_area, quadrilateral / hull_area);
    if triangle > 0.66 {
        Some(MarkKind::Triangle)
    } else if quadrilateral > 0.82 && triangle < 0.62 {
        Some(MarkKind::Square)
    } else {
        None
    }
}

fn polygon_area(corners: &[(f64, f64)]) -> f64 {
    let n = corners.len();
    let doubled: f64 = (0..n)
        .map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            a.0 * b.1 - b.0 * a.1
        })
        .sum();
    0.5 * doubled.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Alike in all widths, one of the points in the centre.
    #[test]
    fn squared_gaps_are_those_of_single_points() {
        let e = Ellipse { center_px: Pixel::new(9.0, 7.0), semi_major_px: 5.0, semi_minor_px: 3.2, angle_rad: 0.4 };
        let mut u: Vec<f64> = (0..21).map(|k| 4.0 + 0.5 * f64::from(k)).collect();
        let mut v: Vec<f64> = (0..21).map(|k| 7.0 + 4.0 * f64::from(k).sin()).collect();
        (u[3], v[3]) = (9.0, 7.0);
        let sc = e.angle_rad.sin_cos();
        let plain: f64 = u.iter().zip(&v).map(|(u, v)| gap(&e, sc, *u, *v).powi(2)).sum();
        let found = lanes::run_all(&SquaredGaps { frame: &Frame::new(&e), u: &u, v: &v });
        assert!(found.iter().all(|x| x.to_bits() == found[0].to_bits()));
        assert!((found[0] - plain).abs() < 1e-12 * plain, "{} {plain}", found[0]);
    }
}
