//! Positions along a row of the grid: exact at a few points of every panel of [`TOGETHER`] pixels, a polynomial between them.
//!
//! ```text
//! u(t) = u_0 + sum_j a_j T_j(t) = u_0 + sum_p c_p t^p,   c_p = sum_k W_(p k) (u_k - u_0),   k, j = 0 .. 7,   p = 0 .. 5
//! ```
//! through the positions u_k at Chebyshev's nodes, spread so that the first and the last are the panel's first and last pixel. The map is analytic:
//! a_j fall off as powers of the panel's length over the distance to the nearest pole, some hundred millimetres away. Where a_6 and a_7 together have
//! fallen below [`FAINT`] they are left out, and what was left out before is less still; elsewhere, and where a node is not seen, every position is
//! computed by itself. Pixels between seen ones are seen: what lies in front of the camera and within the lens's circle is convex, and with a pole
//! in between nothing is faint.

use super::chebyshev::{node, parts, powers};
use super::grid::SheetGrid;
use super::rows::TOGETHER;
use crate::camera::LineImage;
use crate::lanes::Lanes;
use nalgebra::Vector2;

/// Exact positions in each panel.
const NODES: usize = 8;
/// Parts that positions are the sum of.
const PARTS: usize = 6;
/// Neighbouring panels whose nodes are found together, enough for any width of lanes.
const SIDE_BY_SIDE: usize = 2;
/// px. Levels differ by less than a hundredth of the rounding of single precision.
const FAINT: f64 = 1e-9;

/// Panels of the rows of a grid.
pub(super) struct Panels {
    /// W, node by node; of the parts that are left out, which come last, what they are.
    weights: [[f64; NODES]; NODES],
    /// t of each pixel.
    t: [f64; TOGETHER],
    /// Columns of the nodes of all panels.
    columns: Vec<f64>,
}

/// Positions of the nodes of a row, u and v, px, `NaN` where not seen; then c of each panel, and what is left out.
pub(super) struct Nodes([Vec<f64>; 2]);

impl Panels {
    pub(super) fn of(width_px: usize) -> Self {
        let n = NODES * width_px.div_ceil(TOGETHER).next_multiple_of(SIDE_BY_SIDE);
        let (last, end) = ((TOGETHER - 1) as f64, node(0, NODES));
        let within: [f64; NODES] = std::array::from_fn(|k| 0.5 * last * (1.0 + node(k, NODES) / end));
        let weights = |k: usize| {
            let all = parts::<NODES>(&std::array::from_fn(|i| f64::from(u8::from(i == k))));
            let kept = powers::<PARTS>(std::array::from_fn(|j| all[j]));
            std::array::from_fn(|p| if p < PARTS { kept[p] } else { all[p] })
        };
        Self {
            weights: std::array::from_fn(weights),
            t: std::array::from_fn(|i| end * (2.0 * i as f64 / last - 1.0)),
            columns: (0..n).map(|k| (k / NODES * TOGETHER) as f64 + within[k % NODES]).collect(),
        }
    }

    /// Room for the nodes of a row.
    pub(super) fn nodes(&self) -> Nodes {
        let n = self.columns.len();
        Nodes([vec![f64::NAN; n], vec![f64::NAN; n]])
    }

    /// Nodes of a row through the camera.
    #[inline(always)]
    pub(super) fn see<L: Lanes>(&self, line: &LineImage<L>, grid: &SheetGrid, nodes: &mut Nodes) {
        let (origin, step) = (L::splat(grid.origin_mm[0]), L::splat(grid.mm_per_px));
        let mut i = 0;
        while i < self.columns.len() {
            let [u, v] = line.at(L::load(&self.columns[i..]).fused(step, origin));
            u.store(&mut nodes.0[0][i..]);
            v.store(&mut nodes.0[1][i..]);
            i += L::N;
        }
    }

    /// The same by a function of the column.
    pub(super) fn see_one_by_one(&self, position: impl Fn(f64) -> Option<Vector2<f64>>, nodes: &mut Nodes) {
        for (i, column) in self.columns.iter().enumerate() {
            let q = position(*column);
            (nodes.0[0][i], nodes.0[1][i]) = q.map_or((f64::NAN, f64::NAN), |q| (q.x, q.y));
        }
    }

    /// From the nodes of a row to the polynomials of its panels: of all before the first is asked for, as none waits for another.
    #[inline(always)]
    pub(super) fn fit<L: Lanes>(&self, nodes: &mut Nodes) {
        for axis in &mut nodes.0 {
            for f in axis.as_chunks_mut::<NODES>().0 {
                let (first, mut c) = (f[0], [0.0; NODES]);
                let mut p = 0;
                while p < NODES {
                    let mut sum = L::splat(0.0);
                    for k in 1..NODES {
                        sum = L::load(&self.weights[k][p..]).fused(L::splat(f[k] - first), sum);
                    }
                    sum.store(&mut c[p..]);
                    p += L::N;
                }
                c[0] += first;
                *f = c;
            }
        }
    }

