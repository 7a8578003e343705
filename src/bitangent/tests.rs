use super::*;
use crate::conic::Ellipse;
use crate::error::{Error, Insufficient};
use crate::frames::Pixel;
use crate::stats::random::Random;
use nalgebra::{DMatrix, Matrix3, Vector3};

fn ellipse(u: f64, v: f64, a: f64, b: f64, phi: f64) -> Ellipse {
    Ellipse { center_px: Pixel::new(u, v), semi_major_px: a, semi_minor_px: b, angle_rad: phi }
}

fn from_parameters(p: &[f64]) -> Ellipse {
    ellipse(p[0], p[1], p[2], p[3], p[4])
}

/// Image of the circle (centre, radius in target x, y up) under `h`, through the dual conic.
fn imaged(h: &Matrix3<f64>, center: Vector2<f64>, r: f64) -> Ellipse {
    let t = Matrix3::new(r, 0.0, center.x, 0.0, r, center.y, 0.0, 0.0, 1.0);
    let dual = h * t * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0)) * t.transpose() * h.transpose();
    let dual = dual / -dual.m33;
    let c = Vector2::new(-dual.m13, -dual.m23);
    let m = dual.fixed_view::<2, 2>(0, 0) + c * c.transpose();
    let (mean, half) = (0.5 * (m.m11 + m.m22), 0.5 * (m.m11 - m.m22));
    let spread = half.hypot(m.m12);
    ellipse(c.x, c.y, (mean + spread).sqrt(), (mean - spread).sqrt(), 0.5 * m.m12.atan2(half))
}

/// Homography target mm -> px of a camera at the paper's geometry: rotation about the vertical axis, then in the plane.
fn view(f_px: f64, distance_mm: f64, oblique_rad: f64, roll_rad: f64) -> Matrix3<f64> {
    let (s, c) = oblique_rad.sin_cos();
    let (sr, cr) = roll_rad.sin_cos();
    // Target y up, image v down: the second row changes sign.
    let target = Matrix3::new(cr, -sr, 0.0, sr, cr, 0.0, 0.0, 0.0, 1.0);
    let pose = Matrix3::new(c, 0.0, 0.0, 0.0, -1.0, 0.0, s, 0.0, distance_mm);
    Matrix3::new(f_px, 0.0, 512.0, 0.0, f_px, 384.0, 0.0, 0.0, 1.0) * pose * target
}

fn mapped(h: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    let q = h * Vector3::new(p.x, p.y, 1.0);
    q.xy() / q.z
}

fn random_pair(r: &mut Random) -> [Ellipse; 2] {
    let mut any = || {
        let a = r.in_range(2.0, 300.0);
        let b = a * r.in_range(0.08, 1.0);
        (a, ellipse(r.in_range(0.0, 2000.0), r.in_range(0.0, 2000.0), a, b, r.in_range(-1.5, 1.5)))
    };
    [any().1, any().1]
}

/// A covariance with correlations, scaled like that of a contour fit.
fn covariance(r: &mut Random, e: &Ellipse, sigma_px: f64) -> SMatrix<f64, 5, 5> {
    let mix = SMatrix::<f64, 5, 5>::from_fn(|i, j| if i == j { 1.0 } else { 0.3 * r.gauss() });
    let angle = 1.0 / (e.semi_major_px - e.semi_minor_px).max(0.05 * e.semi_major_px);
    let scale = SMatrix::from_diagonal(&SVector::from([sigma_px, sigma_px, sigma_px, sigma_px, sigma_px * angle]));
    scale * mix * mix.transpose() * scale
}

/// How far the line is from being tangent to the ellipse, px, through the implicit equation of the ellipse.
fn tangency_gap(line: &Line, e: &Ellipse) -> f64 {
    let (s, c) = e.angle_rad.sin_cos();
    let (x, y) = (c * line.normal.x + s * line.normal.y, -s * line.normal.x + c * line.normal.y);
    let d = line.distance_px - line.normal.x * e.center_px.u_px - line.normal.y * e.center_px.v_px;
    d.abs() - (e.semi_major_px * x).hypot(e.semi_minor_px * y)
}

