//! The part of the sheet that both cameras see, as points of a grid.

use crate::bundle::NamedCovariance;
use crate::frames::{Rig, Sheet};
use crate::rigid::Motion;
use crate::sheet::{SheetUncertainty, StereoSheet};
use nalgebra::Vector2;

/// Points along the longer and the shorter side of what both cameras see.
const COLUMNS: usize = 19;
const ROWS: usize = 13;

/// Points of the sheet that both cameras see, and the distances of the grid they are taken from.
pub(super) struct Field {
    pub(super) points: Vec<[f64; 2]>,
    pub(super) spacing_mm: [f64; 2],
}

/// A calibration that can be asked about points of the sheet, and which those are.
pub(super) struct SeenSheet {
    pub(super) uncertainty: SheetUncertainty,
    pub(super) field: Field,
}

impl SeenSheet {
    /// Told in the frame of the sheet that is given, or else in the one that goes with the plane; none without a second camera or a plane.
    pub(super) fn of(
        covariance: &NamedCovariance,
        sizes_px: &[[f64; 2]],
        names: &[&str],
        frame: Option<&Motion<Rig, Sheet>>,
    ) -> Option<Self> {
        let [first, second] = *names else { return None };
        let own = StereoSheet::of(covariance)?;
        let stereo = frame.map_or(own, |frame| own.told_in(frame));
        let uncertainty = SheetUncertainty::about(stereo, covariance, [first, second]);
        Some(Self { field: Field::of(uncertainty.stereo(), sizes_px)?, uncertainty })
    }
}

impl Field {
    pub(super) fn middle(&self) -> [f64; 2] {
        let n = self.points.len() as f64;
        [0, 1].map(|a| self.points.iter().map(|p| p[a]).sum::<f64>() / n)
    }

    /// In the frame of `stereo`; none where both cameras have nothing in common.
    pub(super) fn of(stereo: &StereoSheet, sizes_px: &[[f64; 2]]) -> Option<Self> {
        let size = |c: usize| sizes_px.get(c).copied();
        let (first, second) = (size(0)?, size(1)?);
        let inside = |q: &Vector2<f64>, size: [f64; 2]| {
            (-0.5..=size[0] - 0.5).contains(&q.x) && (-0.5..=size[1] - 0.5).contains(&q.y)
        };
        let seen = |p: [f64; 2]| stereo.pixels(p).is_some_and(|[a, b]| inside(&a, first) && inside(&b, second));
        // The first camera's border on the sheet.
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for k in 0..=8 {
            let t = f64::from(k) / 8.0;
            for q in [[t, 0.0], [t, 1.0], [0.0, t], [1.0, t]] {
                let p = stereo.point_at(0, &Vector2::new(q[0] * (first[0] - 1.0), q[1] * (first[1] - 1.0)))?;
                for a in 0..2 {
                    low[a] = low[a].min(p[a]);
                    high[a] = high[a].max(p[a]);
                }
            }
        }
        let grid = |low: [f64; 2], high: [f64; 2]| {
            let wide = high[0] - low[0] >= high[1] - low[1];
            let counts = if wide { [COLUMNS, ROWS] } else { [ROWS, COLUMNS] };
            let spacing_mm = [0, 1].map(|a| (high[a] - low[a]) / counts[a] as f64);
            let at = |a: usize, k: usize| low[a] + (k as f64 + 0.5) * spacing_mm[a];
            let all = (0..counts[1]).flat_map(|j| (0..counts[0]).map(move |i| (i, j)));
            let points: Vec<[f64; 2]> = all.map(|(i, j)| [at(0, i), at(1, j)]).filter(|p| seen(*p)).collect();
            Field { points, spacing_mm }
        };
        // Once over all of the first camera, once over what was common.
        let coarse = grid(low, high);
        for a in 0..2 {
            let bounds = coarse.points.iter().map(|p| p[a]);
            let (l, h) = bounds.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            low[a] = low[a].max(l - coarse.spacing_mm[a]);
            high[a] = high[a].min(h + coarse.spacing_mm[a]);
        }
        let fine = grid(low, high);
        (fine.points.len() > 3).then_some(fine)
    }
}
