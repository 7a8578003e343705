//! The renderer against brute force, against exact areas and moments, and against projected circles.

use super::*;
use crate::simulate::Scene;

/// A camera and a pair of discs; `lens` goes into the camera, lengths in mm.
fn scene(lens: &str, aim: &str, radii: [f64; 2], spacing: f64, rotation: [f64; 3]) -> Scene {
    let text = format!(
        "[[camera]]\nname = 'a'\nimage_size_px = [300, 220]\n{lens}\naim = {{ {aim} }}\n\
         [target]\nkind = 'two-discs'\npolarity = 'bright'\nradii_mm = {radii:?}\nspacing_mm = {spacing:?}\n\
         [[view]]\nrotation_deg = {rotation:?}\n"
    );
    Scene::parse(&text, "test").unwrap()
}

fn paper() -> Scene {
    let lens = "pixel_pitch_mm = 0.00625\nfocal_length_mm = 50.0\nscheimpflug = true\nk = [-0.2, 0.0, 0.0]";
    scene(lens, "distance_mm = 500.0, viewing_angle_deg = -45.0", [3.5, 3.0], 8.0, [10.0, -12.0, 20.0])
}

/// A wide lens of strong distortion with a large tilt: everything bends as much as it ever will.
fn wild() -> Scene {
    let lens = "f_px = 260.0\nalpha_deg = 12.0\nbeta_deg = -20.0\nk = [-0.25, 0.05, 0.0]\naspect = 1.07";
    scene(
        lens,
        "distance_mm = 100.0, viewing_angle_deg = 35.0, elevation_deg = 10.0",
        [13.0, 9.0],
        25.0,
        [5.0, 3.0, -30.0],
    )
}

/// Dots of a few pixels, seen obliquely.
fn tiny() -> Scene {
    let lens = "f_px = 800.0\nbeta_deg = 9.0";
    scene(lens, "distance_mm = 400.0, viewing_angle_deg = 60.0", [3.0, 2.0], 14.0, [0.0, 0.0, 45.0])
}

fn figure(scene: &Scene) -> Figure<'_> {
    let (camera, view) = (&scene.setup.cameras[0], &scene.setup.views[0]);
    let cam_from_target = camera.cam_from_bench * view.bench_from_target;
    Figure { camera, cam_from_target, features: &view.pattern.features }
}

fn plain(f: &Figure, sigma_px: f64) -> Vec<f64> {
    render(f, sigma_px, &|_| 0.0, &|_| 1.0)
}

/// 1 where the ray of `q` meets a disc: the equation `t + R (x, y, 0) = s ray` solved as it stands.
fn indicator(f: &Figure, q: Vector2<f64>) -> f64 {
    let Ok(xy) = f.camera.camera.ideal_of_pixel(&q) else { return 0.0 };
    let r = &f.cam_from_target.rotation;
    let m = nalgebra::Matrix3::from_columns(&[
        r.column(0).into_owned(),
        r.column(1).into_owned(),
        -Vector3::new(xy.x, xy.y, 1.0),
    ]);
    let s = m.lu().solve(&-f.cam_from_target.translation_mm).unwrap();
    let inside = |d: &Feature| (s.xy() - d.center_mm.xy()).norm() <= d.outline.radius_mm().unwrap();
    f64::from(u8::from(s.z > 0.0 && f.features.iter().any(inside)))
}

/// Pixels of a patch by point samples, `n` x `n` to the pixel, weighted with Gaussian times box.
fn brute_force(f: &Figure, corner: [usize; 2], size: usize, sigma_px: f64, n: usize) -> Vec<f64> {
    let halo = (6.0 * sigma_px).ceil() as usize;
    let wide = (size + 2 * halo) * n;
    let at = |i: usize| (i as f64 + 0.5) / n as f64 - 0.5 - halo as f64;
    let weight = |distance: f64| {
        if sigma_px == 0.0 {
            return f64::from(u8::from(distance.abs() < 0.5)) / n as f64;
        }
        let steps = 200;
        let gauss =
            |k: i32| (-0.5 * ((distance + (f64::from(k) + 0.5) / f64::from(steps) - 0.5) / sigma_px).powi(2)).exp();
        (0..steps).map(gauss).sum::<f64>() / f64::from(steps) / (sigma_px * std::f64::consts::TAU.sqrt() * n as f64)
    };
    let weights: Vec<Vec<f64>> = (0..size).map(|p| (0..wide).map(|i| weight(at(i) - p as f64)).collect()).collect();
    let mut narrow = vec![0.0; wide * size];
    for y in 0..wide {
        let sample = |x: usize| indicator(f, Vector2::new(corner[0] as f64 + at(x), corner[1] as f64 + at(y)));
        let row: Vec<f64> = (0..wide).map(sample).collect();
        for p in 0..size {
            narrow[y * size + p] = weights[p].iter().zip(&row).map(|(w, r)| w * r).sum();
        }
    }
    let pixel = |i: usize| (0..wide).map(|y| weights[i / size][y] * narrow[y * size + i % size]).sum();
    (0..size * size).map(pixel).collect()
}