/// Implicit equation of the ellipse, 0 on it, 1 per relative px of the minor axis.
fn off_ellipse(p: &Vector2<f64>, e: &Ellipse) -> f64 {
    let (s, c) = e.angle_rad.sin_cos();
    let d = p - Vector2::new(e.center_px.u_px, e.center_px.v_px);
    ((c * d.x + s * d.y) / e.semi_major_px).hypot((-s * d.x + c * d.y) / e.semi_minor_px) - 1.0
}

fn check_incidence(e: &[Ellipse; 2], b: &Bitangents) {
    let size = 2000.0_f64;
    for (k, line) in b.lines.iter().enumerate() {
        for i in 0..2 {
            assert!(tangency_gap(line, &e[i]).abs() < 1e-12 * size, "{e:?} line {k} disc {i}");
            let p = b.point(2 * k + i).unwrap();
            assert!(off_ellipse(&p, &e[i]).abs() * e[i].semi_minor_px < 1e-11 * size, "{e:?} {k} {i}");
            assert!((line.normal.dot(&p) - line.distance_px).abs() < 1e-12 * size);
        }
    }
    for (c, [p, q]) in CROSSINGS.into_iter().enumerate() {
        let Some(x) = b.point(8 + c) else { continue };
        for line in [p, q] {
            let off = b.lines[line].normal.dot(&x) - b.lines[line].distance_px;
            assert!(off.abs() < 1e-12 * (size + x.norm()), "{off}");
        }
    }
}

#[test]
fn tangents_touch_and_cross_on_thousands_of_random_pairs() {
    let mut r = Random(1);
    let (mut separated, mut refused) = (0, 0);
    for _ in 0..5000 {
        let e = random_pair(&mut r);
        match bitangents(&e[0], &e[1]) {
            Ok(b) => {
                separated += 1;
                check_incidence(&e, &b);
                // Left and right of the direction 0 -> 1 (v down), by a normal that separates the discs.
                let n = (b.lines[2].normal + b.lines[3].normal).normalize();
                for k in 0..4 {
                    assert_eq!(n.perp(&b.lines[k].normal) < 0.0, k % 2 == 0, "{e:?} line {k}");
                }
            }
            Err(Error::Insufficient(Insufficient::NotSeparated { gap })) => {
                refused += 1;
                assert!(gap <= 1e-6);
                assert!(discs_meet(&e), "{e:?} gap {gap}");
            }
            Err(other) => panic!("{other}"),
        }
    }
    assert!(separated > 3000 && refused > 100, "{separated} {refused}");
}

/// Brute force: a boundary point of one inside the other, or a centre inside the other.
fn discs_meet(e: &[Ellipse; 2]) -> bool {
    (0..2).any(|i| {
        let inside = |p: Pixel| off_ellipse(&Vector2::new(p.u_px, p.v_px), &e[1 - i]) < 1e-9;
        inside(e[i].center_px) || (0..20_000).any(|k| inside(e[i].point(k as f64 * 3.1416e-4)))
    })
}

#[test]
fn narrow_gaps_needles_and_extreme_sizes() {
    let cases = [
        [ellipse(0.0, 0.0, 10.0, 10.0, 0.0), ellipse(20.0 + 1e-6, 0.0, 10.0, 10.0, 0.0)],
        [ellipse(5.0, 7.0, 900.0, 900.0, 0.3), ellipse(910.0, 7.0, 0.5, 0.4, 0.3)],
        [ellipse(5.0, 7.0, 0.5, 0.4, 0.3), ellipse(1800.0, 7.0, 900.0, 20.0, 0.3)],
        // Needles side by side: the centre line does not separate them.
        [ellipse(0.0, 0.0, 100.0, 0.5, 0.78), ellipse(4.0, 0.0, 100.0, 0.5, 0.78)],
        // Needles like a T.
        [ellipse(0.0, 0.0, 100.0, 0.1, 0.0), ellipse(3.0, 100.5, 100.0, 0.1, std::f64::consts::FRAC_PI_2)],
    ];
    for e in cases {
        let b = bitangents(&e[0], &e[1]).unwrap();
        check_incidence(&e, &b);
    }
}

