use super::*;
use crate::conic::Ellipse;
use crate::detect::contour;
use crate::detect::profile::Profile;
use crate::detect::shape::Shape;
use crate::detect::surface::{At, on_contour};
use crate::frames::Pixel;
use crate::lanes::run_all;

fn near(e: &Ellipse, reach: f64) -> Near {
    let frame = Frame::new(e);
    let mut near = Near::default();
    for (i, j) in (-40..=40).flat_map(|i| (-40..=40).map(move |j| (i, j))) {
        let (x, y) = (f64::from(i) + 0.3, f64::from(j) - 0.1);
        let q = (x / frame.a).hypot(y / frame.b);
        if (q - 1.0).abs() * frame.b < reach {
            let first = near.make_room(1);
            let [u, v, grey] = near.eight(first);
            (u[0], v[0]) = (x as f32, y as f32);
            grey[0] = (100.0 * (1.0 - q) + f64::from((i * 7 + j * 3) % 5)) as f32;
        }
    }
    near.fill_up(frame.a);
    near
}

const CASES: [(f64, f64, f64); 4] = [(13.0, 11.0, 1.0), (30.0, 12.0, 1.3), (36.0, 35.9, 0.5), (5.0, 4.0, 0.7)];
const DEFOCUS: Shape = Shape { fourth: -0.09, sixth: -0.05 };

fn case((a, b, blur_px): (f64, f64, f64), shape: Shape) -> (Ellipse, Lens) {
    let e = Ellipse { center_px: Pixel::new(0.0, 0.0), semi_major_px: a, semi_minor_px: b, angle_rad: 0.4 };
    let light = [80.0, 4.0, -3.0, 10.0, 1.0, 2.0, 1.5, -2.5, 3.0, -2.0, 1.0, 0.5];
    (e, Lens { blur_px, shape, variance: [2.0, 3.0], light })
}

#[derive(Clone)]
struct Summed<'a, const BENT: bool>(&'a Near, &'a Ellipse, Lens);
impl<const BENT: bool> Kernel for Summed<'_, BENT> {
    type Output = Columns;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Columns {
        let mut out = Columns::default();
        let frame = Frame::new(self.1);
        SumUp::<BENT> { near: self.0, frame: &frame, lens: &self.2, out: &mut out }.run::<L>();
        out
    }
}

/// The columns of one pixel, its response and its place on the diamond, in double precision and by the plain formulas; `off` px are
/// added to its distance from the edge, as if the ellipse were smaller.
fn plain_pixel(near: &Near, i: usize, e: &Ellipse, lens: &Lens, off: f64) -> ([f64; ALL], f64, f64) {
    let frame = Frame::new(e);
    let (x, y) = (f64::from(near.x[i]), f64::from(near.y[i]));
    let mut feet = frame.feet(&[x], &[y]);
    feet.distance[0] += off;
    let (c, s) = (feet.cos[0], feet.sin[0]);
    let profile = Profile { blur_px: lens.blur_px, shape: lens.shape, a: frame.a, b: frame.b };
    let lanes = profile.at(&feet.distance, &feet.cos, &feet.sin);
    let on = frame.on_contour(c, s);
    let (p, slope) = (lanes.inside[0], lanes.slope[0]);
    let root = 1.0 / (lens.variance[0] * p + lens.variance[1] * (1.0 - p)).sqrt();
    let [gx, gy] = on.climb;
    let kappa = frame.a * frame.b / (frame.b * c).hypot(frame.a * s).powi(3);
    let (across, along) = (-slope * lanes.depth[0] / lens.blur_px, kappa * slope);
    let [tx, ty] = [-gy * frame.b / frame.a, gx * frame.a / frame.b];
    let pixel = At {
        place: [x / (frame.a - off), y / (frame.b - off)],
        blur_px: lens.blur_px,
        inside: p,
        gradient: [slope * gx, slope * gy],
        bend: [
            across * gx * gx + along * tx * tx,
            across * gx * gy + along * tx * ty,
            across * gy * gy + along * ty * ty,
        ],
        ..At::default()
    };
    let (blurred, bare) = (pixel.polynomials(), pixel.bare());
    let order = [0, 2, 3, 1, 4, 5];
    let light = |k: usize| {
        let m = order[k % 3 + 3 * (k / 6)];
        if (k / 3).is_multiple_of(2) { blurred[m] } else { bare[m] - blurred[m] }
    };
    let l = lens.light;
    let edge = on_contour(c, s);
    let step: f64 =
        (0..3).map(|k| (l[k] - l[k + 3]) * edge[order[k]] + (l[k + 6] - l[k + 9]) * edge[order[k + 3]]).sum();
    let model: f64 = (0..LIGHTS + BENDS).map(|k| l[k] * light(k)).sum();
    let mut plain = [0.0; ALL];
    (0..LIGHTS).for_each(|k| plain[k] = root * light(k));
    (0..BENDS).for_each(|k| plain[M + k] = root * light(LIGHTS + k));
    plain[LIGHTS] = root * step * lanes.by_blur[0];
    (0..5).for_each(|k| plain[LIGHTS + 1 + k] = root * step * slope * on.row[k]);
    plain[N] = root * (f64::from(near.grey[i]) - model);
    (plain, root * step * slope, contour::diamond(c, s))
}

