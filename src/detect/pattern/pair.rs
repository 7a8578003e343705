//! Two discs, or two bubbles cut by one plane: the pair that stands out.

use super::{Labelling, Relabelling, pattern_error, rejected_in_words};
use crate::detect::{Detection, Disc, LabelledDisc};
use crate::error::{Insufficient, Result};
use crate::target::{DotId, Pair};
use nalgebra::{Cholesky, Matrix2, Vector2};

/// Circles of one plane look alike but for their size: largest ratio of the axes of one seen in the metric of the other.
const ALIKE: f64 = 1.4;
/// A second candidate must be smaller than this fraction of the smaller disc of the pair.
const STANDS_OUT: f64 = 0.6;
/// Tolerance of the ratio of radii against the stated ratio, and of the spacing against the radii.
const RATIO: f64 = 1.25;
/// Radii that differ by less than this do not say which disc is which.
const EQUAL: f64 = 1.1;

fn shape(d: &Disc) -> Matrix2<f64> {
    let (s, c) = d.ellipse.angle_rad.sin_cos();
    let r = Matrix2::new(c, -s, s, c);
    r * Matrix2::new(d.ellipse.semi_major_px.powi(2), 0.0, 0.0, d.ellipse.semi_minor_px.powi(2)) * r.transpose()
}

fn radius(d: &Disc) -> f64 {
    d.ellipse.mean_radius_px()
}

/// Eigenvalues of the second shape in the metric of the first, and the distance of the centres in radii of the first.
fn compared(a: &Disc, b: &Disc) -> Option<(Vector2<f64>, f64)> {
    let l_inv = Cholesky::new(shape(a))?.l().try_inverse()?;
    let e = (l_inv * shape(b) * l_inv.transpose()).symmetric_eigenvalues();
    let d = Vector2::new(
        b.ellipse.center_px.u_px - a.ellipse.center_px.u_px,
        b.ellipse.center_px.v_px - a.ellipse.center_px.v_px,
    );
    Some((e, (l_inv * d).norm()))
}

/// Whether two discs may be the pair of the target.
fn consistent(a: &Disc, b: &Disc, target: &Pair) -> bool {
    let Some((e, distance)) = compared(a, b) else { return false };
    let alike = (e.max() / e.min()).sqrt() < ALIKE;
    let ratio = (e.max() * e.min()).powf(0.25);
    let near = |x: f64, y: f64| x / y < RATIO && y / x < RATIO;
    let sized = target.radii_mm.is_none_or(|[r0, r1]| near(ratio, r1 / r0) || near(ratio, r0 / r1));
    // A spacing is compared over the mean radius, which perspective changes least.
    let spaced = match (target.radii_mm, target.spacing_mm) {
        (Some([r0, r1]), Some(s)) => near(distance / (0.5 * (1.0 + ratio)), s / (0.5 * (r0 + r1))),
        _ => true,
    };
    alike && sized && spaced && distance > 1.0 + ratio
}

pub(super) fn label(image: &str, detection: &Detection, target: &Pair, what: &str) -> Result<Labelling> {
    let discs = &detection.discs;
    if discs.len() < 2 {
        let hint = format!(
            "{}; both discs must be whole, apart from each other, and inside the image",
            rejected_in_words(detection)
        );
        return Err(Insufficient::TooFewDiscs { image: image.to_owned(), found: discs.len(), needed: 2, hint }.into());
    }
    let mut by_size: Vec<usize> = (0..discs.len()).collect();
    by_size.sort_by(|a, b| radius(&discs[*b]).total_cmp(&radius(&discs[*a])).then(a.cmp(b)));
    // A wisp of smoke within a bubble is no disc of the target.
    let within = |a: usize, b: usize| {
        let near = || compared(&discs[a], &discs[b]).is_some_and(|(_, distance)| distance < 1.0);
        discs[a].polarity == discs[b].polarity && near()
    };
    let inner: Vec<usize> = (1..by_size.len())
        .filter(|j| by_size[..*j].iter().any(|a| within(*a, by_size[*j])))
        .map(|j| by_size[j])
        .collect();
    by_size.retain(|k| !inner.contains(k));
    // The pair whose smaller disc is largest; then the larger disc counts.
    let pairs = || {
        (1..by_size.len()).flat_map(|j| (0..j).map(move |i| (i, j))).filter(|(i, j)| {
            let (a, b) = (&discs[by_size[*i]], &discs[by_size[*j]]);
            a.polarity == b.polarity && consistent(a, b, target)
        })
    };
    let Some((i, j)) = pairs().next() else {
        return Err(pattern_error(
            image,
            format!(
                "{} discs were found, but no two of them fit {what} (alike in shape, apart, sizes and spacing as stated); {}",
                discs.len(),
                rejected_in_words(detection)
            ),
        ));
    };
    let smaller = radius(&discs[by_size[j]]);
    let rival = pairs().find(|(k, l)| (*k, *l) != (i, j) && radius(&discs[by_size[*l]]) > STANDS_OUT * smaller);
    if let Some((k, l)) = rival {
        let at = |n: usize| {
            let c = discs[by_size[n]].ellipse.center_px;
            format!("({:.0}, {:.0})", c.u_px, c.v_px)
        };
        return Err(pattern_error(
            image,
            format!(
                "more than one pair of discs could be the target: {} with {}, and {} with {}; remove the other discs from the view, or state radii_mm and spacing_mm",
                at(i),
                at(j),
                at(k),
                at(l)
            ),
        ));
    }
    Ok(named(discs, [by_size[i], by_size[j]], target))
}

/// Numbers for larger and smaller disc, provisional: the adjustment decides by its cost.
fn named(discs: &[Disc], [larger, smaller]: [usize; 2], target: &Pair) -> Labelling {
    let ratio = radius(&discs[larger]) / radius(&discs[smaller]);
    let second_is_larger = target.radii_mm.is_some_and(|[r0, r1]| r1 > r0);
    let u = |i: usize| discs[i].ellipse.center_px.u_px;
    let zero_first = if ratio < EQUAL { u(larger) <= u(smaller) } else { !second_is_larger };
    let order = if zero_first { [larger, smaller] } else { [smaller, larger] };
    let id = |column| DotId { column, row: 0, level: 0 };
    Labelling {
        discs: vec![LabelledDisc { disc: order[0], id: id(0) }, LabelledDisc { disc: order[1], id: id(1) }],
        alternatives: vec![Relabelling { quarter_turns: 2, columns: 1, rows: 0, two_levels: false }],
        ..Labelling::default()
    }
}
