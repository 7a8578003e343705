//! The map as a polynomial, for programs that read nothing else.
//!
//! ```text
//! u = sum a_ijk X^i Y^j Z^k,   v = sum b_ijk X^i Y^j Z^k,   i + j + k <= n,   k <= m
//! X = (x - x0) / hx,  Y = (y - y0) / hy,  Z = (z - z0) / hz                  -1 to 1 in the volume of the fit
//! ```
//! n = 3, m = 2 are the 19 terms of Soloff. Fitted by least squares to the exact map at Chebyshev nodes of the volume, which
//! keeps the largest departure close to the least possible; what is left is measured at other points and reported.
//! The polynomial is worth nothing outside its volume.
//!
//! Source: Soloff, Adrian, Liu, Meas. Sci. Technol. 8 (1997) 1441, eq 17.

use super::map::{PixelJets, SheetMap};
use crate::error::{Insufficient, Invalid, Result, same_length};
use nalgebra::{DMatrix, Matrix2x3, Vector2, Vector3};

/// Nodes of the fit along x, y, z.
const NODES: [usize; 3] = [24, 24, 7];
/// Points at which the departure is measured, along x, y, z; no multiple of the nodes.
const PROBES: [usize; 3] = [37, 37, 5];

/// Degrees of the polynomial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SoloffDegrees {
    /// Highest total degree, 2 or 3.
    pub xy: usize,
    /// Highest power of z, 1 or 2.
    pub z: usize,
}

impl Default for SoloffDegrees {
    /// Soloff's own: 3 and 2.
    fn default() -> Self {
        Self { xy: 3, z: 2 }
    }
}

/// The volume in which a polynomial stands for the map: middle and half widths, sheet frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoloffVolume {
    /// Middle (x, y, z), mm.
    pub middle_mm: [f64; 3],
    /// Half width along x, y, z, mm.
    pub half_mm: [f64; 3],
}

/// The polynomial map of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Soloff {
    degrees: SoloffDegrees,
    volume: SoloffVolume,
    /// Powers (i, j, k) of each term.
    powers: Vec<[usize; 3]>,
    /// Coefficients of u and v for each term, px.
    coefficients_px: Vec<[f64; 2]>,
}

/// A polynomial and how far it is from the exact map.
#[derive(Debug, Clone, PartialEq)]
pub struct SoloffFit {
    /// The polynomial.
    pub map: Soloff,
    /// Root mean square distance from the exact map over the volume, px.
    pub rms_px: f64,
    /// Largest distance found over the volume, px.
    pub largest_px: f64,
}

/// Powers of all terms, in the order x fastest.
fn powers(d: SoloffDegrees) -> Vec<[usize; 3]> {
    let mut out = vec![];
    for k in 0..=d.z {
        for j in 0..=d.xy - k {
            out.extend((0..=d.xy - k - j).map(|i| [i, j, k]));
        }
    }
    out
}

/// Value and slopes of one term.
fn term(p: &[usize; 3], s: &[f64; 3]) -> (f64, [f64; 3]) {
    let f = |a: usize| s[a].powi(p[a] as i32);
    let g = |a: usize| if p[a] == 0 { 0.0 } else { p[a] as f64 * s[a].powi(p[a] as i32 - 1) };
    (f(0) * f(1) * f(2), [g(0) * f(1) * f(2), f(0) * g(1) * f(2), f(0) * f(1) * g(2)])
}

impl SoloffVolume {
    /// The point at scaled coordinates, -1 to 1.
    fn point_mm(&self, s: [f64; 3]) -> Vector3<f64> {
        Vector3::from_fn(|a, _| self.middle_mm[a] + self.half_mm[a] * s[a])
    }
    /// All points with scaled coordinates from `along(axis, index)`.
    fn lattice(&self, counts: [usize; 3], along: impl Fn(usize, usize) -> f64) -> Vec<[f64; 3]> {
        let mut out = Vec::with_capacity(counts.iter().product());
        for k in 0..counts[2] {
            for j in 0..counts[1] {
                out.extend((0..counts[0]).map(|i| [along(0, i), along(1, j), along(2, k)]));
            }
        }
        out
    }
}