#[test]
fn columns_are_those_of_the_plain_profile() {
    for (of, shape) in CASES.into_iter().flat_map(|of| [(of, Shape::GAUSSIAN), (of, DEFOCUS)]) {
        let (e, lens) = case(of, shape);
        let near = near(&e, 3.5 * of.2);
        let columns = run_all(&Summed::<true>(&near, &e, lens)).remove(0);
        // A distance from the edge is the difference of two places of the size of the semi-axes, each of 24 digits.
        let off = 2.0_f64.powi(-23) * of.0;
        let (mut gram, mut allowed) = ([0.0; PRODUCTS], [0.0; PRODUCTS]);
        assert!(near.count > 50);
        for i in 0..near.count {
            let (plain, response, angle) = plain_pixel(&near, i, &e, &lens, 0.0);
            let further = plain_pixel(&near, i, &e, &lens, off).0;
            for k in 0..ALL {
                let value = f64::from(columns.values[i / BLOCK][k][i % BLOCK]);
                assert!((value - plain[k]).abs() < 1e-3, "{of:?} pixel {i}, {k}: {value} {}", plain[k]);
            }
            assert!((f64::from(columns.response[i]) - response).abs() < 1e-3);
            let angle = [f64::from(columns.diamond[i]), angle];
            assert!((angle[0] - angle[1]).abs() < 1e-5, "{of:?} pixel {i}: {angle:?}");
            for (a, b) in (0..ALL).flat_map(|a| (0..=a).map(move |b| (a, b))) {
                gram[place(a, b)] += plain[a] * plain[b];
                allowed[place(a, b)] += (further[a] * further[b] - plain[a] * plain[b]).abs();
            }
        }
        for (a, b) in (0..ALL).flat_map(|a| (0..=a).map(move |b| (a, b))) {
            // What the distances leave, and the rounding of columns and of up to fifty sums.
            let size = (gram[place(a, a)] * gram[place(b, b)]).sqrt();
            let limit = allowed[place(a, b)] + 5e-7 * size;
            let (found, plain) = (columns.gram[place(a, b)], gram[place(a, b)]);
            assert!((found - plain).abs() < limit, "{of:?} {a} {b}: {found} {plain} of {size}, limit {limit}");
        }
    }
}

#[test]
fn any_width_gives_the_same_bits() {
    for of in CASES {
        let (e, lens) = case(of, Shape::GAUSSIAN);
        let near = near(&e, 3.5 * of.2);
        let all = run_all(&Summed::<true>(&near, &e, lens));
        for one in &all {
            assert_eq!(one.gram.map(f64::to_bits), all[0].gram.map(f64::to_bits));
            assert_eq!(one.diamond[..near.count], all[0].diamond[..near.count]);
            assert_eq!(one.response[..near.count], all[0].response[..near.count]);
        }
    }
}

#[test]
fn without_bends_the_others_are_the_same() {
    for of in CASES {
        let (e, mut lens) = case(of, Shape::GAUSSIAN);
        lens.light[LIGHTS..].fill(0.0);
        let near = near(&e, 3.5 * of.2);
        let bent = run_all(&Summed::<true>(&near, &e, lens)).remove(0);
        for plain in run_all(&Summed::<false>(&near, &e, lens)) {
            assert_eq!(plain.gram[..PLAIN], bent.gram[..PLAIN]);
            assert_eq!(plain.response, bent.response);
        }
    }
}
