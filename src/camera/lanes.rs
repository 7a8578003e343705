//! Images of many points at a time: the formulas of the room's head in [`Lanes`], for a camera without a window whose polynomial
//! goes from ideal to distorted.
//!
//! Instead of whole Jacobians: the movement of an image along one direction, and the derivative of one combination of its two
//! coordinates (adjoint, marked by a bar) by everything. With `e = (f n_u, aspect f n_v) / h` for the combination `n_u u + n_v v`:
//! ```text
//! h_bar  = -(tx e_u + ty e_v)
//! xd_bar = e_u / cos b - h_bar tan b / m,   yd_bar = e_u tan a tan b + e_v / cos a - h_bar tan a / (cos b m)
//! w      = x xd_bar + y yd_bar              its derivatives by k1, k2, k3: s w, s^2 w, s^3 w
//! x_bar  = g xd_bar + 2 g'(s) x w,          y_bar = g yd_bar + 2 g'(s) y w
//! p_bar  = (x_bar, y_bar, -(x x_bar + y y_bar)) / Z
//! ```

use super::{Camera, INTRINSICS, Radial};
use crate::lanes::{Lanes, splats};

/// A camera, each of its numbers in every lane.
pub(crate) struct LaneCamera<L> {
    f: L,
    fv: L,
    aspect: L,
    cx: L,
    cy: L,
    k: [L; 3],
    limit_squared: L,
    /// h = 1 - h_by . xd
    h_by: [L; 2],
    /// tx h = x_by . xd
    x_by: [L; 2],
    /// ty h = y_by yd
    y_by: L,
    /// Derivative by alpha over yd: of tx h, ty h, h.
    alpha: [L; 3],
    /// Derivatives by beta over xd and yd: of tx h, of h.
    beta: [[L; 2]; 2],
    /// Derivative of h by the pupil ratio over xd and yd.
    pupil: [L; 2],
}

/// Images of points and what their derivatives need.
pub(crate) struct LaneImage<L: Lanes> {
    /// Pixel.
    pub(crate) u: L,
    /// Pixel.
    pub(crate) v: L,
    /// Where the point has an image.
    pub(crate) valid: L::Mask,
    iz: L,
    x: L,
    y: L,
    s: L,
    gain: L,
    slope: L,
    xd: L,
    yd: L,
    ih: L,
    tx: L,
    ty: L,
}

impl<L: Lanes> LaneCamera<L> {
    /// `None` for a camera behind a window or of the photogrammetric polynomial.
    #[inline(always)]
    pub(crate) fn of(camera: &Camera) -> Option<Self> {
        let i = &camera.intrinsics;
        if camera.window.is_some() || i.radial != Radial::IdealToDistorted {
            return None;
        }
        let (t, m) = (&camera.tilt, i.pupil_ratio);
        let (ca2, cb2) = (t.ca * t.ca, t.cb * t.cb);
        let limit = camera.limit.radius();
        Some(Self {
            f: L::splat(i.f_px),
            fv: L::splat(i.f_px * i.aspect),
            aspect: L::splat(i.aspect),
            cx: L::splat(i.cx_px),
            cy: L::splat(i.cy_px),
            k: splats(i.k),
            limit_squared: L::splat((limit * limit).min(f64::MAX)),
            h_by: splats([t.tb / m, t.ta / (t.cb * m)]),
            x_by: splats([1.0 / t.cb, t.ta * t.tb]),
            y_by: L::splat(1.0 / t.ca),
            alpha: splats([t.tb / ca2, t.sa / ca2, -1.0 / (ca2 * t.cb * m)]),
            beta: [splats([t.sb / cb2, t.ta / cb2]), splats([-1.0 / (cb2 * m), -t.ta * t.sb / (cb2 * m)])],
            pupil: splats([t.tb / (m * m), t.ta / (t.cb * m * m)]),
        })
    }

