//! Three components of many vectors in closed form, for maps that do not change from one pair of images to the next.
//!
//! In the dewarped image of camera c a displacement (u, v, w) of the sheet frame is seen as `d_c = (u, v) - w s_c`, s_c the slope of its
//! ray ([`crate::dewarp`]). Four equations of equal weight for three unknowns:
//! ```text
//! e = s_2 - s_1,   g = d_2 - d_1          g = -w e
//! w = -(g . e) / |e|^2
//! (u, v) = (d_1 + d_2) / 2 + w (s_1 + s_2) / 2
//! residual = |g + w e| / sqrt(2)          root of the sum of squares of what the four equations leave
//! ```
//! With sigma the standard deviation of a component of a planar displacement, `sigma_w = sigma sqrt(2) / |e|` and `sigma_u = sigma sqrt(1/2 + 2 (m_x / |e|)^2)`, m = (s_1 + s_2) / 2.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | s_c | `slopes` | 1 | Sheet | slopes dx/dz, dy/dz of the rays of camera c |
//! | d_c | `planar` | any | Sheet | planar displacement along x and y |
//!
//! To first order in the displacement over the distance; [`super::reconstruct`] is exact. Source: Prasad, Exp. Fluids 29 (2000) 103. Not valid where both
//! cameras look along one line: `NaN`.

use crate::error::{Invalid, Result};
use crate::lanes::{Kernel, Lanes, run};

/// Slopes of the rays, or planar displacements, of both cameras: along x and along y each.
pub type PlanarPair<'a> = [[&'a [f64]; 2]; 2];

/// Displacements in the unit of the planar ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Components {
    /// Along x.
    pub u: Vec<f64>,
    /// Along y.
    pub v: Vec<f64>,
    /// Along z, positive towards the first camera.
    pub w: Vec<f64>,
    /// Root of the sum of squares of what four equations leave.
    pub residual: Vec<f64>,
}

/// Three components of planar displacements, all lists of one length; `out` is made as long.
///
/// ```
/// use spivcal::reconstruct::{Components, three_components};
/// // Cameras under 45 degrees from both sides see (1, 2, 3) as (1 + 3, 2) and (1 - 3, 2).
/// let slopes = [[&[-1.0][..], &[0.0]], [&[1.0], &[0.0]]];
/// let planar = [[&[4.0][..], &[2.0]], [&[-2.0], &[2.0]]];
/// let mut out = Components::default();
/// three_components(slopes, planar, &mut out)?;
/// assert_eq!([out.u[0], out.v[0], out.w[0], out.residual[0]], [1.0, 2.0, 3.0, 0.0]);
/// # Ok::<(), spivcal::Error>(())
/// ```
///
/// # Errors
/// [`Invalid::Value`] where the lists differ in length.
pub fn three_components(slopes: PlanarPair<'_>, planar: PlanarPair<'_>, out: &mut Components) -> Result<()> {
    let lists: Vec<&[f64]> = slopes.iter().chain(&planar).flatten().copied().collect();
    let n = lists[0].len();
    if let Some(l) = lists.iter().find(|l| l.len() != n) {
        let what = format!("lists of one length, as the first with {n}");
        return Err(Invalid::value("number of vectors", l.len() as f64, what).into());
    }
    for list in [&mut out.u, &mut out.v, &mut out.w, &mut out.residual] {
        list.resize(n, 0.0);
    }
    let to = [&mut out.u[..], &mut out.v[..], &mut out.w[..], &mut out.residual[..]];
    run(All { slopes, planar, to });
    Ok(())
}

/// Standard deviations of u, v, w for planar components of standard deviation 1 that are independent; `NaN` where both cameras look along one line.
pub fn component_sigmas(slopes: [[f64; 2]; 2]) -> [f64; 3] {
    let [s1, s2] = slopes;
    let apart = (s2[0] - s1[0]).hypot(s2[1] - s1[1]);
    let by_w = |a: usize| 0.5 * (s1[a] + s2[a]) / apart;
    let in_plane = |a: usize| (0.5 + 2.0 * by_w(a).powi(2)).sqrt();
    if apart > 0.0 { [in_plane(0), in_plane(1), std::f64::consts::SQRT_2 / apart] } else { [f64::NAN; 3] }
}

struct All<'a> {
    slopes: PlanarPair<'a>,
    planar: PlanarPair<'a>,
    to: [&'a mut [f64]; 4],
}

/// Groups whose numbers are read list by list. One group of twelve lists after the other, of lengths that are powers of two, would
/// want more lines of one set of the cache than it has, and read each line anew for the next group.
const TOGETHER: usize = 4;

/// Half the sum and the difference of the same coordinate of both cameras.
#[inline(always)]
fn compared<L: Lanes, const T: usize>(a: &[f64], b: &[f64], first: usize) -> [[L; T]; 2] {
    let [mut x, mut y, mut half] = [[L::splat(0.0); T]; 3];
    for k in 0..T {
        x[k] = L::load(&a[first + k * L::N..]);
    }
    for k in 0..T {
        y[k] = L::load(&b[first + k * L::N..]);
    }
    for k in 0..T {
        half[k] = L::splat(0.5) * (x[k] + y[k]);
        y[k] = y[k] - x[k];
    }
    [half, y]
}

