//! The light along the normal of the sheet, from the correlation of all windows together.
//!
//! Particles at depth z make the cross-correlation high at the shift -z (s_2 - s_1). Summed across that direction, over all windows
//! and pairs, it is the light's profile as the product of both cameras' images sees it (its square), broadened by the particle images:
//! ```text
//! L(z) = sum over |t| <= 2 px of  C(-z (s_2 - s_1) + t across) - baseline,   baseline = median of L beyond half the reach
//! top      = maximum of a parabola through the values above four fifths of the largest
//! middle   = sum z L / sum L over the values above a tenth of the largest that hang together with it
//! ```
//! Both agree for an even-sided profile. Light whose profile is skewed has no one place: its brightest plane and its middle differ.

use super::peak::CorrelationMap;
use crate::record::LightProfile;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Half width of the band that is summed, px.
const BAND_PX: i32 = 2;
/// Part of the maximum above which the top is a parabola.
const TOP: f64 = 0.8;
/// Part of the maximum above which there is light.
const LIGHT: f64 = 0.1;

/// The profile, from the cross-correlation of all windows and what depth moves it by (px per mm, y down); `None` where nothing stands out.
pub(super) fn profile(map: &CorrelationMap, depth_px: Vector2<f64>) -> Option<LightProfile> {
    let along = depth_px.normalize();
    let across = Vector2::new(-along.y, along.x);
    let mm = 1.0 / depth_px.norm();
    // Within the map whatever the direction.
    let reach = map.width.min(map.height) as i32 / 2 - BAND_PX - 3;
    let raw: Vec<f64> = (-2 * reach..=2 * reach)
        .map(|k| {
            let at = along * (-0.5 * f64::from(k));
            (-BAND_PX..=BAND_PX).filter_map(|t| bilinear(map, at + across * f64::from(t))).sum()
        })
        .collect();
    let z = |i: usize| 0.5 * mm * (i as f64 - 2.0 * f64::from(reach));
    let n = raw.len();
    let mut far: Vec<f64> = (0..n).filter(|i| i.abs_diff(n / 2) > n / 4).map(|i| raw[i]).collect();
    far.sort_by(f64::total_cmp);
    let baseline = far.get(far.len() / 2)?;
    let light: Vec<f64> = raw.iter().map(|v| v - baseline).collect();
    let top = (0..n).max_by(|a, b| light[*a].total_cmp(&light[*b]))?;
    let largest = light[top];
    if !(largest > 0.0) {
        return None;
    }
    let hangs = |part: f64| {
        let above = |i: &usize| light[*i] > part * largest;
        let from = (0..=top).rev().take_while(above).last().unwrap_or(top);
        from..=(top..n).take_while(above).last().unwrap_or(top)
    };
    let (sum, moment) = hangs(LIGHT).fold((0.0, 0.0), |(s, m), i| (s + light[i], m + z(i) * light[i]));
    Some(LightProfile {
        z_mm: (0..n).map(z).collect(),
        light: light.iter().map(|l| l / largest).collect(),
        top_mm: parabola_top(hangs(TOP).map(|i| (z(i) - z(top), light[i] / largest))).unwrap_or(0.0) + z(top),
        middle_mm: moment / sum,
    })
}

/// Between four samples; none outside.
pub(super) fn bilinear(map: &CorrelationMap, d: Vector2<f64>) -> Option<f64> {
    let (i, j) = (d.x.floor(), d.y.floor());
    let (s, t) = (d.x - i, d.y - j);
    let at = |di: isize, dj: isize| map.at(i as isize + di, j as isize + dj);
    let row = |dj: isize| Some((1.0 - s) * at(0, dj)? + s * at(1, dj)?);
    Some((1.0 - t) * row(0)? + t * row(1)?)
}

/// Where the parabola by least squares is highest; none where it is not a hill, or its top lies outside.
fn parabola_top(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let (mut n, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (x, y) in points.clone() {
        let row = Vector3::new(1.0, x, x * x);
        n += row * row.transpose();
        b += row * y;
    }
    let c = n.cholesky()?.solve(&b);
    let x = -0.5 * c.y / c.z;
    let (low, high) = points.fold((f64::MAX, f64::MIN), |(l, h), (x, _)| (l.min(x), h.max(x)));
    (c.z < 0.0 && (low..=high).contains(&x)).then_some(x)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Of 64 x 64 px: correlation peaks of particles (variance 2 px^2) spread along the direction of depth by a profile of light, and that of the
    /// particles alone.
    pub(in crate::disparity) fn summed(light: impl Fn(f64) -> f64, depth_px: Vector2<f64>) -> [CorrelationMap; 2] {
        let w = 64;
        let place = |i: usize| Vector2::new((i % w) as f64 - 32.0, (i / w) as f64 - 32.0);
        let mut cross = vec![0.003; w * w];
        for k in -400..=400 {
            let z = 0.005 * f64::from(k);
            for (i, c) in cross.iter_mut().enumerate() {
                *c += light(z) * (-0.25 * (place(i) + z * depth_px).norm_squared()).exp();
            }
        }
        let auto = (0..w * w).map(|i| (-0.25 * place(i).norm_squared()).exp()).collect();
        [cross, auto].map(|values| CorrelationMap { width: w, height: w, values })
    }

    #[test]
    fn top_and_middle_of_the_light_are_found_with_its_skew() {
        for depth_px in [Vector2::new(18.0, 0.0), Vector2::new(2.0, 8.0), Vector2::new(-14.0, -10.0)] {
            let even = |z: f64| (-0.5 * ((z - 0.1) / 0.2).powi(2)).exp();
            let p = profile(&summed(even, depth_px)[0], depth_px).unwrap();
            assert!((p.top_mm - 0.1).abs() < 0.01 && (p.middle_mm - 0.1).abs() < 0.02, "{} {}", p.top_mm, p.middle_mm);
            let skewed = |z: f64| if z > 0.2 { 0.0 } else { ((z - 0.2) / 0.4).exp() };
            let p = profile(&summed(skewed, depth_px)[0], depth_px).unwrap();
            assert!(p.top_mm > -0.05 && p.middle_mm < p.top_mm - 0.05, "{} {}", p.top_mm, p.middle_mm);
        }
    }
}
