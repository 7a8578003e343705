//! Three components from planar fields of a known flow seen through the exact cameras: bias, sigmas, units, missing vectors.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod render;
mod scene;

use nalgebra::Vector3;
use render::Random;
use spivcal::camera::Camera;
use spivcal::dewarp::{SheetGrid, SheetMap};
use spivcal::frames::{Cam, Rig, Sheet};
use spivcal::reconstruct::*;
use spivcal::record::Record;
use spivcal::rigid::{Motion, rotation_exp};
use std::process::Command;

/// A vortex with an axial jet, mm per interval; lengths of some 10 mm.
fn flow(x: f64, y: f64) -> Vector3<f64> {
    let g = (-(x * x + y * y) / 150.0).exp();
    Vector3::new(0.1 - 0.03 * y * g, 0.02 + 0.03 * x * g, 0.15 * g - 0.05)
}

fn maps() -> [SheetMap; 2] {
    [0, 1].map(|c| SheetMap::from_record(&scene::record(), c).unwrap())
}

/// Image of a point of the sheet, by the record's cameras alone.
fn image(record: &Record, c: usize, p: &Vector3<f64>) -> [f64; 2] {
    let in_rig = record.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>().apply(p);
    let in_cam = record.cameras[c].cam_from_rig.motion::<Cam, Rig>().apply(&in_rig);
    let q = Camera::new(record.cameras[c].intrinsics()).unwrap().project_xyz(&in_cam).unwrap();
    [q.x, q.y]
}

/// What an ideal planar evaluation gives in raw pixels, with noise; `keep` leaves vectors out.
fn raw_field(c: usize, start: bool, sigma_px: f64, seed: u64, keep: impl Fn(usize) -> bool) -> String {
    let (record, map) = (scene::record(), &maps()[c]);
    let mut random = Random(seed);
    let mut text = String::from("x_px,y_px,dx_px,dy_px\n");
    // The two cameras are evaluated on different grids.
    let step = [16.0, 19.0][c];
    let mut n = 0;
    for j in 0..((760.0 / step) as usize) {
        for i in 0..((1010.0 / step) as usize) {
            let (u, v) = (8.0 + step * i as f64, 6.0 + step * j as f64);
            // The particle whose path has its middle (or its beginning) on this pixel and in the sheet.
            let p = map.sheet_of_pixel(&[u], &[v], &[0.0]).unwrap();
            let p = Vector3::new(p.x_mm[0], p.y_mm[0], 0.0);
            let d = flow(p.x, p.y);
            let (back, ahead) = if start { (0.0, 1.0) } else { (0.5, 0.5) };
            let (a, b) = (image(&record, c, &(p - d * back)), image(&record, c, &(p + d * ahead)));
            let (du, dv) = (b[0] - a[0] + sigma_px * random.normal(), b[1] - a[1] + sigma_px * random.normal());
            n += 1;
            if keep(n) {
                text.push_str(&format!("{u},{v},{du:.9},{dv:.9}\n"));
            } else {
                text.push_str(&format!("{u},{v},nan,nan\n"));
            }
        }
    }
    text
}

/// In mm (or pixels) of dewarped images, both on one grid.
fn dewarped_field(c: usize, grid: Option<&SheetGrid>, sigma_px: f64, seed: u64) -> String {
    let (record, map) = (scene::record(), &maps()[c]);
    let mut random = Random(seed);
    let mut text = String::from(if grid.is_some() { "x_px,y_px,dx_px,dy_px\n" } else { "x_mm,y_mm,dx_mm,dy_mm\n" });
    for j in 0..25 {
        for i in 0..33 {
            let (x, y) = (-16.0 + f64::from(i), -12.0 + f64::from(j));
            // Seen places of the two ends: mapped back to the sheet as a dewarped image is. The middle of the seen path is (x, y) but
            // for a part in a million.
            let d = flow(x, y);
            // Noise is alike along both axes of the sensor, and stretched by dewarping.
            let ends = [-0.5, 0.5].map(|s| {
                let mut q = image(&record, c, &(Vector3::new(x, y, 0.0) + d * s));
                q = q.map(|a| a + sigma_px / std::f64::consts::SQRT_2 * random.normal());
                let p = map.sheet_of_pixel(&[q[0]], &[q[1]], &[0.0]).unwrap();
                [p.x_mm[0], p.y_mm[0]]
            });
            let (dx, dy) = (ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
            match grid {
                None => text.push_str(&format!("{x},{y},{dx:.9},{dy:.9}\n")),
                Some(g) => {
                    let q = g.pixel(x, y);
                    text.push_str(&format!(
                        "{:.9},{:.9},{:.9},{:.9}\n",
                        q[0],
                        q[1],
                        dx / g.mm_per_px,
                        -dy / g.mm_per_px
                    ));
                }
            }
        }
    }
    text
}

fn options(unit: FieldUnit) -> Options {
    Options { unit, dewarped: None, reference: Reference::Center, sigma: None, spacing_mm: None, perturbed: None }
}

/// The field of windows that share this part with their neighbours.
fn beside(text: &str, overlap: f64) -> PlanarField {
    PlanarField::new(&parse_field(text, "f.csv").unwrap()).unwrap().overlapping(overlap).unwrap()
}

fn solved(texts: [&str; 2], options: &Options) -> VectorField {
    // Noise is drawn for each vector by itself.
    let fields = texts.map(|t| beside(t, 0.0));
    let m = maps();
    reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], options).unwrap()
}