    /// Images of points of the camera frame.
    #[inline(always)]
    pub(crate) fn image(&self, p: [L; 3]) -> LaneImage<L> {
        let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
        let iz = one / p[2];
        let (x, y) = (p[0] * iz, p[1] * iz);
        let s = x * x + y * y;
        let [k1, k2, k3] = self.k;
        let gain = one + s * (k1 + s * (k2 + s * k3));
        let slope = k1 + s * (two * k2 + s * (L::splat(3.0) * k3));
        let (xd, yd) = (x * gain, y * gain);
        let h = one - (xd * self.h_by[0] + yd * self.h_by[1]);
        let ih = one / h;
        let tx = (xd * self.x_by[0] + yd * self.x_by[1]) * ih;
        let ty = yd * self.y_by * ih;
        let (u, v) = (self.cx + self.f * tx, self.cy + self.fv * ty);
        // Comparisons with NaN are false, 1 / Z of an infinite Z is zero; the last one refuses what overflows.
        let before = L::and(zero.below(iz), s.below(self.limit_squared));
        let bounded = L::and(zero.below(h), (u * u + v * v).below(L::splat(f64::INFINITY)));
        LaneImage { u, v, valid: L::and(before, bounded), iz, x, y, s, gain, slope, xd, yd, ih, tx, ty }
    }

    /// Movement of images for a movement of their points.
    #[inline(always)]
    pub(crate) fn along(&self, at: &LaneImage<L>, dp: [L; 3]) -> [L; 2] {
        let (dx, dy) = ((dp[0] - at.x * dp[2]) * at.iz, (dp[1] - at.y * dp[2]) * at.iz);
        let dgain = at.slope * (L::splat(2.0) * (at.x * dx + at.y * dy));
        let (dxd, dyd) = (dx * at.gain + at.x * dgain, dy * at.gain + at.y * dgain);
        let dh = -(dxd * self.h_by[0] + dyd * self.h_by[1]);
        let dtx = (dxd * self.x_by[0] + dyd * self.x_by[1] - at.tx * dh) * at.ih;
        let dty = (dyd * self.y_by - at.ty * dh) * at.ih;
        [self.f * dtx, self.fv * dty]
    }

    /// Derivative of `n . pixel` by the point and by the intrinsics.
    #[inline(always)]
    pub(crate) fn derivative(&self, at: &LaneImage<L>, n: [L; 2]) -> ([L; 3], [L; INTRINSICS]) {
        let (eu, ev) = (self.f * n[0] * at.ih, self.fv * n[1] * at.ih);
        let h = -(at.tx * eu + at.ty * ev);
        let xd = eu * self.x_by[0] - h * self.h_by[0];
        let yd = eu * self.x_by[1] + ev * self.y_by - h * self.h_by[1];
        let w = at.x * xd + at.y * yd;
        let bent = L::splat(2.0) * at.slope * w;
        let (x, y) = (at.gain * xd + bent * at.x, at.gain * yd + bent * at.y);
        let by_point = [x * at.iz, y * at.iz, -((at.x * x + at.y * y) * at.iz)];
        let (a, b) = (&self.alpha, &self.beta);
        let sw = at.s * w;
        let by_intrinsics = [
            n[0] * at.tx + n[1] * self.aspect * at.ty,
            n[1] * self.f * at.ty,
            n[0],
            n[1],
            at.yd * (eu * a[0] + ev * a[1] + h * a[2]),
            eu * (at.xd * b[0][0] + at.yd * b[0][1]) + h * (at.xd * b[1][0] + at.yd * b[1][1]),
            sw,
            at.s * sw,
            at.s * (at.s * sw),
            h * (at.xd * self.pupil[0] + at.yd * self.pupil[1]),
        ];
        (by_point, by_intrinsics)
    }
}

/// Derivative of one weighted coordinate of an image by the intrinsics, by a turn of the point about the camera's centre (the point times the
/// next), and by the point.
pub(crate) type LaneRow<L> = [L; INTRINSICS + 6];

/// From the derivatives by the distorted point (that of the distorted by the ideal point given), by f, aspect, axis point, and by both
/// tilts and the pupil ratio.
#[inline(always)]
fn lane_row<L: Lanes>(
    at: &LaneImage<L>,
    [xx, xy, yy]: [L; 3],
    [xd, yd]: [L; 2],
    [f, aspect, cx, cy]: [L; 4],
    [alpha, beta, pupil]: [L; 3],
) -> LaneRow<L> {
    let (x, y) = (xd * xx + yd * xy, xd * xy + yd * yy);
    let (depth, w) = (at.x * x + at.y * y, at.s * (at.x * xd + at.y * yd));
    let sw = at.s * w;
    let turn = [-(at.y * depth) - y, x + at.x * depth, at.x * y - at.y * x];
    let point = [x * at.iz, y * at.iz, -(depth * at.iz)];
    [f, aspect, cx, cy, alpha, beta, w, sw, at.s * sw, pupil, turn[0], turn[1], turn[2], point[0], point[1], point[2]]
}

