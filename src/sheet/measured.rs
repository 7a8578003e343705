//! A sheet given as a plane in the frame of an older sheet.

use super::{Placement, SheetEstimate, plane_geometry, sigmas};
use crate::frames::{Rig, Sheet};
use crate::rigid::Motion;
use nalgebra::{Matrix6, SMatrix, Vector3, Vector4};

impl SheetEstimate {
    /// The sheet `z = a + b x + c y` of an older sheet's frame, with the covariance of (a, b, c) (mm, 1, 1) and of
    /// `second_center_mm`, the second projection centre in the rig frame (mm). The older frame is held; the new one is placed as it was.
    pub fn from_plane(
        rig_from_older: &Motion<Rig, Sheet>,
        abc: &Vector3<f64>,
        covariance: &Matrix6<f64>,
        second_center_mm: Option<Vector3<f64>>,
    ) -> Self {
        Self::from_placed_plane(rig_from_older, abc, covariance, second_center_mm, &Placement::of_frame(rig_from_older))
    }

    /// [`SheetEstimate::from_plane`] with the new frame where `placement` says.
    pub(crate) fn from_placed_plane(
        rig_from_older: &Motion<Rig, Sheet>,
        abc: &Vector3<f64>,
        covariance: &Matrix6<f64>,
        second_center_mm: Option<Vector3<f64>>,
        placement: &Placement,
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
        let geometry = plane_geometry(n, at.w, second_center_mm, placement);
        let mut by = SMatrix::<f64, 10, 6>::zeros();
        by.fixed_columns_mut::<3>(0).copy_from(&(geometry.derivative.fixed_columns::<4>(0) * moved));
        by.fixed_columns_mut::<3>(3).copy_from(&geometry.derivative.fixed_columns::<3>(4));
        let mut estimate = geometry.estimate;
        estimate.sigmas = sigmas(&(by * covariance * by.transpose()));
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
        let center_sigma = Vector3::new(0.5, 0.2, 0.9);
        let mut covariance = Matrix6::zeros();
        (0..3).for_each(|k| covariance[(k, k)] = sigma[k] * sigma[k]);
        (0..3).for_each(|k| covariance[(k + 3, k + 3)] = center_sigma[k] * center_sigma[k]);
        let center = Vector3::new(500.0, 10.0, 120.0);
        let e = SheetEstimate::from_plane(&older, &abc, &covariance, Some(center));
        assert!(e.distance_mm > 0.0 && e.normal.z > 0.0);
        for (x, y) in [(0.0, 0.0), (10.0, 3.0), (-4.0, 20.0)] {
            let p = older.apply(&Vector3::new(x, y, abc.x + abc.y * x + abc.z * y));
            assert!((e.normal.dot(&p) - e.distance_mm).abs() < 1e-10);
        }
        let (mut distance, mut normal, mut angle) = (0.0, 0.0, 0.0);
        for k in 0..6 {
            let (mut step, mut shift) = (Vector3::zeros(), Vector3::zeros());
            if k < 3 {
                step[k] = sigma[k];
            } else {
                shift[k - 3] = center_sigma[k - 3];
            }
            let side =
                |s: f64| SheetEstimate::from_plane(&older, &(abc + step * s), &covariance, Some(center + shift * s));
            let (p, m) = (side(1.0), side(-1.0));
            distance += ((p.distance_mm - m.distance_mm) / 2.0).powi(2);
            normal += ((p.normal - m.normal) / 2.0).norm_squared();
            angle += ((p.angle_to_baseline_rad - m.angle_to_baseline_rad) / 2.0).powi(2);
        }
        assert!((e.sigmas[9] / angle.sqrt() - 1.0).abs() < 1e-3, "{} {}", e.sigmas[9], angle.sqrt());
        assert!((e.sigmas[0] / distance.sqrt() - 1.0).abs() < 1e-3, "{} {}", e.sigmas[0], distance.sqrt());
        assert!((e.sigmas[1].hypot(e.sigmas[2]) / normal.sqrt() - 1.0).abs() < 1e-3);
    }
}