#[inline(always)]
fn put<L: Lanes, const T: usize>(x: [L; T], to: &mut [f64], first: usize) {
    for k in 0..T {
        x[k].store(&mut to[first + k * L::N..]);
    }
}

/// Vectors from number `first` on.
#[inline(always)]
fn solve<L: Lanes, const T: usize>(
    slopes: &PlanarPair<'_>,
    planar: &PlanarPair<'_>,
    to: &mut [&mut [f64]; 4],
    first: usize,
) {
    let [mx, ex] = compared::<L, T>(slopes[0][0], slopes[1][0], first);
    let [my, ey] = compared::<L, T>(slopes[0][1], slopes[1][1], first);
    let [dx, gx] = compared::<L, T>(planar[0][0], planar[1][0], first);
    let [dy, gy] = compared::<L, T>(planar[0][1], planar[1][1], first);
    let [mut u, mut v, mut w, mut residual] = [[L::splat(0.0); T]; 4];
    for k in 0..T {
        // 0 / 0 where both look along one line.
        w[k] = -((gx[k] * ex[k] + gy[k] * ey[k]) / (ex[k] * ex[k] + ey[k] * ey[k]));
        u[k] = dx[k] + w[k] * mx[k];
        v[k] = dy[k] + w[k] * my[k];
        let left = [gx[k] + w[k] * ex[k], gy[k] + w[k] * ey[k]];
        residual[k] = (L::splat(0.5) * (left[0] * left[0] + left[1] * left[1])).sqrt();
    }
    put(u, to[0], first);
    put(v, to[1], first);
    put(w, to[2], first);
    put(residual, to[3], first);
}

impl Kernel for All<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let n = self.slopes[0][0].len();
        let step = TOGETHER * L::N;
        let mut first = 0;
        while first + step <= n {
            solve::<L, TOGETHER>(&self.slopes, &self.planar, &mut self.to, first);
            first += step;
        }
        for i in first..n {
            solve::<f64, 1>(&self.slopes, &self.planar, &mut self.to, i);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::run_all;
    use nalgebra::{SMatrix, SVector, Vector4};

    /// Whole strips of the widest lanes, and a rest.
    const N: usize = 75;

    fn lists(seed: f64) -> Vec<Vec<f64>> {
        (0..4).map(|c| (0..N).map(|i| (seed + 1.7 * i as f64 + 0.9 * f64::from(c)).sin()).collect()).collect()
    }

    #[derive(Clone)]
    struct Bits {
        slopes: Vec<Vec<f64>>,
        planar: Vec<Vec<f64>>,
    }
    impl Kernel for Bits {
        type Output = Vec<Vec<u64>>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<Vec<u64>> {
            let mut out = vec![vec![0.0; N]; 4];
            let (s, p) = (&self.slopes, &self.planar);
            if let [u, v, w, r] = &mut out[..] {
                let all = All {
                    slopes: [[&s[0], &s[1]], [&s[2], &s[3]]],
                    planar: [[&p[0], &p[1]], [&p[2], &p[3]]],
                    to: [u, v, w, r],
                };
                all.run::<L>();
            }
            out.iter().map(|l| l.iter().map(|x| x.to_bits()).collect()).collect()
        }
    }

    /// Against the four equations solved as such, and all widths against each other.
    #[test]
    fn four_equations_are_solved_and_all_widths_agree() {
        let (slopes, planar) = (lists(0.3), lists(4.0));
        let all = run_all(&Bits { slopes: slopes.clone(), planar: planar.clone() });
        all.iter().for_each(|one| assert_eq!(*one, all[0]));
        for i in 0..N {
            let mut a = SMatrix::<f64, 4, 3>::zeros();
            let mut b = Vector4::zeros();
            for row in 0..4 {
                a[(row, row % 2)] = 1.0;
                a[(row, 2)] = -slopes[row][i];
                b[row] = planar[row][i];
            }
            let x = (a.transpose() * a).try_inverse().unwrap() * a.transpose() * b;
            let left: SVector<f64, 4> = a * x - b;
            let sigmas = component_sigmas([0, 1].map(|c| [0, 1].map(|k| slopes[2 * c + k][i])));
            let inverse = (a.transpose() * a).try_inverse().unwrap();
            for k in 0..3 {
                assert!((sigmas[k] / inverse[(k, k)].sqrt() - 1.0).abs() < 1e-9, "{i}: {sigmas:?} {inverse}");
            }
            let got = [0, 1, 2, 3].map(|k| f64::from_bits(all[0][k][i]));
            for k in 0..3 {
                assert!((got[k] - x[k]).abs() < 1e-10 * (1.0 + x.norm()), "{i}: {got:?} {x}");
            }
            assert!((got[3] - left.norm()).abs() < 1e-10 * (1.0 + x.norm()), "{i}: {got:?} {left}");
        }
        let mut out = Components::default();
        let p = |l: &'static [f64]| [[l, l], [l, l]];
        three_components(p(&[0.5]), p(&[1.0]), &mut out).unwrap();
        assert!(out.w[0].is_nan() && out.u[0].is_nan(), "both look along one line");
        assert!(component_sigmas([[0.5, 0.5]; 2]).iter().all(|s| s.is_nan()));
        let mut short = p(&[0.5]);
        short[1][1] = &[];
        assert!(three_components(short, p(&[1.0]), &mut out).is_err());
    }
}