#[test]
fn touching_overlapping_contained_and_broken_ellipses_are_refused() {
    let a = ellipse(0.0, 0.0, 10.0, 5.0, 0.0);
    for (b, gap) in [
        (ellipse(20.0, 0.0, 10.0, 5.0, 0.0), 0.0),
        (ellipse(18.0, 0.0, 10.0, 5.0, 0.0), -2.0),
        (ellipse(0.0, 0.0, 2.0, 1.0, 0.0), -6.0),
    ] {
        match bitangents(&a, &b) {
            Err(Error::Insufficient(Insufficient::NotSeparated { gap: g })) => {
                assert!((g - gap).abs() < 1.0 + 0.5 * gap.abs(), "{g} {gap}");
            }
            other => panic!("{other:?}"),
        }
    }
    for b in [
        ellipse(f64::NAN, 0.0, 1.0, 1.0, 0.0),
        ellipse(100.0, 0.0, 1.0, 0.0, 0.0),
        ellipse(100.0, 0.0, -1.0, -2.0, 0.0),
    ] {
        assert!(matches!(bitangents(&a, &b), Err(Error::Invalid(_))));
    }
}

#[test]
fn equal_radii_put_the_external_crossing_at_infinity() {
    let e = [ellipse(100.0, 50.0, 10.0, 6.0, 0.4), ellipse(160.0, 130.0, 10.0, 6.0, 0.4)];
    let b = bitangents(&e[0], &e[1]).unwrap();
    match b.external {
        ExternalCrossing::AtInfinity(d) => assert!((d - Vector2::new(0.6, 0.8)).norm() < 1e-12),
        other => panic!("{other:?}"),
    }
    assert!(b.point(EXTERNAL_CROSSING).is_none());
    check_incidence(&e, &b);
    let mut r = Random(2);
    let c = [covariance(&mut r, &e[0], 0.01), covariance(&mut r, &e[1], 0.01)];
    let w = b.whitening([&c[0], &c[1]], ExternalUse::WhereMeasurable).unwrap();
    assert!(!w.external && w.rank == 10);
    // Almost equal: the crossing is finite, but not measurable.
    let near = bitangents(&e[0], &ellipse(160.0, 130.0, 10.001, 6.001, 0.4)).unwrap();
    assert!(matches!(near.external, ExternalCrossing::At(_)));
    let w = near.whitening([&c[0], &c[1]], ExternalUse::WhereMeasurable).unwrap();
    assert!(!w.external && w.rank == 10);
    assert!(w.matrix.fixed_columns::<2>(2 * EXTERNAL_CROSSING).iter().all(|x| *x == 0.0));
}

#[test]
fn circles_mapped_through_a_view_give_the_features_of_the_mapped_conics() {
    let mut r = Random(3);
    let mut worst = 0.0_f64;
    for _ in 0..500 {
        let (r0, r1) = (r.in_range(2.0, 14.0), r.in_range(2.0, 14.0));
        let turn = r.in_range(0.0, 6.2);
        let c0 = Vector2::new(r.in_range(-10.0, 10.0), r.in_range(-10.0, 10.0));
        let c1 = c0 + Vector2::new(turn.cos(), turn.sin()) * (r0 + r1) * r.in_range(1.01, 2.0);
        let h = view(8889.0, 500.0, r.in_range(-1.2, 1.2), r.in_range(0.0, 6.2));
        let circles = circle_features(c0, r0, c1, r1).unwrap();
        let image = bitangents(&imaged(&h, c0, r0), &imaged(&h, c1, r1)).unwrap();
        for i in 0..POINTS {
            let x = mapped(&h, &circles.points_mm.fixed_rows::<2>(2 * i).into_owned());
            let gap = (image.point(i).unwrap() - x).norm();
            // The external crossing may lie thousands of widths away: relative there.
            let relative = if i == EXTERNAL_CROSSING { gap * 1e-6 } else { gap };
            worst = worst.max(relative);
        }
    }
    assert!(worst < 1e-9, "{worst:e} px");
}

