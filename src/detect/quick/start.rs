//! Where a disc is whose line is known, in pixels of the level where that was followed.
//!
//! The line is the zero of the field, the difference of the image under two blurs ([`crate::detect::plane`]). Where the contour bends, each blur shows its
//! edge further inside, and their difference vanishes outside of it:
//!
//! ```text
//! P(d) = Phi(-(d + k t^2 / 2) / t)                 the edge under a blur t, d px outside of a contour of curvature k
//! d    = k t1 t2 / 2                               where P is the same for t1 and t2
//! m    = d + k t1^2 / 2                            from the middle of the edge under t1 to the line
//! t    = C / ((2 pi)^(1/2) g)                      the blur that gradient and step across the line show
//! g = (E((m + e) / t3) - E((m - e) / t3)) / (2 e),  C = E((m + f) / t3) - E((m - f) / t3)
//! E(x) = Phi(x) - c / (24 t3^4) (x^3 - 3 x) phi(x) the step under the binomial, which is flatter than a Gaussian (Edgeworth)
//! ```
//!
//! The mean over nine pixels is taken for a Gaussian of its variance, as are the weights of four pixels that give a grey level between them.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | t1, t2, t3 | `smooth`, `wide`, `looked_at` | px | blur of the smoothed image, of its local mean, of grey levels between its pixels |
//! | t | `shown` | px | what [`crate::detect::candidate`] makes of it, with the variance of the binomial |
//! | k | `curvature` | 1/px | of the contour at the end of an axis |
//! | c | `BINOMIAL_PX4` | px^4 | fourth cumulant |
//! | e, f | `LOOK_PX` | px | how far from the line its edge is looked at |

use crate::conic::Ellipse;
use crate::detect::candidate::LOOK_PX;
use crate::detect::edge_model::LEAST_BLUR_PX;
use crate::detect::sectors::normal_tails;

/// Variance of the binomial, of a mean over nine, and of the weights of the pixels around a place 0.75 px beside a line, along the normal, on the
/// average of all directions, px^2.
const BINOMIAL_PX2: f64 = 1.0;
const NINE_PX2: f64 = 80.0 / 12.0;
const BETWEEN_PX2: f64 = 0.186;
/// Fourth cumulant of the binomial, -1/2 along a row, on the average of all directions, px^4.
const BINOMIAL_PX4: f64 = -0.375;
/// Share of the step within the nearer places beyond that of a slope without an end that is still told from it: that of 5.5 px.
const LEAST_SHARE: f64 = 0.012;
/// Rounds for the blur, whose place and size hang on each other.
const ROUNDS: usize = 3;

/// Ellipse and blur from those that the line shows.
pub(crate) fn contour_of(line: &Ellipse, shown_blur_px: f64) -> (Ellipse, f64) {
    let (a, b) = (line.semi_major_px, line.semi_minor_px);
    let ends = [a / (b * b), b / (a * a)];
    let mean = 0.5 * (ends[0] + ends[1]);
    let shown = (shown_blur_px * shown_blur_px + BINOMIAL_PX2).sqrt();
    let straight = straight_of(shown);
    let (mut smooth, mut wide) = (straight, straight);
    for _ in 0..ROUNDS {
        wide = (smooth * smooth + NINE_PX2).sqrt();
        let looked_at = (smooth * smooth + BETWEEN_PX2).sqrt();
        let found = looked_at * shown / shown_of(looked_at, 0.5 * mean * smooth * (smooth + wide));
        smooth = (found * found - BETWEEN_PX2).max(BINOMIAL_PX2).sqrt();
    }
    let [semi_major_px, semi_minor_px] = [(a, ends[0]), (b, ends[1])].map(|(x, k)| x - 0.5 * k * smooth * wide);
    let blur_px = (smooth * smooth - BINOMIAL_PX2).sqrt().max(LEAST_BLUR_PX);
    (Ellipse { semi_major_px, semi_minor_px, ..*line }, blur_px)
}

/// The blur of a straight edge that shows so much: `1 / S^2` is a polynomial of the share of the step within the nearer places, to 0.1 % for 1 to 5.5 px.
fn straight_of(shown: f64) -> f64 {
    let [near, far] = LOOK_PX;
    let beyond = (2.0 * near / (std::f64::consts::TAU.sqrt() * shown) - near / far).max(LEAST_SHARE);
    (beyond * (2.843_5 + beyond * (7.185_0 * beyond - 0.449_9))).recip().sqrt()
}