    /// Positions of a panel's pixels, and between what they lie along both axes; `None` where the polynomial does not hold, and nothing is
    /// touched.
    #[inline(always)]
    pub(super) fn place<L: Lanes>(
        &self,
        nodes: &Nodes,
        panel: usize,
        to: [&mut [f64; TOGETHER]; 2],
    ) -> Option<[[f64; 2]; 2]> {
        let (mut c, mut between) = ([[0.0; NODES]; 2], [[0.0; 2]; 2]);
        for axis in 0..2 {
            c[axis].copy_from_slice(&nodes.0[axis][panel * NODES..][..NODES]);
            let (c, left_out) = c[axis].split_at(PARTS);
            // False for NaN.
            if !(left_out[0].abs() + left_out[1].abs() < FAINT) {
                return None;
            }
            // A margin far above rounding: no pixel may lie outside.
            let reach = FAINT + c[1..].iter().map(|x| x.abs()).sum::<f64>();
            between[axis] = [c[0] - reach, c[0] + reach];
        }
        let mut i = 0;
        while i < TOGETHER {
            let t = L::load(&self.t[i..]);
            for axis in 0..2 {
                let mut sum = L::splat(c[axis][PARTS - 1]);
                for p in 1..PARTS {
                    sum = sum.fused(t, L::splat(c[axis][PARTS - 1 - p]));
                }
                sum.store(&mut to[axis][i..]);
            }
            i += L::N;
        }
        Some(between)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{BulkCamera, Camera, Intrinsics, Radial, Window};
    use crate::dewarp::SheetMap;
    use crate::lanes::{Kernel, Twice, run_all};
    use crate::rigid::{Motion, rotation_exp};
    use nalgebra::Vector3;

    /// Positions of a row, panel by panel.
    #[derive(Clone)]
    struct Row {
        map: SheetMap,
        grid: SheetGrid,
    }
    impl Kernel for Row {
        type Output = Vec<Option<[[f64; TOGETHER]; 2]>>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let panels = Panels::of(self.grid.width_px);
            let mut nodes = panels.nodes();
            let y_mm = self.grid.origin_mm[1];
            match BulkCamera::<Twice<L>>::of(self.map.camera()) {
                Some(camera) => {
                    panels.see(&LineImage::new(camera, self.map.cam_from_sheet(), y_mm, 0.3), &self.grid, &mut nodes);
                }
                None => panels.see_one_by_one(
                    |column| self.map.project(&Vector3::new(self.grid.point_mm(column, 0.0)[0], y_mm, 0.3)),
                    &mut nodes,
                ),
            }
            panels.fit::<L>(&mut nodes);
            let mut out = Vec::new();
            for panel in 0..self.grid.width_px.div_ceil(TOGETHER) {
                let (mut u, mut v) = ([0.0; TOGETHER], [0.0; TOGETHER]);
                let held = panels.place::<L>(&nodes, panel, [&mut u, &mut v]);
                if let Some(between) = held {
                    for (at, [low, high]) in [u, v].iter().zip(between) {
                        assert!(at.iter().all(|x| (low..=high).contains(x)), "{low} {high}");
                    }
                }
                out.push(held.map(|_| [u, v]));
            }
            out
        }
    }

    /// Panels that held, panels, and the largest distance from the camera's own positions, px.
    fn compared(row: &Row) -> (usize, usize, f64) {
        let all = run_all(row);
        all.iter().for_each(|one| assert!(*one == all[0]));
        let (mut held, mut worst) = (0, 0.0_f64);
        for (panel, at) in all[0].iter().enumerate() {
            let Some([u, v]) = at else { continue };
            held += 1;
            for i in 0..TOGETHER {
                let [x, _] = row.grid.point_mm((panel * TOGETHER + i) as f64, 0.0);
                let q = row.map.project(&Vector3::new(x, row.grid.origin_mm[1], 0.3)).unwrap();
                worst = worst.max((u[i] - q.x).abs()).max((v[i] - q.y).abs());
            }
        }
        (held, all[0].len(), worst)
    }

    /// Cameras from straight above to 65 degrees oblique at 500 mm with strong lenses of both kinds, every third behind glass to water: fine grids by the polynomial, coarse ones
    /// where it holds, and never farther off than what counts as nothing.
    #[test]
    fn polynomials_hold_what_they_promise() {
        let glass = Window::new(Vector3::new(-0.1, -0.2, 1.0), 200.0, 8.0, [1.0, 1.52, 1.33]).unwrap();
        let (mut fine, mut coarse, mut worst) = ([0, 0], [0, 0], 0.0_f64);
        for k in 0..60 {
            let part = |step: f64| (step * f64::from(k + 1)).fract();
            let mut i = Intrinsics::pinhole(8000.0, 1023.5, 1023.5);
            i.k = [0.8 * part(0.618) - 0.4, 2.0 * part(0.414) - 1.0, 0.0];
            i.radial = if k % 2 == 0 { Radial::IdealToDistorted } else { Radial::DistortedToIdeal };
            (i.alpha_rad, i.beta_rad) = (0.2 * part(0.732) - 0.1, 0.3 * part(0.236) - 0.15);
            let turn = rotation_exp(&Vector3::new(0.0, 2.2 * part(0.303) - 1.1, 0.0))
                * rotation_exp(&Vector3::new(3.1, 0.1, 0.2 * part(0.123)));
            let map = SheetMap::new(
                Camera::new(i).unwrap().with_window((k % 3 == 0).then_some(glass)),
                Motion::new(turn, Vector3::new(0.3, -0.2, 500.0)),
                [2048, 2048],
            );
            for (mm_per_px, count) in [(0.05, &mut fine), (0.3, &mut coarse)] {
                let half = 300.0 * mm_per_px;
                let grid = SheetGrid::over([-half, -20.0, half, 20.0], mm_per_px).unwrap();
                let (held, all, off) = compared(&Row { map: map.clone(), grid });
                (count[0], count[1], worst) = (count[0] + held, count[1] + all, worst.max(off));
            }
        }
        println!("fine: {} of {}, coarse: {} of {}, {worst:.1e} px off", fine[0], fine[1], coarse[0], coarse[1]);
        assert_eq!(fine[0], fine[1]);
        assert!(0 < coarse[0] && coarse[0] < coarse[1], "{coarse:?}");
        assert!(worst < FAINT, "{worst:e} px");
    }
}