#[test]
fn exchanging_the_discs_permutes_the_points_as_documented() {
    let mut r = Random(4);
    for _ in 0..200 {
        let e = random_pair(&mut r);
        let (Ok(a), Ok(b)) = (bitangents(&e[0], &e[1]), bitangents(&e[1], &e[0])) else { continue };
        for i in 0..POINTS {
            let (p, q) = (a.point(SWAPPED[i]).unwrap(), b.point(i).unwrap());
            assert!((p - q).norm() < 1e-8 * (1.0 + p.norm()), "{i} {p} {q}");
        }
    }
}

#[test]
fn jacobian_is_the_central_difference() {
    let mut r = Random(5);
    let mut checked = 0;
    while checked < 200 {
        let e = random_pair(&mut r);
        let Ok(b) = bitangents(&e[0], &e[1]) else { continue };
        let gap = (b.point(4).unwrap() - b.point(5).unwrap()).norm();
        // Very far crossings and grazing tangents have no accurate difference quotient; the formula does not care.
        if b.point(EXTERNAL_CROSSING).unwrap().norm() > 2e4 || gap < 20.0 {
            continue;
        }
        checked += 1;
        let p: Vec<f64> = e.iter().flat_map(|e| e.parameters().iter().copied().collect::<Vec<_>>()).collect();
        for k in 0..10 {
            let h = if k % 5 == 4 { 1e-4 } else { 1e-3 * e[k / 5].semi_minor_px };
            let at = |step: f64| {
                let mut q = p.clone();
                q[k] += step;
                bitangents(&from_parameters(&q[..5]), &from_parameters(&q[5..])).unwrap().points
            };
            let central = |h: f64| (at(h) - at(-h)) / (2.0 * h);
            // Richardson: the crossings of slim ellipses have large third derivatives.
            let numeric = (central(0.5 * h) * 4.0 - central(h)) / 3.0;
            let analytic = b.jacobian.column(k);
            for i in 0..28 {
                let scale = numeric.norm() * 1e-5 + 1e-5;
                assert!((numeric[i] - analytic[i]).abs() < scale, "row {i} column {k}: {} {}", numeric[i], analytic[i]);
            }
        }
    }
}

#[test]
fn circle_jacobian_is_the_central_difference() {
    let at = |p: &[f64; 6]| circle_features(Vector2::new(p[0], p[1]), p[2], Vector2::new(p[3], p[4]), p[5]).unwrap();
    for p in [[1.0, 2.0, 12.5, 20.0, -16.0, 10.0], [0.0, 0.0, 3.0, -5.0, 11.0, 7.0]] {
        let analytic = at(&p).jacobian;
        for k in 0..6 {
            let h = 1e-5;
            let (mut a, mut b) = (p, p);
            a[k] += h;
            b[k] -= h;
            let numeric = (at(&a).points_mm - at(&b).points_mm) / (2.0 * h);
            assert!((numeric - analytic.column(k)).norm() < 1e-7 * (1.0 + numeric.norm()), "{k}");
        }
    }
    assert!(circle_features(Vector2::zeros(), 5.0, Vector2::new(9.0, 0.0), 5.0).is_err());
    assert!(circle_features(Vector2::zeros(), -5.0, Vector2::new(9.0, 0.0), 5.0).is_err());
    let equal = circle_features(Vector2::zeros(), 3.0, Vector2::new(9.0, 0.0), 3.0).unwrap();
    assert!(!equal.external_is_finite && equal.jacobian.iter().all(|x| x.is_finite()));
}