/// Largest and root mean square departure from the flow, mm, per component.
fn departures(f: &VectorField) -> [[f64; 2]; 3] {
    let (mut largest, mut sum, mut n) = ([0.0_f64; 3], [0.0; 3], 0.0);
    for i in 0..f.x_mm.len() {
        let d = Vector3::new(f.u_mm[i], f.v_mm[i], f.w_mm[i]) - flow(f.x_mm[i], f.y_mm[i]);
        if d.x.is_finite() && f.flags[i] == 0 {
            n += 1.0;
            (0..3).for_each(|a| largest[a] = largest[a].max(d[a].abs()));
            (0..3).for_each(|a| sum[a] += d[a] * d[a]);
        }
    }
    assert!(n > 300.0, "{n}");
    [0, 1, 2].map(|a| [largest[a], (sum[a] / n).sqrt()])
}

/// Slope of measured w against true w, less one: the bias of the out-of-plane gain.
fn bias_of_w(f: &VectorField) -> f64 {
    let (mut a, mut b) = (0.0, 0.0);
    for i in (0..f.x_mm.len()).filter(|i| f.w_mm[*i].is_finite()) {
        let w = flow(f.x_mm[i], f.y_mm[i]).z;
        a += f.w_mm[i] * w;
        b += w * w;
    }
    a / b - 1.0
}

/// The grid of a turned frame has corners that no camera measured: they are no vectors that are missing.
#[test]
fn corners_of_a_turned_frame_are_not_missing() {
    let texts = [0, 1].map(|c| raw_field(c, false, 0.0, 1, |_| true));
    let fields = texts.each_ref().map(|t| beside(t, 0.0));
    let turn = Motion::new(rotation_exp(&Vector3::new(0.0, 0.0, 0.8)), Vector3::zeros());
    let m: Vec<SheetMap> = maps().iter().map(|m| m.in_frame(&turn)).collect();
    let names = ["left", "right"];
    let f = reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], names, &options(FieldUnit::RawPixels)).unwrap();
    let (filled, all) = f.filled();
    println!("{filled} vectors, {} points covered, {all} in all", f.covered);
    assert!((filled as f64) < 0.7 * all as f64 && filled > 400, "{filled} of {all}");
    assert!(f.covered >= filled && filled as f64 > 0.97 * f.covered as f64, "{filled} of {}", f.covered);
}

#[test]
fn a_known_flow_is_found_without_bias_in_every_unit() {
    for start in [false, true] {
        let texts = [0, 1].map(|c| raw_field(c, start, 0.0, 1, |_| true));
        let reference = if start { Reference::Start } else { Reference::Center };
        let f = solved([&texts[0], &texts[1]], &Options { reference, ..options(FieldUnit::RawPixels) });
        let (d, bias) = (departures(&f), bias_of_w(&f));
        println!("raw, start {start}: largest and rms {d:.7?} mm, bias of w {:.1e}; {:?} vectors", bias, f.filled());
        assert!(bias.abs() < 1e-4 && d[2][1] < 1e-4, "{d:?} {bias}");
    }
    let of_start = [0, 1].map(|c| raw_field(c, true, 0.0, 1, |_| true));
    let wrong = departures(&solved([&of_start[0], &of_start[1]], &options(FieldUnit::RawPixels)));
    println!("start taken for the middle: {wrong:.7?} mm");
    assert!(wrong[2][1] > 1e-5, "a wrong reference must show: {wrong:?}");
    let texts = [0, 1].map(|c| dewarped_field(c, None, 0.0, 1));
    let f = solved([&texts[0], &texts[1]], &options(FieldUnit::Millimetres));
    let (d, bias) = (departures(&f), bias_of_w(&f));
    println!("mm: largest and rms {d:.7?} mm, bias of w {bias:.1e}");
    assert_eq!(f.filled(), (33 * 25, 33 * 25));
    assert!(bias.abs() < 1e-4 && d[2][0] < 1e-4, "{d:?} {bias}");
    let m = maps();
    let grid = SheetGrid::common(&[&m[0], &m[1]], None).unwrap();
    let texts = [0, 1].map(|c| dewarped_field(c, Some(&grid), 0.0, 1));
    let g = solved([&texts[0], &texts[1]], &Options { dewarped: Some(grid), ..options(FieldUnit::DewarpedPixels) });
    for (a, b) in g.w_mm.iter().zip(&f.w_mm) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
}