/// The blur that a line shows whose edge has its middle so far inside.
fn shown_of(looked_at: f64, middle: f64) -> f64 {
    let [near, far] = LOOK_PX;
    let (mut tail, mut density) = ([0.0; 4], [0.0; 4]);
    let at = [near - middle, near + middle, far - middle, far + middle].map(|x| x / looked_at);
    normal_tails(&at, &mut tail, &mut density);
    let flat = BINOMIAL_PX4 / (24.0 * looked_at.powi(4));
    let up_to = |i: usize| 0.5 - tail[i] - flat * density[i] * at[i] * (at[i] * at[i] - 3.0);
    let [gradient, step] = [(up_to(0) + up_to(1)) / (2.0 * near), up_to(2) + up_to(3)];
    step / (std::f64::consts::TAU.sqrt() * gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::band::LANES;
    use crate::detect::candidate::Candidate;
    use crate::detect::edge_model::blur_weight;
    use crate::detect::find::candidates_of;
    use crate::detect::rim::Rim;
    use crate::detect::shape::Shape;
    use crate::frames::Pixel;
    use crate::image::{GrayView, Samples};

    const SIZE: usize = 90;

    /// An image of one disc under a Gaussian blur, by integrals along its contour.
    fn image(e: &Ellipse, blur_px: f64) -> Vec<f32> {
        let (frame, mut rim) = (crate::conic::Frame::new(e), Rim::default());
        rim.set(&frame, blur_px, Shape::GAUSSIAN);
        rim.step = vec![0.0; rim.angles().count()];
        let places: Vec<(f64, f64)> =
            (0..SIZE * SIZE).map(|i| frame.inside((i % SIZE) as f64, (i / SIZE) as f64)).collect();
        let seen = places.chunks(LANES).flat_map(|some| {
            let at = |l: usize| some[l.min(some.len() - 1)];
            rim.seen(&std::array::from_fn(|l| at(l).0), &std::array::from_fn(|l| at(l).1)).inside
        });
        seen.take(SIZE * SIZE).map(|inside| (50.0 + 100.0 * inside) as f32).collect()
    }

    /// Discs of all sizes and blurs that go the short way, at several places within the pixel: within the change that ends its rounds.
    #[test]
    fn lines_tell_where_discs_are() {
        for (a, b, blur_px) in [
            (8.0, 7.0, 0.7),
            (13.0, 11.0, 0.7),
            (13.0, 11.0, 1.0),
            (13.0, 11.0, 1.4),
            (20.0, 12.0, 1.0),
            (22.0, 20.0, 1.0),
        ] {
            let mut off = [0.0_f64; 6];
            let count = 8;
            for k in 0..count {
                let center_px = Pixel::new(45.0 + 0.13 * f64::from(k), 44.6 + 0.29 * f64::from(k));
                let truth =
                    Ellipse { center_px, semi_major_px: a, semi_minor_px: b, angle_rad: 0.2 + 0.3 * f64::from(k) };
                let grey = image(&truth, blur_px);
                let view = GrayView::new(Samples::F32(&grey), SIZE, SIZE, SIZE).unwrap_or_else(|e| unreachable!("{e}"));
                let all: Vec<Candidate> = candidates_of(&view);
                assert_eq!(all.len(), 1, "{a} x {b} px");
                let (found, blur) = contour_of(&all[0].ellipse, all[0].blur_px);
                let now = [
                    found.center_px.u_px - center_px.u_px,
                    found.center_px.v_px - center_px.v_px,
                    found.semi_major_px - a,
                    found.semi_minor_px - b,
                    blur - blur_px,
                    all[0].ellipse.semi_major_px - a,
                ];
                (0..6).for_each(|i| off[i] += now[i] / f64::from(count));
            }
            let [u, v, a_px, b_px, blur, before] = off;
            assert!(before > 0.1, "the line of {a} x {b} px: {before}");
            assert!(u.abs() < 0.005 && v.abs() < 0.005, "{a} x {b} px: {off:?}");
            assert!(a_px.abs() < 0.035 && b_px.abs() < 0.035 && blur.abs() < 0.05, "{a} x {b} px: {off:?}");
        }
    }

    /// Places 3 px beside a line see two thirds of a step that is blurred by 3 px: taken for all of it they showed 1.9 px.
    #[test]
    fn lines_tell_much_blur_to_a_tenth() {
        for (a, b, blur_px) in [(9.0, 8.0, 1.7), (13.0, 11.0, 2.0), (20.0, 18.0, 3.0), (25.0, 22.0, 4.0)] {
            let center_px = Pixel::new(45.2, 44.7);
            let truth = Ellipse { center_px, semi_major_px: a, semi_minor_px: b, angle_rad: 0.4 };
            let grey = image(&truth, blur_px);
            let view = GrayView::new(Samples::F32(&grey), SIZE, SIZE, SIZE).unwrap_or_else(|e| unreachable!("{e}"));
            let all: Vec<Candidate> = candidates_of(&view);
            assert_eq!((all.len(), all[0].level), (1, 0), "{a} x {b} px");
            let (_, blur) = contour_of(&all[0].ellipse, all[0].blur_px);
            println!("{a} x {b} px, blur {blur_px} px: line says {:.2}, found {blur:.2}", all[0].blur_px);
            assert!((blur / blur_px - 1.0).abs() < 0.1, "{a} x {b} px: {blur} in place of {blur_px}");
        }
    }

    /// Within the prior of the blur, which they would be pulled to.
    #[test]
    fn lines_of_small_discs_tell_the_blur_to_its_prior() {
        for (a, b, blur_px) in
            [(4.8, 4.0, 0.58), (4.8, 4.0, 0.85), (4.8, 4.0, 1.72), (6.6, 6.0, 0.85), (9.6, 8.0, 3.01)]
        {
            let off: f64 = (0..8)
                .map(|k| {
                    let center_px = Pixel::new(45.0 + 0.13 * f64::from(k), 44.6 + 0.29 * f64::from(k));
                    let truth =
                        Ellipse { center_px, semi_major_px: a, semi_minor_px: b, angle_rad: 0.3 * f64::from(k) };
                    let grey = image(&truth, blur_px);
                    let view =
                        GrayView::new(Samples::F32(&grey), SIZE, SIZE, SIZE).unwrap_or_else(|e| unreachable!("{e}"));
                    let all: Vec<Candidate> = candidates_of(&view);
                    assert_eq!(all.len(), 1, "{a} x {b} px");
                    contour_of(&all[0].ellipse, all[0].blur_px).1 - blur_px
                })
                .sum();
            println!("{a} x {b} px, blur {blur_px} px: off by {:+.3} px", off / 8.0);
            assert!(blur_weight(blur_px) * (off / 8.0).powi(2) < 1.0, "{a} x {b} px, blur {blur_px} px: {off}");
        }
    }
}