/// The pair of the paper: radii 12.5 and 10 mm, spacing 26 mm, 500 mm away at 45 degrees, f = 8889 px.
fn paper_pair(roll_rad: f64) -> [Ellipse; 2] {
    let h = view(8889.0, 500.0, std::f64::consts::FRAC_PI_4, roll_rad);
    [imaged(&h, Vector2::new(-13.0, 0.0), 12.5), imaged(&h, Vector2::new(13.0, 0.0), 10.0)]
}

/// Covariance of an ellipse fitted to `count` edge points of sigma 0.05 px, spaced evenly in the eccentric angle.
fn contour_covariance(e: &Ellipse, count: usize) -> SMatrix<f64, 5, 5> {
    let mut information = SMatrix::<f64, 5, 5>::zeros();
    for k in 0..count {
        let t = std::f64::consts::TAU * k as f64 / count as f64;
        let x = e.point(t);
        let p = e.parameters();
        // Movement of the contour along its normal, by differences of the point at fixed t.
        let tangent = {
            let (a, b) = (e.point(t + 1e-6), e.point(t - 1e-6));
            Vector2::new(a.u_px - b.u_px, a.v_px - b.v_px)
        };
        let normal = Vector2::new(tangent.y, -tangent.x).normalize();
        let row = SVector::<f64, 5>::from_fn(|i, _| {
            let mut q = p;
            q[i] += 1e-6;
            let y = from_parameters(q.as_slice()).point(t);
            normal.dot(&Vector2::new(y.u_px - x.u_px, y.v_px - x.v_px)) * 1e6
        });
        information += row * row.transpose() / (0.05 * 0.05);
    }
    information.try_inverse().unwrap()
}

/// Sigma of every point and the largest correlation between coordinates other than the external crossing's.
fn sigmas_at_the_paper_geometry(roll_rad: f64) -> ([f64; POINTS], f64) {
    let e = paper_pair(roll_rad);
    let b = bitangents(&e[0], &e[1]).unwrap();
    let c = [contour_covariance(&e[0], 600), contour_covariance(&e[1], 600)];
    let cov = b.covariance([&c[0], &c[1]]);
    let mut sorted: Vec<f64> =
        DMatrix::from_column_slice(28, 28, cov.as_slice()).symmetric_eigen().eigenvalues.iter().copied().collect();
    sorted.sort_by(|a, b| b.total_cmp(a));
    assert!(sorted[9] > 1e-7 * sorted[0] && sorted[10].abs() < 1e-12 * sorted[0], "{sorted:?}");
    let sigma = std::array::from_fn(|i| (cov[(2 * i, 2 * i)] + cov[(2 * i + 1, 2 * i + 1)]).sqrt());
    let pairs = (0..28).flat_map(|i| (0..i).map(move |j| (i, j)));
    let largest = pairs
        .filter(|(i, j)| i / 2 != EXTERNAL_CROSSING && j / 2 != EXTERNAL_CROSSING)
        .map(|(i, j)| (cov[(i, j)] / (cov[(i, i)] * cov[(j, j)]).sqrt()).abs())
        .fold(0.0, f64::max);
    (sigma, largest)
}