#[test]
fn sigmas_are_those_of_the_scatter() {
    for (unit, sigma_px) in [(FieldUnit::RawPixels, 0.08), (FieldUnit::Millimetres, 0.08)] {
        let texts = [0, 1].map(|c| match unit {
            FieldUnit::RawPixels => raw_field(c, false, sigma_px, 7 + c as u64, |_| true),
            _ => dewarped_field(c, None, sigma_px, 7 + c as u64),
        });
        let f = solved([&texts[0], &texts[1]], &options(unit));
        let mut sums = [0.0; 3];
        let mut n = 0.0;
        for i in (0..f.x_mm.len()).filter(|i| f.w_mm[*i].is_finite()) {
            let d = Vector3::new(f.u_mm[i], f.v_mm[i], f.w_mm[i]) - flow(f.x_mm[i], f.y_mm[i]);
            (0..3).for_each(|a| sums[a] += (d[a] / f.sigma_mm[a][i]).powi(2));
            n += 1.0;
        }
        let ratio = sums.map(|s| (s / n).sqrt());
        println!("{unit:?}: scatter over sigma {ratio:.3?}, estimated sigma {:.4}", f.sigma);
        // Geometric mean of the sides of a pixel in the middle of the sheet, both cameras.
        let sides = [0, 1].map(|c| {
            let q = image(&scene::record(), c, &Vector3::zeros());
            let at = |du: f64, dv: f64| maps()[c].sheet_of_pixel(&[q[0] + du], &[q[1] + dv], &[0.0]).unwrap();
            let (o, u, v) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
            let by = |p: &spivcal::dewarp::SheetPoints| [p.x_mm[0] - o.x_mm[0], p.y_mm[0] - o.y_mm[0]];
            let ([a, b], [c, d]) = (by(&u), by(&v));
            (a * d - b * c).abs()
        });
        let scale = if unit == FieldUnit::RawPixels { 1.0 } else { (sides[0] * sides[1]).powf(0.25) };
        assert!((f.sigma / (sigma_px * scale) - 1.0).abs() < 0.1, "{} {scale}", f.sigma);
        assert!(f.sigma_by_gradient < 0.1, "white noise does not grow with the gradient: {}", f.sigma_by_gradient);
        // n vectors, neighbours correlated by the interpolation: about n / 4 independent ones.
        let z = ratio.map(|r| (r - 1.0) / (0.5 / (n / 4.0)).sqrt());
        assert!(z.iter().all(|z| z.abs() < 5.0) && ratio.iter().all(|r| (r - 1.0).abs() < 0.15), "{ratio:?} {z:?}");
    }
}

