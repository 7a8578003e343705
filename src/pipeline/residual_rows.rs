//! Residuals of every observation as table rows and as arrows on the images, and how well each image fits.

use super::calibrate::Solved;
use super::images::SeenImage;
use crate::bitangent::bitangents;
use crate::bundle::residuals;
use crate::detect::Disc;
use crate::error::{Error, Result};
use crate::record::{FeatureKind, Residual, ResidualTable};
use crate::report::{Label, OverlayShapes, Polyline, RejectedMark};
use crate::target::DotId;

/// How well one image fits.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct ImageFit {
    /// Sum of squared lengths of the discs' shifts, px^2.
    pub(super) shift_squares: f64,
    /// Discs.
    pub(super) discs: usize,
    /// Sum of squared distances of edge points, px^2.
    pub(super) edge_squares: f64,
    /// Edge points.
    pub(super) edges: usize,
    /// Discs set aside.
    pub(super) outliers: usize,
}

impl ImageFit {
    pub(super) fn plus(self, o: &Self) -> Self {
        Self {
            shift_squares: self.shift_squares + o.shift_squares,
            discs: self.discs + o.discs,
            edge_squares: self.edge_squares + o.edge_squares,
            edges: self.edges + o.edges,
            outliers: self.outliers + o.outliers,
        }
    }
    /// Root mean square reprojection error of the discs (both coordinates together), px.
    pub(super) fn rms_px(&self) -> f64 {
        (self.shift_squares / self.discs.max(1) as f64).sqrt()
    }
    /// Root mean square distance of edge points, px.
    pub(super) fn edge_rms_px(&self) -> f64 {
        (self.edge_squares / self.edges.max(1) as f64).sqrt()
    }
}

/// Rows, overlays and fits of all images, in their order.
pub(super) fn residual_rows(s: &Solved) -> Result<(ResidualTable, Vec<OverlayShapes>, Vec<ImageFit>)> {
    let mut table = ResidualTable::default();
    let (mut overlays, mut fits) = (vec![], vec![]);
    for (k, image) in s.images.iter().enumerate() {
        let labels: Vec<DotId> = s.built.problem.model.images[k].discs.iter().map(|d| s.built.labels[d.disc]).collect();
        let mut shapes = found_shapes(image, &labels);
        let mut fit = ImageFit::default();
        // Outliers too are shown where they would have been expected.
        let mut all = s.contours.images[k].clone();
        all.discs = s.built.problem.model.images[k].discs.clone();
        let used = |disc: usize| s.contours.images[k].discs.iter().any(|d| d.disc == disc);
        let residuals = residuals(s.contours, &s.adjustment.state, &all)
            .ok_or_else(|| Error::Bug(format!("{}: a disc has no image after the adjustment", image.name)))?;
        for (seen, r) in all.discs.iter().zip(&residuals.discs) {
            let label = s.built.labels[r.disc];
            let outlier = (!used(r.disc)).then_some("the disc lies off the target");
            let base = Residual {
                view: image.view,
                camera: image.camera,
                disc: label,
                kind: FeatureKind::DiscCentre,
                u_px: r.center_px.x + r.shift_px.x,
                v_px: r.center_px.y + r.shift_px.y,
                du_px: r.shift_px.x,
                dv_px: r.shift_px.y,
                normal_px: f64::NAN,
                sigma_px: f64::NAN,
                weight: if outlier.is_some() { 0.0 } else { 1.0 },
            };
            table.push(&base, outlier);
            shapes.marks.push([base.u_px, base.v_px], [base.du_px, base.dv_px], base.kind, outlier.is_some());
            let e = &r.edges;
            let mut predicted = Polyline { closed: true, ..Polyline::default() };
            for i in 0..e.distance_px.len() {
                let (du, dv) = (e.distance_px[i] * e.normal_u[i], e.distance_px[i] * e.normal_v[i]);
                let (u, v) = (seen.edge.u_px[i], seen.edge.v_px[i]);
                let sigma_px = seen.edge.sigma_px[i] * all.sigma_scale;
                let row = Residual {
                    kind: FeatureKind::Edge,
                    u_px: u,
                    v_px: v,
                    du_px: du,
                    dv_px: dv,
                    normal_px: e.distance_px[i],
                    sigma_px,
                    weight: if outlier.is_some() { 0.0 } else { s.contours.loss.weight(e.distance_px[i] / sigma_px) },
                    ..base
                };
                table.push(&row, outlier);
                predicted.u_px.push(u - du);
                predicted.v_px.push(v - dv);
            }
            shapes.predicted.extend(predicted.split_at_gaps());
            if outlier.is_some() {
                fit.outliers += 1;
                continue;
            }
            fit.shift_squares += r.shift_px.norm_squared();
            fit.discs += 1;
            fit.edge_squares += e.distance_px.iter().map(|d| d * d).sum::<f64>();
            fit.edges += e.distance_px.len();
        }
        overlays.push(shapes);
        fits.push(fit);
    }
    Ok((table, overlays, fits))
}

/// What was found in an image, before any adjustment; one label for each of its discs.
pub(super) fn found_shapes(image: &SeenImage, labels: &[DotId]) -> OverlayShapes {
    let mut shapes = OverlayShapes::default();
    for (found, label) in image.discs.iter().zip(labels) {
        let disc = &image.detection.discs[found.disc];
        shapes.push_disc(disc);
        let (e, text) = (&disc.ellipse, label_text(*label));
        shapes.labels.push(Label { at_px: [e.center_px.u_px, e.center_px.v_px], reach_px: e.semi_major_px, text });
    }
    if let [a, b] = image.discs.as_slice() {
        tangent_lines(&image.detection.discs[a.disc], &image.detection.discs[b.disc], &mut shapes);
    }
    for r in &image.detection.rejections {
        let at_px = [r.center_px.u_px, r.center_px.v_px];
        shapes.rejected.push(RejectedMark { at_px, radius_px: r.radius_px, reason: r.reason.kind().into() });
    }
    for e in image.left_over.iter().map(|i| &image.detection.discs[*i].ellipse) {
        let (at_px, radius_px) = ([e.center_px.u_px, e.center_px.v_px], e.mean_radius_px());
        shapes.rejected.push(RejectedMark { at_px, radius_px, reason: "not in the pattern".into() });
    }
    shapes
}

fn label_text(id: DotId) -> String {
    if id.level == 0 { format!("{},{}", id.column, id.row) } else { format!("{},{}b", id.column, id.row) }
}

/// The four common tangents between their tangency points, and the points.
fn tangent_lines(a: &Disc, b: &Disc, shapes: &mut OverlayShapes) {
    let Ok(t) = bitangents(&a.ellipse, &b.ellipse) else { return };
    for line in 0..4 {
        if let (Some(p), Some(q)) = (t.point(2 * line), t.point(2 * line + 1)) {
            shapes.lines.push(Polyline { u_px: vec![p.x, q.x], v_px: vec![p.y, q.y], closed: false });
            for point in [p, q] {
                shapes.marks.push([point.x, point.y], [f64::NAN; 2], FeatureKind::Point, false);
            }
        }
    }
}