impl Soloff {
    /// The polynomial nearest to the exact map over a volume.
    ///
    /// # Errors
    /// [`Invalid::Value`] for other degrees or a volume without extent; [`Insufficient::Degenerate`] where the camera does not
    /// see the whole volume.
    pub fn fit(map: &SheetMap, volume: SoloffVolume, degrees: SoloffDegrees) -> Result<SoloffFit> {
        if !(2..=3).contains(&degrees.xy) || !(1..=2).contains(&degrees.z) {
            let (name, value) = if (2..=3).contains(&degrees.xy) { ("z", degrees.z) } else { ("x and y", degrees.xy) };
            return Err(
                Invalid::value(format!("degree in {name}"), value as f64, "2 or 3 in x and y, 1 or 2 in z").into()
            );
        }
        if let Some(h) = volume.half_mm.iter().find(|h| !(**h > 0.0 && h.is_finite())) {
            return Err(
                Invalid::value("half width of the volume", *h, "a positive length in mm along x, y and z").into()
            );
        }
        let node = |a: usize, i: usize| -(std::f64::consts::PI * (i as f64 + 0.5) / NODES[a] as f64).cos();
        let nodes = volume.lattice(NODES, node);
        let powers = powers(degrees);
        let seen = |s: &[f64; 3]| {
            map.project(&volume.point_mm(*s)).ok_or_else(|| {
                let p = volume.point_mm(*s);
                Insufficient::Degenerate(format!(
                    "the camera does not see the point ({:.3}, {:.3}, {:.3}) mm of the volume; choose a smaller one",
                    p.x, p.y, p.z
                ))
            })
        };
        let mut images = DMatrix::zeros(nodes.len(), 2);
        for (i, s) in nodes.iter().enumerate() {
            images.set_row(i, &seen(s)?.transpose());
        }
        let design = DMatrix::from_fn(nodes.len(), powers.len(), |i, t| term(&powers[t], &nodes[i]).0);
        // Scaled to -1 to 1 at Chebyshev nodes the terms are nearly orthogonal: the normal equations lose nothing.
        let Some(normal) = (design.transpose() * &design).cholesky() else {
            return Err(crate::Error::Bug("the terms of the polynomial map depend on one another".into()));
        };
        let solved = normal.solve(&(design.transpose() * images));
        let coefficients_px = solved.row_iter().map(|r| [r[0], r[1]]).collect();
        let fitted = Soloff { degrees, volume, powers, coefficients_px };
        let probe = |a: usize, i: usize| 2.0 * i as f64 / (PROBES[a] - 1) as f64 - 1.0;
        let (mut sum, mut largest) = (0.0_f64, 0.0_f64);
        let probes = volume.lattice(PROBES, probe);
        for s in &probes {
            let d2 = (fitted.at(s).0 - seen(s)?).norm_squared();
            sum += d2;
            largest = largest.max(d2);
        }
        Ok(SoloffFit { map: fitted, rms_px: (sum / probes.len() as f64).sqrt(), largest_px: largest.sqrt() })
    }

    /// Degrees of the polynomial.
    pub fn degrees(&self) -> SoloffDegrees {
        self.degrees
    }
    /// Volume in which it holds, and which scales its coordinates.
    pub fn volume(&self) -> &SoloffVolume {
        &self.volume
    }
    /// Powers (i, j, k) of X, Y, Z with the coefficients of u and v, px.
    pub fn terms(&self) -> impl Iterator<Item = ([usize; 3], [f64; 2])> + '_ {
        self.powers.iter().copied().zip(self.coefficients_px.iter().copied())
    }

    /// Image and its derivative by the scaled coordinates.
    fn at(&self, s: &[f64; 3]) -> (Vector2<f64>, Matrix2x3<f64>) {
        let (mut q, mut d) = (Vector2::zeros(), Matrix2x3::zeros());
        for (p, c) in self.powers.iter().zip(&self.coefficients_px) {
            let (value, slopes) = term(p, s);
            let c = Vector2::from(*c);
            q += c * value;
            for a in 0..3 {
                let mut column = d.column_mut(a);
                column += c * slopes[a];
            }
        }
        (q, d)
    }

    /// Images of points of the sheet frame with their derivatives, px and px per mm.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn pixel_of_sheet_jets(&self, x_mm: &[f64], y_mm: &[f64], z_mm: &[f64]) -> Result<PixelJets> {
        same_length("points", x_mm.len(), &[y_mm, z_mm])?;
        let (middle, half) = (&self.volume.middle_mm, &self.volume.half_mm);
        let mut out = PixelJets::default();
        for i in 0..x_mm.len() {
            let p = [x_mm[i], y_mm[i], z_mm[i]];
            let (q, d) = self.at(&[0, 1, 2].map(|a| (p[a] - middle[a]) / half[a]));
            out.push((q, Matrix2x3::from_fn(|row, a| d[(row, a)] / half[a])));
        }
        Ok(out)
    }

    /// Where the polynomial puts pixels in the plane z = `z_mm`: Newton's iteration from the middle of the volume; `NaN` where
    /// it does not arrive within three times the volume.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn sheet_of_pixel(&self, u_px: &[f64], v_px: &[f64], z_mm: &[f64]) -> Result<super::SheetPoints> {
        same_length("pixels", u_px.len(), &[v_px, z_mm])?;
        let mut out = super::SheetPoints::default();
        for i in 0..u_px.len() {
            let scaled_z = (z_mm[i] - self.volume.middle_mm[2]) / self.volume.half_mm[2];
            let found = self.invert(&Vector2::new(u_px[i], v_px[i]), scaled_z).unwrap_or(Vector2::repeat(f64::NAN));
            out.x_mm.push(self.volume.middle_mm[0] + self.volume.half_mm[0] * found.x);
            out.y_mm.push(self.volume.middle_mm[1] + self.volume.half_mm[1] * found.y);
        }
        Ok(out)
    }

    fn invert(&self, q: &Vector2<f64>, scaled_z: f64) -> Option<Vector2<f64>> {
        let mut s = Vector2::zeros();
        for _ in 0..50 {
            let (at, d) = self.at(&[s.x, s.y, scaled_z]);
            let step = d.fixed_columns::<2>(0).into_owned().try_inverse()? * (q - at);
            s += step;
            if !(s.amax() < 3.0) {
                return None;
            }
            if step.amax() < 1e-13 {
                return Some(s);
            }
        }
        None
    }
}