/// Planar vectors that state their own standard deviations, part of whose errors both cameras share: the sigmas of u, v, w hold that.
#[test]
fn stated_sigmas_and_what_both_cameras_share_are_in_the_sigmas() {
    for rho in [0.0_f64, 0.45] {
        let (clean, mut random) = ([0, 1].map(|c| dewarped_field(c, None, 0.0, 1)), Random(31));
        let header = "x_mm,y_mm,dx_mm,dy_mm,sigma_dx_mm,sigma_dy_mm\n";
        let mut texts = [header.to_string(), header.to_string()];
        for (a, b) in clean[0].lines().zip(clean[1].lines()).skip(1) {
            let shared = random.normal();
            for (c, line) in [a, b].iter().enumerate() {
                let v: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
                // Depth shows along x; errors differ from place to place and between the axes.
                let sigma = [2e-3 * (1.0 + 0.03 * v[0].abs()), 1e-3 * (1.0 + 0.05 * v[1].abs())];
                let e = [random.normal(), rho.sqrt() * shared + (1.0 - rho).sqrt() * random.normal()];
                let (dx, dy) = (v[2] + sigma[0] * e[0], v[3] + sigma[1] * e[1]);
                texts[c].push_str(&format!("{},{},{dx:.9},{dy:.9},{:.9},{:.9}\n", v[0], v[1], sigma[0], sigma[1]));
            }
        }
        let f = solved([&texts[0], &texts[1]], &options(FieldUnit::Millimetres));
        let n = f.x_mm.len() as f64;
        let mut sums = [0.0; 3];
        for i in 0..f.x_mm.len() {
            let d = Vector3::new(f.u_mm[i], f.v_mm[i], f.w_mm[i]) - flow(f.x_mm[i], f.y_mm[i]);
            (0..3).for_each(|a| sums[a] += (d[a] / f.sigma_mm[a][i]).powi(2));
        }
        let mean = sums.map(|s| s / n);
        let found = f.common_errors.unwrap();
        println!("rho {rho}: found {found:.3}, mean z^2 {mean:.3?}, residuals {:.3}", f.residual_ratio);
        // n independent vectors: the mean square scatters by sqrt(2 / n).
        let z = mean.map(|m| (m - 1.0) / (2.0 / n).sqrt());
        assert!(z.iter().all(|z| z.abs() < 4.0), "{z:?}");
        assert!((found - rho).abs() < 4.0 * (2.0 / n).sqrt() && !f.sigma_estimated, "{found}");
        if rho > 0.0 {
            // One file without them is no half-known field.
            let fields = [&texts[0], &clean[1]].map(|t| PlanarField::new(&parse_field(t, "f.csv").unwrap()).unwrap());
            let m = maps();
            let o = options(FieldUnit::Millimetres);
            let e = reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], &o).unwrap_err();
            assert!(e.to_string().contains("export both alike"), "{e}");
        }
    }
}

/// Still water seen in raw images by windows of `n` x `n` cells of the sensor, one cell apart, each with noise of its own: a standard deviation of 0.1 px per vector.
fn overlapped_field(c: usize, n: usize, seed: u64) -> String {
    let (mut random, step) = (Random(seed), [12.0, 14.0][c]);
    let [columns, rows] = [1000.0, 750.0].map(|length| (length / step) as usize);
    let across = columns + n;
    let mut cells = || -> Vec<f64> { (0..across * (rows + n)).map(|_| 0.1 * random.normal()).collect() };
    let noise = [cells(), cells()];
    let mut text = String::from("x_px,y_px,dx_px,dy_px,sigma_dx_px,sigma_dy_px\n");
    for (i, j) in (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))) {
        let [dx, dy] = noise.each_ref().map(|cells| {
            let window = (0..n * n).map(|k| cells[(j + k / n) * across + i + k % n]);
            window.sum::<f64>() / n as f64
        });
        text.push_str(&format!("{},{},{dx:.9},{dy:.9},0.1,0.1\n", 9.0 + step * i as f64, 7.0 + step * j as f64));
    }
    text
}

/// What neighbouring windows share does not average out between them: standard deviations and covariances hold at any overlap that is stated.
#[test]
fn vectors_of_overlapping_windows_have_true_sigmas() {
    for n in [1, 2, 4] {
        let m = maps();
        let texts = [0, 1].map(|c| overlapped_field(c, n, 60 + 2 * n as u64 + c as u64));
        let solve = |overlap: f64| {
            let fields = texts.each_ref().map(|t| beside(t, overlap));
            reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], &options(FieldUnit::RawPixels))
                .unwrap()
        };
        let f = solve(1.0 - 1.0 / n as f64);
        let (mut z2, mut whole, mut count) = ([0.0; 3], 0.0, 0.0);
        for i in (0..f.x_mm.len()).filter(|i| f.flags[*i] == 0) {
            let d = Vector3::new(f.u_mm[i], f.v_mm[i], f.w_mm[i]);
            let variance = [0, 1, 2].map(|a| f.sigma_mm[a][i].powi(2));
            let [uv, uw, vw] = [0, 1, 2].map(|k| f.covariance_mm2[k][i]);
            let c = nalgebra::Matrix3::new(variance[0], uv, uw, uv, variance[1], vw, uw, vw, variance[2]);
            (0..3).for_each(|a| z2[a] += d[a] * d[a] / variance[a]);
            whole += d.dot(&(c.try_inverse().unwrap() * d)) / 3.0;
            count += 1.0;
        }
        let mean = z2.map(|s| s / count);
        println!(
            "windows of {n} cells: mean z^2 of u v w {mean:.3?}, of all together {:.3}, residuals {:.3} of {count} vectors, correlation {:.3}",
            whole / count,
            f.residual_ratio,
            f.common_errors.unwrap()
        );
        // One in n^2 vectors is independent.
        let scatter = (2.0 / count).sqrt() * n as f64;
        assert!(mean.iter().chain(&[whole / count]).all(|m| (m - 1.0).abs() < 4.0 * scatter), "{mean:?} {scatter}");
        assert!((f.residual_ratio - 1.0).abs() < 4.0 * scatter, "{}", f.residual_ratio);
        if n == 4 {
            // Taken for independent they would be a fifth too small.
            assert!(solve(0.0).residual_ratio > 1.15);
        }
    }
}