#[test]
fn numbers_of_the_paper_geometry() {
    for roll_rad in [0.0, std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_2] {
        let (sigma, correlation) = sigmas_at_the_paper_geometry(roll_rad);
        let mut others: Vec<f64> = (0..POINTS).filter(|i| *i != EXTERNAL_CROSSING).map(|i| sigma[i]).collect();
        others.sort_by(f64::total_cmp);
        let (to_median, to_best) = (sigma[EXTERNAL_CROSSING] / others[6], sigma[EXTERNAL_CROSSING] / others[0]);
        println!(
            "turned {:.0} deg: external crossing {to_median:.1} times the median sigma, {to_best:.1} times the best; \
             largest correlation {correlation:.3}",
            roll_rad.to_degrees()
        );
        assert!(to_median > 10.0 && to_best > 20.0 && to_best < 80.0, "{sigma:?}");
        assert!(correlation > 0.85 && correlation < 1.0, "{correlation}");
    }
}

#[test]
fn whitened_features_have_unit_covariance_and_lose_nothing_without_the_external_crossing() {
    let mut r = Random(6);
    let mut information = Vec::new();
    let e = paper_pair(0.0);
    let c = [covariance(&mut r, &e[0], 0.02), covariance(&mut r, &e[1], 0.02)];
    let b = bitangents(&e[0], &e[1]).unwrap();
    for external in [ExternalUse::WhereMeasurable, ExternalUse::Never] {
        let w = b.whitening([&c[0], &c[1]], external).unwrap();
        assert_eq!((w.rank, w.external), (10, external == ExternalUse::WhereMeasurable));
        let unit = w.matrix * b.covariance([&c[0], &c[1]]) * w.matrix.transpose();
        assert!((unit - SMatrix::<f64, 10, 10>::identity()).norm() < 1e-7, "{unit}");
        let wj = w.matrix * b.jacobian;
        information.push(wj.transpose() * wj);
    }
    // Both give back the information of the ellipses themselves.
    let mut parameters = SMatrix::<f64, 10, 10>::zeros();
    for i in 0..2 {
        parameters.fixed_view_mut::<5, 5>(5 * i, 5 * i).copy_from(&c[i].try_inverse().unwrap());
    }
    for m in information {
        for i in 0..10 {
            for j in 0..10 {
                let scale = (parameters[(i, i)] * parameters[(j, j)]).sqrt();
                assert!((m[(i, j)] - parameters[(i, j)]).abs() < 1e-6 * scale, "{i} {j}");
            }
        }
    }
    let mut broken = c[0];
    broken[(0, 0)] = -1.0;
    assert!(b.whitening([&broken, &c[1]], ExternalUse::Never).is_err());
}

#[test]
fn sampled_covariance_is_the_predicted_one() {
    let mut r = Random(7);
    let e = paper_pair(0.0);
    let c = [covariance(&mut r, &e[0], 0.02), covariance(&mut r, &e[1], 0.02)];
    let root = [0, 1].map(|i: usize| c[i].cholesky().unwrap().l());
    let b = bitangents(&e[0], &e[1]).unwrap();
    let w = b.whitening([&c[0], &c[1]], ExternalUse::WhereMeasurable).unwrap();
    let cov = b.covariance([&c[0], &c[1]]);
    let runs = 20_000;
    let (mut nees, mut sampled) = (0.0, SVector::<f64, 28>::zeros());
    for _ in 0..runs {
        let noisy = [0, 1].map(|i: usize| {
            let g = SVector::<f64, 5>::from_fn(|_, _| r.gauss());
            from_parameters((e[i].parameters() + root[i] * g).as_slice())
        });
        let d = bitangents(&noisy[0], &noisy[1]).unwrap().points - b.points;
        nees += (w.matrix * d).norm_squared();
        sampled += d.component_mul(&d);
    }
    // Chi-square with 10 degrees of freedom: mean 10, variance 20.
    let z = (nees / runs as f64 - 10.0) / (20.0 / runs as f64).sqrt();
    assert!(z.abs() < 4.0, "z = {z}");
    for i in 0..28 {
        let z = (sampled[i] / runs as f64 / cov[(i, i)] - 1.0) / (2.0 / runs as f64).sqrt();
        assert!(z.abs() < 4.5, "row {i}: z = {z}");
    }
}