/// A rim point of a disc, px.
fn rim_point(f: &Figure, disc: usize, turn: f64) -> Vector2<f64> {
    let rim = rim_px(f.camera, &f.cam_from_target, &f.features[disc], 1000);
    rim[(turn * 1000.0) as usize]
}

#[test]
fn agrees_with_brute_force_within_two_thousandths_of_the_contrast() {
    for (name, scene) in [("paper", paper()), ("wild", wild()), ("tiny", tiny())] {
        let f = figure(&scene);
        for (disc, turn, sigma, n) in [(0, 0.0, 0.7, 24), (1, 0.37, 1.1, 24), (0, 0.6, 0.15, 48), (1, 0.85, 0.0, 96)] {
            let image = plain(&f, sigma);
            let size = if sigma < 0.5 { 5 } else { 8 };
            let at = rim_point(&f, disc, turn);
            let corner = [at.x as usize - size / 2, at.y as usize - size / 2];
            let want = brute_force(&f, corner, size, sigma, n);
            let got = |i: usize| image[(corner[1] + i / size) * 300 + corner[0] + i % size];
            let worst = (0..size * size).map(|i| (got(i) - want[i]).abs()).fold(0.0, f64::max);
            let seen = want.iter().any(|&w| w > 0.3) && want.iter().any(|&w| w < 0.7);
            println!("{name} sigma {sigma}: {worst:.1e}");
            assert!(seen && worst < 0.002, "{name} sigma {sigma}: {worst}");
        }
    }
}

/// Area, centroid and central second moments of a polygon.
fn polygon_moments(rim: &[Vector2<f64>]) -> (f64, Vector2<f64>, [f64; 3]) {
    let origin = rim[0];
    let (mut area, mut first, mut second) = (0.0, Vector2::zeros(), [0.0; 3]);
    for i in 0..rim.len() {
        let (a, b) = (rim[i] - origin, rim[(i + 1) % rim.len()] - origin);
        let w = a.x * b.y - a.y * b.x;
        area += w / 2.0;
        first += (a + b) * (w / 6.0);
        second[0] += w / 12.0 * (a.x * a.x + a.x * b.x + b.x * b.x);
        second[1] += w / 24.0 * (a.x * b.y + 2.0 * a.x * a.y + 2.0 * b.x * b.y + b.x * a.y);
        second[2] += w / 12.0 * (a.y * a.y + a.y * b.y + b.y * b.y);
    }
    let c = first / area;
    let central = [second[0] / area - c.x * c.x, second[1] / area - c.x * c.y, second[2] / area - c.y * c.y];
    (area.abs(), c + origin, central)
}

#[test]
fn area_centroid_and_moments_are_those_of_the_projected_circle() {
    // A bias of the edge by 0.001 px would change the area by 0.001 times the circumference.
    // In the wild camera the lens bends within a pixel by (6 * 0.25 * 0.5 + 0.36) / (8 * 260) = 5e-4 px.
    for (name, mut scene, limit_px) in [("paper", paper(), 1e-4), ("wild", wild(), 6e-4), ("tiny", tiny(), 3e-4)] {
        for disc in 0..2 {
            let features = scene.setup.views[0].pattern.features.clone();
            scene.setup.views[0].pattern.features = vec![features[disc].clone()];
            let f = figure(&scene);
            let rim = rim_px(f.camera, &f.cam_from_target, &f.features[0], 100_000);
            let length: f64 = (0..rim.len()).map(|i| (rim[i] - rim[(i + 1) % rim.len()]).norm()).sum();
            let (area, center, moments) = polygon_moments(&rim);
            for sigma in [0.0, 0.8] {
                let image = plain(&f, sigma);
                let sum: f64 = image.iter().sum();
                let place = |i: usize| Vector2::new((i % 300) as f64, (i / 300) as f64);
                let mean = (0..image.len()).map(|i| place(i) * image[i]).sum::<Vector2<f64>>() / sum;
                let moment = |g: &dyn Fn(Vector2<f64>) -> f64| {
                    (0..image.len()).map(|i| image[i] * g(place(i) - mean)).sum::<f64>() / sum
                };
                let blur = sigma * sigma + 1.0 / 12.0;
                let got = [moment(&|d| d.x * d.x) - blur, moment(&|d| d.x * d.y), moment(&|d| d.y * d.y) - blur];
                let bias_px = (sum - area) / length;
                let gap_px = (mean - center).norm();
                // The half axis of a disc is twice the root of its second moment.
                let axes_px =
                    (0..3).map(|i| (got[i] - moments[i]).abs()).fold(0.0, f64::max) / moments[0].max(moments[2]).sqrt();
                println!(
                    "{name} disc {disc} sigma {sigma}: edge {bias_px:.1e} centre {gap_px:.1e} axes {axes_px:.1e} px"
                );
                // Without blur pixels alias the image and so its moments; its area stays exact.
                let aliased = sigma == 0.0;
                assert!(bias_px.abs() < limit_px, "{name} {disc} {sigma}");
                assert!(aliased || (gap_px < limit_px && axes_px < limit_px), "{name} {disc} {sigma}");
            }
            scene.setup.views[0].pattern.features = features;
        }
    }
}