#[test]
fn the_calibration_s_covariance_is_that_of_moved_calibrations() {
    // Known: baseline-like scale of the second camera's place along its own axes, sheet and lens exact.
    let mut record = scene::record();
    let sigma = 0.4;
    let name = "right.cam_from_rig.tx_mm";
    record.covariance.names = vec![name.into()];
    record.covariance.matrix = vec![vec![sigma * sigma]];
    let s = &mut record.sheet.as_mut().unwrap().sigma;
    (s.normal_rad, s.distance_mm) = ([0.0; 2], 0.0);
    let texts = [0, 1].map(|c| raw_field(c, false, 0.0, 1, |_| true));
    let perturbed = perturbed_maps(&record).unwrap().unwrap();
    assert_eq!(perturbed.sides.len(), 1);
    let f = solved([&texts[0], &texts[1]], &Options { perturbed: Some(perturbed), ..options(FieldUnit::RawPixels) });
    // As its views tell it.
    record.mapping_uncertainty = Some(scene::mapping(true));
    let perturbed = perturbed_maps(&record).unwrap().unwrap();
    let enlarged = scene::mapping(true).enlarged();
    let told = solved([&texts[0], &texts[1]], &Options { perturbed: Some(perturbed), ..options(FieldUnit::RawPixels) });
    assert_eq!((told.calibration_enlarged, f.calibration_enlarged), (enlarged, [1.0; 3]));
    for a in 0..3 {
        assert!(told.sigma_mm[a].iter().zip(&f.sigma_mm[a]).all(|(x, y)| x.to_bits() == y.to_bits()));
        for (larger, stated) in told.calibration_sigma_mm[a].iter().zip(&f.calibration_sigma_mm[a]) {
            assert!(larger.is_nan() && stated.is_nan() || (larger / stated / enlarged[a] - 1.0).abs() < 1e-12);
        }
    }
    // One number moves all three components together.
    for (k, (a, b)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
        let sigma = |a: usize, i: usize| f.calibration_sigma_mm[a][i];
        let whole = (0..f.x_mm.len()).filter(|i| sigma(a, *i).is_finite());
        assert!(
            whole.clone().count() > 300
                && whole.clone().all(|i| {
                    (f.calibration_covariance_mm2[k][i].abs() - sigma(a, i) * sigma(b, i)).abs()
                        < 1e-9 * sigma(a, i) * sigma(b, i) + 1e-18
                })
        );
    }
    // By hand: the camera moved by one sigma, and the whole field anew.
    let mut moved = scene::record();
    moved.cameras[1].cam_from_rig.translation_mm[0] += sigma;
    let m = [0, 1].map(|c| SheetMap::from_record(&moved, c).unwrap());
    let fields = [0, 1].map(|c| PlanarField::new(&parse_field(&texts[c], "f").unwrap()).unwrap());
    let solve = Options { spacing_mm: Some(f.grid.mm_per_px), ..options(FieldUnit::RawPixels) };
    let g = reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], &solve).unwrap();
    let mut seen = 0;
    for i in (0..f.x_mm.len()).filter(|i| f.calibration_sigma_mm[2][*i].is_finite()) {
        let [c, r] = g.grid.pixel(f.x_mm[i], f.y_mm[i]).map(f64::round);
        let j = (r as usize) * g.grid.width_px + c as usize;
        if c < 0.0
            || r < 0.0
            || c as usize >= g.grid.width_px
            || r as usize >= g.grid.height_px
            || !g.w_mm[j].is_finite()
        {
            continue;
        }
        if (g.x_mm[j] - f.x_mm[i]).hypot(g.y_mm[j] - f.y_mm[i]) < 0.02 {
            let change = (g.w_mm[j] - f.w_mm[i]).abs();
            assert!(
                (change - f.calibration_sigma_mm[2][i]).abs() < 3e-4 + 0.1 * change,
                "{change} {}",
                f.calibration_sigma_mm[2][i]
            );
            seen += 1;
        }
    }
    assert!(seen > 100 || g.grid != f.grid, "{seen}");
    // A number that nothing determines: no sigma is made up.
    record.covariance.matrix = vec![vec![f64::NAN]];
    assert!(perturbed_maps(&record).unwrap().is_none());
}