impl<L: Lanes> LaneCamera<L> {
    /// Derivatives of either coordinate of the pixel times a weight.
    #[inline(always)]
    pub(crate) fn rows(&self, at: &LaneImage<L>, weight: L) -> [LaneRow<L>; 2] {
        let zero = L::splat(0.0);
        let (a, b, weighted) = (&self.alpha, &self.beta, at.ih * weight);
        let (fu, fv) = (self.f * weighted, self.fv * weighted);
        let bend = L::splat(2.0) * at.slope;
        let (bx, by) = (bend * at.x, bend * at.y);
        let [xx, xy, yy] = [at.gain + bx * at.x, bx * at.y, at.gain + by * at.y];
        let h_by_beta = at.xd * b[1][0] + at.yd * b[1][1];
        let h_by_pupil = at.xd * self.pupil[0] + at.yd * self.pupil[1];
        let (tu, tv) = (fu * at.tx, fv * at.ty);
        [
            lane_row(
                at,
                [xx, xy, yy],
                [fu * self.x_by[0] + tu * self.h_by[0], fu * self.x_by[1] + tu * self.h_by[1]],
                [weight * at.tx, zero, weight, zero],
                [
                    at.yd * (fu * a[0] - tu * a[2]),
                    fu * (at.xd * b[0][0] + at.yd * b[0][1]) - tu * h_by_beta,
                    -(tu * h_by_pupil),
                ],
            ),
            lane_row(
                at,
                [xx, xy, yy],
                [tv * self.h_by[0], fv * self.y_by + tv * self.h_by[1]],
                [weight * self.aspect * at.ty, weight * self.f * at.ty, zero, weight],
                [at.yd * (fv * a[1] - tv * a[2]), -(tv * h_by_beta), -(tv * h_by_pupil)],
            ),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::lanes::{GROUP, Kernel, run_all};
    use nalgebra::{Vector2, Vector3};

    fn camera() -> Camera {
        let mut i = Intrinsics::pinhole(8000.0, 500.0, 390.0);
        (i.aspect, i.alpha_rad, i.beta_rad, i.k, i.pupil_ratio) = (1.02, 0.2, -0.35, [-0.25, 1.2, -3.0], 1.1);
        Camera::new(i).unwrap()
    }

    fn points() -> [[f64; 3]; GROUP] {
        std::array::from_fn(|k| [40.0 * (k as f64).sin(), 30.0 * (2.0 * k as f64).cos(), 480.0 + 5.0 * k as f64])
    }

    /// Pixel, movement along dp, derivative of n . pixel of each point.
    #[derive(Clone)]
    struct Images {
        camera: Camera,
        points: [[f64; 3]; GROUP],
    }
    impl Kernel for Images {
        type Output = Vec<[f64; 18]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<[f64; 18]> {
            let camera = LaneCamera::<L>::of(&self.camera).unwrap();
            let mut out = vec![[0.0; 18]; GROUP];
            for first in (0..GROUP).step_by(L::N) {
                let part: [L; 3] =
                    std::array::from_fn(|k| L::load(&(0..L::N).map(|i| self.points[first + i][k]).collect::<Vec<_>>()));
                let at = camera.image(part);
                let moved = camera.along(&at, [0.3, -0.2, 0.7].map(L::splat));
                let (p, i) = camera.derivative(&at, [0.8, -0.6].map(L::splat));
                let valid = L::select(at.valid, L::splat(1.0), L::splat(0.0));
                let all = [at.u, at.v].into_iter().chain(moved).chain(p).chain(i).chain([valid]);
                for (k, x) in all.enumerate() {
                    let mut place = [0.0; GROUP];
                    x.store(&mut place);
                    (0..L::N).for_each(|n| out[first + n][k] = place[n]);
                }
            }
            out
        }
    }

    #[test]
    fn lanes_agree_with_the_plain_camera_and_each_other() {
        let all = run_all(&Images { camera: camera(), points: points() });
        for widths in &all {
            assert_eq!(*widths, all[0]);
        }
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-13 * (1.0 + b.abs()), "{a} {b}");
        for (p, x) in points().iter().zip(&all[0]) {
            let jet = camera().project_jet(&Vector3::from(*p)).unwrap();
            near(x[0], jet.pixel.x);
            near(x[1], jet.pixel.y);
            let moved = jet.dq_dp * Vector3::new(0.3, -0.2, 0.7);
            near(x[2], moved.x);
            near(x[3], moved.y);
            let n = Vector2::new(0.8, -0.6);
            let (by_p, by_i) = (jet.dq_dp.tr_mul(&n), jet.dq_dintrinsics.tr_mul(&n));
            (0..3).for_each(|k| near(x[4 + k], by_p[k]));
            (0..INTRINSICS).for_each(|k| near(x[7 + k], by_i[k]));
            assert_eq!(x[17], 1.0);
        }
    }

    /// Both rows of each point, weighted by 1.3.
    #[derive(Clone)]
    struct BothRows(Images);
    impl Kernel for BothRows {
        type Output = Vec<[[f64; 16]; 2]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let camera = LaneCamera::<L>::of(&self.0.camera).unwrap();
            let mut out = vec![[[0.0; 16]; 2]; GROUP];
            for first in (0..GROUP).step_by(L::N) {
                let part: [L; 3] = std::array::from_fn(|k| {
                    L::load(&(0..L::N).map(|i| self.0.points[first + i][k]).collect::<Vec<_>>())
                });
                let rows = camera.rows(&camera.image(part), L::splat(1.3));
                for (s, row) in rows.into_iter().enumerate() {
                    for (k, x) in row.into_iter().enumerate() {
                        let mut place = [0.0; GROUP];
                        x.store(&mut place);
                        (0..L::N).for_each(|n| out[first + n][s][k] = place[n]);
                    }
                }
            }
            out
        }
    }