/// Band-limited interpolation with a Blackman window of 16 pixels.
fn interpolate(image: &[f64], width: usize, q: &Vector2<f64>) -> f64 {
    let tap = |x: f64| {
        let t = std::f64::consts::PI * x;
        let sinc = if x == 0.0 { 1.0 } else { t.sin() / t };
        sinc * (0.42 + 0.5 * (t / 8.0).cos() + 0.08 * (t / 4.0).cos())
    };
    let (u, v) = (q.x.floor() as usize, q.y.floor() as usize);
    let mut sum = 0.0;
    for y in v - 7..=v + 8 {
        for x in u - 7..=u + 8 {
            sum += image[y * width + x] * tap(q.x - x as f64) * tap(q.y - y as f64);
        }
    }
    sum
}

#[test]
fn middle_grey_is_where_the_projected_circle_is_less_the_shift_of_its_curvature() {
    let scene = paper();
    let f = figure(&scene);
    let sigma: f64 = 1.1;
    let image = plain(&f, sigma);
    let blur2 = sigma * sigma + 1.0 / 12.0;
    for disc in 0..2 {
        let n = 4000;
        let rim = rim_px(f.camera, &f.cam_from_target, &f.features[disc], n);
        let mut worst: f64 = 0.0;
        for i in (0..n).step_by(40) {
            let (a, p, b) = (rim[(i + n - 20) % n], rim[i], rim[(i + 20) % n]);
            let (step, bend) = (0.5 * (b - a), a + b - 2.0 * p);
            let curvature = (step.x * bend.y - step.y * bend.x).abs() / step.norm().powi(3);
            let inwards = Vector2::new(-step.y, step.x).normalize();
            let inwards = if inwards.dot(&bend) > 0.0 { inwards } else { -inwards };
            // A blurred disc is half bright where the distance inwards is blur^2 / (2 R) (method, section 3).
            let at = p + inwards * (0.5 * blur2 * curvature);
            let slope = 1.0 / (std::f64::consts::TAU * blur2).sqrt();
            worst = worst.max(((interpolate(&image, 300, &at) - 0.5) / slope).abs());
        }
        assert!(worst < 0.003, "disc {disc}: {worst} px");
    }
}

#[test]
fn part_of_a_square_beyond_a_line_is_exact() {
    // The angle 0 with a sampled count would sit on the samples: d is off their grid.
    for (d, angle) in [(0.01, 0.0), (-0.2, 0.3), (0.31, 0.785), (0.45, 1.2), (-0.6, 2.5), (0.69, 0.785)] {
        let (ny, nx) = f64::sin_cos(angle);
        let n = 1000;
        let at = |i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        let count = (0..n * n).filter(|i| nx * at(i % n) + ny * at(i / n) + d > 0.0).count();
        let want = count as f64 / (n * n) as f64;
        assert!((covered(d, nx, ny, 1.0) - want).abs() < 1e-3, "{d} {angle}");
    }
}

#[test]
fn point_spread_keeps_the_light_and_has_its_width() {
    for sigma in [0.0, 0.1, 0.3, 0.8, 3.0] {
        let k = Kernel::new(sigma);
        let x = |i: usize| (i as f64 - k.reach as f64 + 0.5) / k.cells as f64 - 0.5;
        let sum: f64 = k.weights.iter().sum();
        let variance: f64 = (0..k.weights.len()).map(|i| k.weights[i] * x(i) * x(i)).sum();
        // The cell's own box is not in the weights: it is in the averages that they weigh.
        let want = sigma * sigma + (1.0 - 1.0 / (k.cells * k.cells) as f64) / 12.0;
        assert!((sum - 1.0).abs() < 1e-12 && (variance - want).abs() < 1e-6, "{sigma}: {sum} {variance} {want}");
    }
}