#[test]
fn a_distance_that_no_field_has_is_refused_with_the_one_that_would_do() {
    let texts = [0, 1].map(|c| raw_field(c, false, 0.0, 1, |_| true));
    let (m, own) = (maps(), solved([&texts[0], &texts[1]], &options(FieldUnit::RawPixels)).grid.mm_per_px);
    let fields = [0, 1].map(|c| PlanarField::new(&parse_field(&texts[c], "f").unwrap()).unwrap());
    let at = |spacing_mm: f64| {
        let o = Options { spacing_mm: Some(spacing_mm), ..options(FieldUnit::RawPixels) };
        reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], &o)
    };
    // Some 10^17 vectors, which no memory holds.
    for (spacing, words) in [(1e-7, "a tenth of the distance"), (1e4, "the shorter side"), (-1.0, "a positive number")]
    {
        let e = at(spacing).unwrap_err().to_string();
        assert!(e.contains(words) && e.contains(&spacing.to_string()), "{e}");
    }
    assert!(at(0.5 * own).unwrap().x_mm.len() > 1000);
}

#[test]
fn missing_vectors_are_flagged_and_the_rest_stays_right() {
    let texts = [raw_field(0, false, 0.0, 1, |_| true), raw_field(1, false, 0.0, 1, |n| n % 2 == 0 || n % 7 == 0)];
    let f = solved([&texts[0], &texts[1]], &options(FieldUnit::RawPixels));
    let (filled, all) = f.filled();
    println!("{filled} of {all}");
    assert!(filled < all);
    for i in 0..all {
        if f.w_mm[i].is_nan() {
            assert!(f.flags[i] & (flag::FIRST_MISSING | flag::SECOND_MISSING) != 0);
        } else {
            assert!((f.w_mm[i] - flow(f.x_mm[i], f.y_mm[i]).z).abs() < 0.01);
        }
    }
}

/// A number that stands for a missing vector in both fields: what has no solution is no good vector.
#[test]
fn fill_values_are_flagged() {
    let filled = |c: usize| -> String {
        let text = raw_field(c, false, 0.0, 1, |_| true);
        let line = |l: &str| {
            let (u, v) = l.split_once(',').map(|(u, rest)| (u, rest.split_once(',').unwrap().0)).unwrap();
            let fill = u.parse::<f64>().is_ok_and(|u| u > 600.0);
            if fill { format!("{u},{v},99999,99999\n") } else { format!("{l}\n") }
        };
        text.lines().map(line).collect()
    };
    let f = solved([&filled(0), &filled(1)], &options(FieldUnit::RawPixels));
    let unsolved = f.flags.iter().filter(|flags| **flags & flag::UNSOLVED != 0).count();
    println!("{unsolved} of {} without a solution", f.flags.len());
    assert!(unsolved > 100);
    for (w, flags) in f.w_mm.iter().zip(&f.flags) {
        assert!(w.is_finite() || *flags != 0, "no vector, flag 0");
    }
}