    #[test]
    fn rows_agree_with_the_plain_camera_and_each_other() {
        let all = run_all(&BothRows(Images { camera: camera(), points: points() }));
        for widths in &all {
            assert_eq!(*widths, all[0]);
        }
        for (p, rows) in points().iter().zip(&all[0]) {
            let p = Vector3::from(*p);
            let jet = camera().project_jet(&p).unwrap();
            for (s, row) in rows.iter().enumerate() {
                let g: Vector3<f64> = jet.dq_dp.row(s).transpose() * 1.3;
                let wanted = (0..INTRINSICS).map(|k| 1.3 * jet.dq_dintrinsics[(s, k)]);
                let wanted = wanted.chain(p.cross(&g).iter().copied().collect::<Vec<_>>()).chain(g.iter().copied());
                for (k, (a, b)) in row.iter().zip(wanted).enumerate() {
                    // A turn is a difference of terms as long as the point times g.
                    let size =
                        if (INTRINSICS..INTRINSICS + 3).contains(&k) { p.norm() * g.norm() } else { 1.0 + b.abs() };
                    assert!((a - b).abs() < 1e-13 * size, "{s} {k}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn lanes_refuse_what_the_plain_camera_refuses() {
        let mut bad = points();
        bad[1][2] = -480.0;
        bad[2] = [f64::NAN, 0.0, 500.0];
        bad[3] = [500.0, 0.0, 500.0];
        bad[4] = [1e300, 1.0, 1e-10];
        bad[5] = [0.0, f64::INFINITY, 500.0];
        bad[6] = [0.0, 0.0, f64::INFINITY];
        let refused: Vec<bool> = bad.iter().map(|p| camera().project_xyz(&Vector3::from(*p)).is_err()).collect();
        assert_eq!(refused, [false, true, true, true, true, true, true, false]);
        for lanes in run_all(&Images { camera: camera(), points: bad }) {
            assert_eq!(lanes.iter().map(|x| x[17] == 0.0).collect::<Vec<_>>(), refused);
        }
    }
}
