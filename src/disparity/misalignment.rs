//! What a disparity map says about the sheet, apart from the scatter of its windows.
//!
//! A window holds few particles, and they lie anywhere in the thickness of the light. Its disparity along s_2 - s_1 is that of its own
//! particles' mean depth and scatters about that of the light's middle plane by
//! ```text
//! scatter = s_z |s_2 - s_1| / sqrt(N)          N pairs of particle images that make the peak
//! ```
//! with the sheet in its right place as well. So the median *length* of a map tells seeding and thickness, not the error of the
//! sheet. What tells that are the medians with their signs, and the smooth part of the map,
//! ```text
//! d_i = P(x_i, y_i) + noise,   P quadratic, by least squares over the windows in use, of n windows with p coefficients
//! smooth^2 = mean P(x_i, y_i)^2 - p s^2 / n,     s^2 = sum (d_i - P)^2 / (n - p)     what noise alone puts into P, taken off
//! ```
//! for the parts along s_2 - s_1 (offset and tilts of the sheet; a bent light) and across it (errors of the cameras) alone.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | smooth | `smooth_px` | px of the dewarped image | root mean square, 0 where noise explains it |
//! | sqrt(p / n) s | `smooth_noise_px` | px | what noise alone would show |
//! | s | `scatter_px` | px | scatter of a window about the smooth part |
//!
//! Sources: Wieneke, Exp. Fluids 39 (2005) 267 (disparity map); Wieneke, Meas. Sci. Technol. 29 (2018) 084002 (thick light).

use crate::record::{DisparityMap, Misalignment};
use crate::stats::SIGMA_OVER_MEDIAN;
use nalgebra::{DMatrix, DVector};

/// Coefficients of a quadratic in x and y.
const TERMS: usize = 6;
/// Those of them that the refit of the plane has already taken.
const PLANE: usize = 3;
/// Standard deviation of a median over that of the mean, normal scatter.
const MEDIAN_OVER_MEAN: f64 = 1.2533;

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 { f64::NAN } else { 0.5 * (sorted[n / 2] + sorted[(n - 1) / 2]) }
}

/// Median and its standard deviation.
fn signed_median(values: &[f64]) -> (f64, f64) {
    let middle = median(values);
    let away: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    (middle, MEDIAN_OVER_MEAN * SIGMA_OVER_MEDIAN * median(&away) / (values.len() as f64).sqrt())
}

/// Smooth part, what noise alone would make of it, and scatter; `taken` coefficients were fitted before. `NaN` where windows are too few.
fn smooth(places: &DMatrix<f64>, values: &[f64], taken: usize) -> [f64; 3] {
    let n = values.len();
    let d = DVector::from_column_slice(values);
    let solved = (n > TERMS + 1).then(|| (places.transpose() * places).cholesky()).flatten();
    let Some(normal) = solved else { return [f64::NAN; 3] };
    let fitted = places * normal.solve(&(places.transpose() * &d));
    let s2 = (&d - &fitted).norm_squared() / (n - TERMS) as f64;
    let noise2 = (TERMS - taken) as f64 / n as f64 * s2;
    [(fitted.norm_squared() / n as f64 - noise2).max(0.0).sqrt(), noise2.sqrt(), s2.sqrt()]
}

/// Of the windows in use of a map; `refitted` says that its plane has been fitted to them.
pub(super) fn misalignment(map: &DisparityMap, refitted: bool) -> Misalignment {
    let used: Vec<usize> = (0..map.x_mm.len()).filter(|i| map.used[*i]).collect();
    let of = |list: &[f64]| used.iter().map(|i| list[*i]).collect::<Vec<f64>>();
    let (x, y) = (of(&map.x_mm), of(&map.y_mm));
    let span = |l: &[f64]| l.iter().fold(1e-9_f64, |m, v| m.max(v.abs()));
    let (sx, sy) = (span(&x), span(&y));
    let places = DMatrix::from_fn(used.len(), TERMS, |i, k| {
        let (x, y) = (x[i] / sx, y[i] / sy);
        [1.0, x, y, x * x, x * y, y * y][k]
    });
    let across = of(&map.across_px);
    // Depth towards the cameras shifts both images apart against s_2 - s_1.
    let along: Vec<f64> = used
        .iter()
        .map(|i| {
            let length2 = map.dx_px[*i].powi(2) + map.dy_px[*i].powi(2);
            -map.z_mm[*i].signum() * (length2 - map.across_px[*i].powi(2)).max(0.0).sqrt()
        })
        .collect();
    let ((mx, ex), (my, ey)) = (signed_median(&of(&map.dx_px)), signed_median(&of(&map.dy_px)));
    let [a, na, sa] = smooth(&places, &along, if refitted { PLANE } else { 0 });
    let [c, nc, sc] = smooth(&places, &across, 0);
    Misalignment {
        median_px: [mx, my],
        median_sigma_px: [ex, ey],
        smooth_px: [a, c],
        smooth_noise_px: [na, nc],
        scatter_px: [sa, sc],
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::disparity) fn map(f: impl Fn(f64, f64, usize) -> [f64; 2]) -> DisparityMap {
        let mut m = DisparityMap::default();
        for k in 0..400 {
            let (x, y) = (f64::from(k % 20) - 9.5, f64::from(k / 20) - 9.5);
            let [along, across] = f(x, y, k as usize);
            m.x_mm.push(x);
            m.y_mm.push(y);
            // s_2 - s_1 along x.
            m.dx_px.push(along);
            m.dy_px.push(-across);
            m.across_px.push(across);
            m.z_mm.push(-along);
            m.correlation.push(1.0);
            m.peak_ratio.push(9.0);
            m.used.push(true);
        }
        m
    }

    /// Numbers that look like noise: normal, of unit variance.
    pub(in crate::disparity) fn noise(k: usize, salt: u64) -> f64 {
        let mut x = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ salt.wrapping_mul(0xD1B5_4A32_D192_ED03);
        let mut next = || {
            x ^= x >> 31;
            x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
            x ^= x >> 29;
            ((x >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        (-2.0 * next().ln()).sqrt() * (std::f64::consts::TAU * next()).cos()
    }

    #[test]
    fn smooth_parts_stand_out_from_scatter_and_scatter_alone_is_none() {
        let still = misalignment(&map(|_, _, k| [1.0 * noise(k, 1), 0.3 * noise(k, 2)]), false);
        for a in 0..2 {
            assert!((still.scatter_px[a] / [1.0, 0.3][a] - 1.0).abs() < 0.12, "{still:?}");
            assert!(still.smooth_px[a] < 2.5 * still.smooth_noise_px[a], "{still:?}");
            assert!(still.median_px[a].abs() < 4.0 * still.median_sigma_px[a], "{still:?}");
        }
        assert!((still.smooth_noise_px[0] / (6.0_f64 / 400.0).sqrt() - 1.0).abs() < 0.12);
        let off = misalignment(&map(|x, _, k| [0.4 + noise(k, 1), 0.05 * x + 0.3 * noise(k, 2)]), false);
        let wanted = [0.4, 0.05 * (399.0_f64 / 12.0).sqrt()];
        for a in 0..2 {
            assert!((off.smooth_px[a] - wanted[a]).abs() < 3.0 * off.smooth_noise_px[a], "{off:?} {wanted:?}");
        }
        assert!((off.median_px[0] - 0.4).abs() < 4.0 * off.median_sigma_px[0]);
        let few = misalignment(&DisparityMap::default(), true);
        assert!(few.smooth_px[0].is_nan() && few.median_px[0].is_nan());
    }
}
