//! The pixels around one ellipse, collected once and reused while the edge model settles.

use crate::conic::{Ellipse, Frame};
use crate::image::GrayView;

/// Pixels of the band around one ellipse, structure of arrays, reused from disc to disc.
#[derive(Debug, Default)]
pub(crate) struct Band {
    pub(crate) u: Vec<f64>,
    pub(crate) v: Vec<f64>,
    pub(crate) grey: Vec<f64>,
    /// Eccentric angle of the foot point when collected, rad.
    pub(crate) angle: Vec<f64>,
    /// Its cosine and sine when collected.
    pub(crate) cos: Vec<f64>,
    pub(crate) sin: Vec<f64>,
    /// The same, following the ellipse; start of the next search for the foot point.
    pub(crate) foot_cos: Vec<f64>,
    pub(crate) foot_sin: Vec<f64>,
    /// So far off that the edge does not reach it: its distance when collected is good enough.
    pub(crate) far: Vec<bool>,
    /// Whether the pixel counts.
    pub(crate) keep: Vec<bool>,
    /// Data minus model, grey levels.
    pub(crate) residual: Vec<f64>,
    /// Signed distance from the ellipse, px.
    pub(crate) distance: Vec<f64>,
    /// P.
    pub(crate) inside: Vec<f64>,
    /// d(model)/d(outward shift of the edge), grey/px.
    pub(crate) response: Vec<f64>,
}

/// How far the band reaches from the ellipse, px.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    pub(crate) inner_px: f64,
    pub(crate) outer_px: f64,
}

impl Band {
    fn clear(&mut self) {
        self.u.clear();
        self.v.clear();
        self.grey.clear();
        self.angle.clear();
        self.cos.clear();
        self.sin.clear();
        self.far.clear();
        self.distance.clear();
    }

    /// Eccentric angle of the foot point of a pixel on the ellipse last evaluated, rad.
    pub(crate) fn foot_angle(&self, i: usize) -> f64 {
        self.foot_sin[i].atan2(self.foot_cos[i])
    }

    /// Collects the pixels of the image within `reach` of the ellipse; beyond `edge_px` the edge is not felt.
    pub(crate) fn collect(&mut self, view: &GrayView, ellipse: &Ellipse, reach: Reach, edge_px: f64) {
        self.clear();
        let frame = Frame::new(ellipse);
        // The parallel curve of an ellipse lies inside the ellipse with both axes grown by this much.
        let bulge = (frame.a + frame.b) / (2.0 * (frame.a * frame.b).sqrt());
        let (outer, inner) = (reach.outer_px * bulge, reach.inner_px * bulge);
        let (ao, bo) = (frame.a + outer, frame.b + outer);
        let (ai, bi) = (frame.a - inner, frame.b - inner);
        let half_height = (ao * frame.sin).hypot(bo * frame.cos);
        let (u_last, v_last) = (view.width() as f64 - 1.0, view.height() as f64 - 1.0);
        let (v_lo, v_hi) = ((frame.v0 - half_height).ceil().max(0.0), (frame.v0 + half_height).floor().min(v_last));
        let rows = if v_hi < v_lo { 0..0 } else { v_lo as usize..v_hi as usize + 1 };
        for v in rows {
            let dv = v as f64 - frame.v0;
            let Some((lo, hi)) = frame.row_span(dv, ao, bo) else { continue };
            let (lo, hi) = ((frame.u0 + lo).ceil().max(0.0), (frame.u0 + hi).floor().min(u_last));
            if hi < lo {
                continue;
            }
            let hole = if ai > 0.0 && bi > 0.0 { frame.row_span(dv, ai, bi) } else { None };
            let (hole_lo, hole_hi) =
                hole.map_or((f64::INFINITY, f64::NEG_INFINITY), |(l, h)| (frame.u0 + l, frame.u0 + h));
            let mut u = lo as usize;
            while u <= hi as usize {
                let uf = u as f64;
                if uf > hole_lo && uf < hole_hi {
                    u = (hole_hi.ceil() as usize).max(u + 1);
                    continue;
                }
                let foot = frame.foot(uf, v as f64, None);
                if foot.distance >= -reach.inner_px && foot.distance <= reach.outer_px {
                    self.u.push(uf);
                    self.v.push(v as f64);
                    self.grey.push(f64::from(view.get(u, v)));
                    self.angle.push(foot.sin.atan2(foot.cos));
                    self.cos.push(foot.cos);
                    self.sin.push(foot.sin);
                    self.far.push(foot.distance.abs() > edge_px);
                    self.distance.push(foot.distance);
                }
                u += 1;
            }
        }
        let n = self.u.len();
        self.keep.clear();
        self.keep.resize(n, true);
        self.foot_cos.clone_from(&self.cos);
        self.foot_sin.clone_from(&self.sin);
        for list in [&mut self.residual, &mut self.inside, &mut self.response] {
            list.clear();
            list.resize(n, 0.0);
        }
    }
}