#[test]
fn the_program_reads_writes_and_refuses() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    std::fs::write(at("c.json"), scene::record().to_json().unwrap()).unwrap();
    let run = |left: &str, right: &str, more: &[&str]| {
        std::fs::write(at("l.csv"), left).unwrap();
        std::fs::write(at("r.csv"), right).unwrap();
        let [c, l, r, o] = ["c.json", "l.csv", "r.csv", "out.csv"].map(at);
        let mut arguments = vec!["reconstruct", &c, &l, &r, "-o", &o];
        arguments.extend(more);
        let output = Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).to_string() + &String::from_utf8_lossy(&output.stdout);
        println!("{}", said.trim_end());
        (output.status.code().unwrap(), said)
    };
    let (left, right) = (raw_field(0, false, 0.05, 1, |_| true), raw_field(1, false, 0.05, 2, |_| true));
    let (code, said) = run(&left, &right, &[]);
    assert!(
        (code == 0 || said.contains("does not determine")) && said.contains("w is positive towards camera \"left\""),
        "{said}"
    );
    // A folder in the place of the file; standard deviations that four decimals do not show.
    std::fs::rename(at("out.csv"), at("kept.csv")).unwrap();
    std::fs::create_dir(at("out.csv")).unwrap();
    let (code, said) = run(&left, &right, &[]);
    assert!(code == 2 && said.contains("this is a folder; name the CSV file to be written, such as"), "{said}");
    std::fs::remove_dir(at("out.csv")).unwrap();
    let (_, said) = run(&left, &right, &["--sigma", "2.86e-5"]);
    assert!(said.contains("sigma of a planar component: 2.860e-5 px (given)"), "{said}");
    std::fs::rename(at("kept.csv"), at("out.csv")).unwrap();
    let csv = std::fs::read_to_string(at("out.csv")).unwrap();
    assert!(csv.starts_with("x_mm,y_mm,u_mm,v_mm,w_mm,sigma_u_mm") && csv.lines().count() > 500);
    std::fs::remove_file(at("out.csv")).unwrap();

    let half = raw_field(1, false, 0.05, 2, |n| n % 51 < 20);
    let (code, said) = run(&left, &half, &["--no-calibration-sigma"]);
    assert!(
        code == 1
            && said.contains("points between the vectors of both cameras have no vector")
            && said.contains("check masks"),
        "{said}"
    );
    let refused = |left: &str, right: &str, more: &[&str], code: i32, words: &str| {
        let _ = std::fs::remove_file(at("out.csv"));
        let (got, said) = run(left, right, more);
        assert!(got == code && said.contains(words), "{got}: {said}");
        assert!(!std::path::Path::new(&at("out.csv")).exists());
    };
    let none = raw_field(1, false, 0.05, 2, |_| false);
    refused(&left, &none, &[], 3, "\"right\" has 0 of");
    refused(&left, &right[..right.len() / 2 - 3], &[], 2, "cut short");
    refused(&left.replace("x_px,y_px,dx_px,dy_px", "x,y,u,v"), &right, &[], 2, "--unit px");
    // Wrong grids: of a larger image, of no regular positions, of one row, of the other camera's unit.
    refused(&left.replace("\n8,6,", "\n2008,6,"), &right, &[], 2, "another");
    refused(&left.replace("\n8,6,", "\n13,6,"), &right, &[], 2, "do not form a regular grid");
    let row: String =
        left.lines().filter(|l| l.contains(",6,") || l.starts_with('x')).map(|l| format!("{l}\n")).collect();
    refused(&row, &right, &[], 2, "at least two rows and two columns");
    refused(&left, &right.replace("x_px,y_px,dx_px,dy_px", "x_mm,y_mm,dx_mm,dy_mm"), &[], 2, "export both alike");
    refused(&left.replace("\n8,6,", "\n8,six,"), &right, &[], 2, "\"six\" is not a number");
    refused(&left, &right, &["--unit", "mm"], 2, "its header says px, but --unit says mm");
    let mm = |field: &str| field.replace("x_px,y_px,dx_px,dy_px", "x_mm,y_mm,dx_mm,dy_mm");
    refused(&mm(&left), &mm(&right), &["--unit", "px"], 2, "its header says mm, but --unit says px");
    let sigmas = |name: &str| left.replacen("dy_px", &format!("dy_px,{name}"), 1);
    refused(&sigmas("sigma_dx_px"), &right, &[], 2, "without sigma_dy_px");
    refused(&sigmas("sigma_dx_mm,sigma_dy_mm"), &right, &[], 2, "expected sigma_dx_px, sigma_dy_px");
    refused(&left, &right, &["--unit", "dewarped"], 2, "--dewarped dewarp.json");
    refused(&left, &right, &["--sigma", "-1"], 2, "a positive number");
    refused(&right, &left, &["--no-calibration-sigma"], 2, "with the two fields exchanged");
    refused("", &right, &[], 2, "empty");
    for spacing in ["-1", "0", "4000"] {
        refused(&left, &right, &["--spacing-mm", spacing], 2, "distance of the vectors");
    }
}

