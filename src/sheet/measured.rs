//! A sheet given as a plane in the frame of an older sheet.

use super::{Placement, SheetEstimate, plane_geometry, sigmas};
use crate::frames::{Rig, Sheet};
use crate::rigid::Motion;
use nalgebra::{Matrix3, SMatrix, Vector3, Vector4};

impl SheetEstimate {
    /// The sheet `z = a + b x + c y` of an older sheet's frame, with the covariance of (a, b, c) (mm, 1, 1); `second_center_mm` is
    /// the second projection centre in the rig frame. Cameras and older frame are held; the new frame is placed as the older one was.
    pub fn from_plane(
        rig_from_older: &Motion<Rig, Sheet>,
        abc: &Vector3<f64>,
        covariance: &Matrix3<f64>,
        second_center_mm: Option<Vector3<f64>>,
    ) -> Self {
        // Normal away from the first camera, and distance.
        let plane = |p: &Vector3<f64>| {
            let n = rig_from_older.rotation * -Vector3::new(-p.y, -p.z, 1.0).normalize();
            n.push(n.dot(&rig_from_older.apply(&Vector3::new(0.0, 0.0, p.x))))
        };
        let at = plane(abc);
        let n = at.xyz();
        let mut moved = SMatrix::<f64, 4, 3>::zeros();
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = 1e-6;
            let d: Vector4<f64> = (plane(&(abc + step)) - plane(&(abc - step))) / 2e-6;
            moved.fixed_view_mut::<3, 1>(0, k).copy_from(&n.cross(&d.xyz()));
            moved[(3, k)] = d.w;
        }
        let geometry = plane_geometry(n, at.w, second_center_mm, &Placement::of_frame(rig_from_older));
        let by_plane = geometry.derivative.fixed_columns::<4>(0) * moved;
        let mut estimate = geometry.estimate;
        estimate.sigmas = sigmas(&(by_plane * covariance * by_plane.transpose()));
        estimate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::rotation_exp;

    #[test]
    fn points_of_the_plane_are_on_the_sheet_and_sigmas_are_those_of_moved_planes() {
        let turn = rotation_exp(&Vector3::new(3.0, 0.2, -0.1));
        let older = Motion::<Rig, Sheet>::new(turn, Vector3::new(5.0, -3.0, 450.0));
        let abc = Vector3::new(-0.7, 0.03, -0.02);
        let sigma = Vector3::new(0.01, 2e-4, 3e-4);
        let covariance = Matrix3::from_diagonal(&sigma.map(|s| s * s));
        let center = Some(Vector3::new(500.0, 10.0, 120.0));
        let e = SheetEstimate::from_plane(&older, &abc, &covariance, center);
        assert!(e.distance_mm > 0.0 && e.normal.z > 0.0);
        for (x, y) in [(0.0, 0.0), (10.0, 3.0), (-4.0, 20.0)] {
            let p = older.apply(&Vector3::new(x, y, abc.x + abc.y * x + abc.z * y));
            assert!((e.normal.dot(&p) - e.distance_mm).abs() < 1e-10);
        }
        let mut distance = 0.0;
        let mut normal = 0.0;
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = sigma[k];
            let side = |s: f64| SheetEstimate::from_plane(&older, &(abc + step * s), &covariance, center);
            let (p, m) = (side(1.0), side(-1.0));
            distance += ((p.distance_mm - m.distance_mm) / 2.0).powi(2);
            normal += ((p.normal - m.normal) / 2.0).norm_squared();
        }
        assert!((e.sigmas[0] / distance.sqrt() - 1.0).abs() < 1e-3, "{} {}", e.sigmas[0], distance.sqrt());
        assert!((e.sigmas[1].hypot(e.sigmas[2]) / normal.sqrt() - 1.0).abs() < 1e-3);
    }
}
