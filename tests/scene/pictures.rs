//! Images of the scene's discs with what a detector and an adjustment would find in them.

use super::{Eye, VIEWS, eyes, rig_from_target};
use nalgebra::{Vector2, Vector3};
use spivcal::image::{GrayImage, Pixels};
use spivcal::record::{FeatureKind, Residual, ResidualTable};
use spivcal::report::{Label, OverlayShapes, Polyline, RejectedMark};
use spivcal::target::DotId;

/// Centre x and radius of the two discs in the target plane, mm.
pub const DISCS: [(f64, f64); 2] = [(-13.0, 12.50431), (13.0, 9.99812)];
const WIDTH: usize = 1024;
const HEIGHT: usize = 768;

/// A small generator with a stated sequence (SplitMix64), so that pictures never change.
pub struct Noise(pub u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
    /// About normal, mean 0, sigma 1.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn outline(eye: &Eye, view: usize, disc: usize, n: usize) -> Vec<[f64; 2]> {
    let (x, r) = DISCS[disc];
    let pose = rig_from_target(view);
    (0..n)
        .map(|i| (std::f64::consts::TAU * i as f64 / n as f64).sin_cos())
        .map(|(s, c)| eye.project(&pose.apply(&Vector3::new(x + r * c, r * s, 0.0))))
        .collect()
}

/// Bright rims on uneven smoke: what two bubbles in a laser sheet look like.
pub fn image(camera: usize, view: usize) -> GrayImage {
    let eye = &eyes()[camera];
    let mut noise = Noise(7 + (2 * view + camera) as u64);
    let mut grey: Vec<f64> = (0..WIDTH * HEIGHT)
        .map(|i| {
            let (u, v) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            900.0 + 0.5 * u + 160.0 * (v / 90.0).sin() + 35.0 * noise.normal()
        })
        .collect();
    for disc in 0..2 {
        fill(&mut grey, &outline(eye, view, disc, 720));
    }
    let samples = grey.into_iter().map(|g| g.clamp(0.0, 4095.0) as u16).collect();
    GrayImage::new(Pixels::U16(samples), WIDTH, HEIGHT).unwrap()
}

/// Brightens the inside of a convex outline, with a soft edge.
fn fill(grey: &mut [f64], outline: &[[f64; 2]]) {
    let edge = |i: usize| [outline[i], outline[(i + 1) % outline.len()]];
    let limit = |k: usize| outline.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[k]), h.max(p[k])));
    let ((u0, u1), (v0, v1)) = (limit(0), limit(1));
    for v in v0.max(0.0) as usize..(v1.min(HEIGHT as f64 - 1.0) as usize + 1) {
        // The chord of this row; exact enough for a picture.
        let crossings = (0..outline.len()).map(edge).filter_map(|[a, b]| {
            let t = (v as f64 - a[1]) / (b[1] - a[1]);
            (0.0..1.0).contains(&t).then(|| a[0] + t * (b[0] - a[0]))
        });
        let (left, right) = crossings.fold((f64::MAX, f64::MIN), |(l, h), u| (l.min(u), h.max(u)));
        for u in (u0.max(0.0) as usize)..(u1.min(WIDTH as f64 - 1.0) as usize + 1) {
            let inside = (u as f64 - left).min(right - u as f64);
            grey[v * WIDTH + u] += 1500.0 / (1.0 + (-inside / 0.8).exp());
        }
    }
}

/// Residuals of all views and cameras; a few far-off points in view 3 of the right camera.
pub fn residuals() -> ResidualTable {
    let mut table = ResidualTable::default();
    let mut noise = Noise(99);
    for view in 0..VIEWS {
        for (camera, eye) in eyes().iter().enumerate() {
            for disc in 0..2 {
                let points = outline(eye, view, disc, 300);
                let centre: Vector2<f64> = points.iter().map(|p| Vector2::from(*p)).sum::<Vector2<f64>>() / 300.0;
                let shift = Vector2::new(noise.normal(), noise.normal()) * 0.004;
                for (i, p) in points.iter().enumerate() {
                    let n = (Vector2::from(*p) - centre).normalize();
                    let far = view == 3 && camera == 1 && disc == 1 && (200..204).contains(&i);
                    let r = 0.024 * noise.normal() + n.dot(&shift) + if far { 0.6 } else { 0.0 };
                    let row = Residual {
                        view,
                        camera,
                        disc: DotId { column: disc as i32, row: 0, level: 0 },
                        kind: FeatureKind::Edge,
                        u_px: p[0] + r * n.x,
                        v_px: p[1] + r * n.y,
                        du_px: r * n.x,
                        dv_px: r * n.y,
                        normal_px: r,
                        sigma_px: 0.025,
                        weight: if far { 0.0 } else { 1.0 },
                    };
                    table.push(&row, far.then_some("residual above 5 sigmas"));
                }
            }
        }
    }
    table
}

/// What is drawn on one image.
pub fn shapes(camera: usize, view: usize, table: &ResidualTable) -> OverlayShapes {
    let eye = &eyes()[camera];
    let mut shapes = OverlayShapes::default();
    for disc in 0..2 {
        let line = |n| {
            let points = outline(eye, view, disc, n);
            let (u_px, v_px) = points.iter().map(|p| (p[0], p[1])).unzip();
            Polyline { u_px, v_px, closed: true }
        };
        shapes.contours.push(line(300));
        shapes.predicted.push(line(180));
        let centre = eye.project(&rig_from_target(view).apply(&Vector3::new(DISCS[disc].0, 0.0, 0.0)));
        shapes.marks.push(centre, [f64::NAN; 2], FeatureKind::DiscCentre, false);
        shapes.labels.push(Label { at_px: centre, reach_px: 10.0, text: format!("{disc},0") });
    }
    for i in 0..table.len() {
        let row = table.row(i).unwrap();
        if (row.view, row.camera) == (view, camera) {
            shapes.marks.push([row.u_px, row.v_px], [row.du_px, row.dv_px], row.kind, table.outlier(i).is_some());
        }
    }
    tangents(&mut shapes, eye, view);
    let reason = "not elliptical".to_string();
    shapes.rejected.push(RejectedMark { at_px: [840.0, 60.0], radius_px: 14.0, reason });
    shapes
}

/// The external tangents of two circles are tangents of their images, lens aside.
fn tangents(shapes: &mut OverlayShapes, eye: &Eye, view: usize) {
    let pose = rig_from_target(view);
    let ([x0, x1], [r0, r1]) = (DISCS.map(|d| d.0), DISCS.map(|d| d.1));
    let c = (r0 - r1) / (x1 - x0);
    let s = (1.0 - c * c).sqrt();
    for side in [1.0, -1.0] {
        let ends =
            [(x0, r0), (x1, r1)].map(|(x, r)| eye.project(&pose.apply(&Vector3::new(x + r * c, side * r * s, 0.0))));
        let (u_px, v_px) = ends.iter().map(|p| (p[0], p[1])).unzip();
        shapes.lines.push(Polyline { u_px, v_px, closed: false });
        for end in ends {
            shapes.marks.push(end, [f64::NAN; 2], FeatureKind::Point, false);
        }
    }
}