/// Images dewarped with one calibration are no measure with another; fields whose names say the other camera are told.
#[test]
fn fields_of_another_calibration_or_camera_are_told() {
    let scratch = tempfile::tempdir().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_string();
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).to_string();
        println!("{}", said.trim_end());
        (output.status.code().unwrap(), said)
    };
    let record = scene::record();
    std::fs::write(at("c.json"), record.to_json().unwrap()).unwrap();
    let mut other = record.clone();
    let sheet = other.sheet.as_mut().unwrap();
    let pose = &mut sheet.rig_from_sheet;
    (0..3).for_each(|a| pose.translation_mm[a] += 0.5 * pose.rotation[a][0]);
    std::fs::write(at("other.json"), other.to_json().unwrap()).unwrap();
    let pixels = spivcal::image::Pixels::U8(vec![7; 1024 * 768]);
    let image = spivcal::image::GrayImage::new(pixels, 1024, 768).unwrap();
    std::fs::write(at("a_left.png"), spivcal::pipeline::png_bytes(&image).unwrap()).unwrap();
    let extent = ["--extent-mm", "-20,-15,20,15"];
    for (z, to) in [("0", "sheet"), ("1.5", "before")] {
        let (code, said) =
            run(&[&["dewarp", &at("c.json"), &at("a_left.png"), "-o", &at(to), "--z-mm", z], &extent[..]].concat());
        assert!(code < 2, "{said}");
    }
    let text = std::fs::read_to_string(at("sheet/dewarp.json")).unwrap();
    let grid: SheetGrid =
        serde_json::from_value(serde_json::from_str::<serde_json::Value>(&text).unwrap()["grid"].clone()).unwrap();
    for c in 0..2 {
        std::fs::write(at(["l_left.csv", "r_right.csv"][c]), dewarped_field(c, Some(&grid), 0.0, 1)).unwrap();
    }
    let reconstruct = |calibration: &str, fields: [&str; 2], dewarped: &str| {
        let [c, l, r, d, o] = [calibration, fields[0], fields[1], dewarped, "out.csv"].map(at);
        run(&["reconstruct", &c, &l, &r, "--unit", "dewarped", "--dewarped", &d, "--no-calibration-sigma", "-o", &o])
    };
    let fields = ["l_left.csv", "r_right.csv"];
    let (code, said) = reconstruct("c.json", fields, "sheet/dewarp.json");
    assert_eq!(code, 0, "{said}");
    let (code, said) = reconstruct("other.json", fields, "sheet/dewarp.json");
    assert!(code == 2 && said.contains("another calibration") && said.contains("dewarp them again"), "{said}");
    let (code, said) = reconstruct("c.json", fields, "before/dewarp.json");
    assert!(code == 2 && said.contains("z = 1.5 mm"), "{said}");
    // A dewarp.json that does not say which calibration it is of.
    let mut silent: serde_json::Value = serde_json::from_str(&text).unwrap();
    silent["grid_in_images_px"] = serde_json::json!({});
    std::fs::write(at("silent.json"), silent.to_string()).unwrap();
    let (code, said) = reconstruct("c.json", fields, "silent.json");
    assert!(code == 2 && said.contains("cannot be told"), "{said}");
    let (code, said) = reconstruct("c.json", [fields[1], fields[0]], "sheet/dewarp.json");
    assert!(
        code == 1 && said.contains("stands for camera \"left\", but its name is that of camera \"right\""),
        "{said}"
    );
}

/// Positions that count from a corner of the image, as OpenPIV scales them, are not those of the sheet frame: told, not taken for vectors elsewhere.
#[test]
fn positions_that_no_camera_sees_are_no_vectors() {
    let moved = |text: &str, by: [f64; 2]| -> String {
        let row = |line: &str| {
            let cells: Vec<f64> = line.split(',').map(|c| c.parse().unwrap()).collect();
            format!("{},{},{},{}\n", cells[0] + by[0], cells[1] + by[1], cells[2], cells[3])
        };
        text.lines().enumerate().map(|(i, l)| if i == 0 { format!("{l}\n") } else { row(l) }).collect()
    };
    let texts = [0, 1].map(|c| dewarped_field(c, None, 0.0, 9));
    let solve = |by: [f64; 2]| {
        let fields = texts.each_ref().map(|t| PlanarField::new(&parse_field(&moved(t, by), "f.csv").unwrap()).unwrap());
        let m = maps();
        let unit = options(FieldUnit::Millimetres);
        reconstruct([&m[0], &m[1]], [&fields[0], &fields[1]], ["left", "right"], &unit)
    };
    assert!(solve([0.0; 2]).unwrap().filled().0 > 700);
    let said = solve([38.0, 21.0]).unwrap_err().to_string();
    assert!(said.contains("does not see") && said.contains("dewarp.json"), "{said}");
    // Five of 33 columns beyond what one of the cameras sees.
    let edge = |map: &SheetMap| {
        let x = map.sheet_of_pixel(&[0.0, 1023.0], &[383.5; 2], &[0.0; 2]).unwrap().x_mm;
        x[0].max(x[1])
    };
    let [left, right] = maps().each_ref().map(edge);
    let some = solve([left.min(right) - 16.0 + 5.0, 0.0]).unwrap();
    let (filled, all) = some.filled();
    assert!(filled > all / 2 && filled < all, "{filled} of {all}");
}
