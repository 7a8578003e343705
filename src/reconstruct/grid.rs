//! A planar field on its regular grid, read between its vectors.
//!
//! Windows that overlap by the part o see the same particles as far: errors of vectors i columns and j rows apart have the correlation
//! ```text
//! rho_ij = max(0, 1 - (1 - o) |i|) max(0, 1 - (1 - o) |j|)
//! d = sum_p c_p d_p,    var d = sum_pq c_p c_q rho_pq s_p s_q
//! ```
//! of which the mean of the s_p^2, weighted by c_p^2, is taken out of the double sum: neighbours are about as good.
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | o | `overlap` | 1 | part of a window that its neighbour shares |
//! | c | weights | 1 | of the interpolation |
//! | s | `sigmas` | unit of the field | standard deviation of a vector |

use super::read::FieldTable;
use crate::error::{Error, Invalid, Result};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Part of a spacing by which positions may be off the grid (exports round them).
const OFF_GRID: f64 = 0.1;
/// Gaps of less than this part of the largest are rounding.
const ROUNDED: f64 = 5e-3;
/// Vectors among the sixteen around that a local plane needs.
const FEWEST_AROUND: usize = 6;
/// Part of a window that its neighbour shares, where nobody says it: what PIV programs begin with.
pub const OVERLAP: f64 = 0.5;
/// Range of the weights of a local plane, spacings.
const NEAR: f64 = 0.8;

/// A displacement field on a regular grid; vectors may be missing.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarField {
    /// First position along x and y.
    pub(super) origin: [f64; 2],
    /// Spacing along x and y.
    pub(super) spacing: [f64; 2],
    /// Positions along x and y.
    pub(super) count: [usize; 2],
    /// Rows packed; none where missing.
    vectors: Vec<Option<Vector2<f64>>>,
    /// Standard deviations of the vectors, where the file has them.
    sigmas: Option<Vec<Vector2<f64>>>,
    /// Part of a window that its neighbour shares.
    overlap: f64,
    /// File in messages.
    pub(super) file: String,
}

/// A vector between those of the grid.
pub(super) struct Between {
    pub(super) vector: Vector2<f64>,
    /// Variance of the interpolated over that of a measured vector.
    pub(super) variance: f64,
    /// Standard deviations along the axes of the field, where the file has those of the vectors.
    pub(super) sigma: Option<Vector2<f64>>,
    /// Whether neighbours were missing and the order had to be lowered.
    pub(super) lowered: bool,
    /// Squared change from one vector to the next, summed over both axes, unit of the field squared.
    pub(super) unevenness: f64,
}

fn not_a_grid(table: &FieldTable, message: String) -> Error {
    Invalid::File { path: table.file.clone(), message }.into()
}

/// First value, spacing and count of the distinct values of a coordinate.
fn axis(table: &FieldTable, name: &str, values: &[f64]) -> Result<(f64, f64, usize)> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    // One position far off makes one or two large gaps, which say nothing of the spacing; rounding makes tiny ones.
    let largest = gaps.last().copied().unwrap_or(0.0);
    let third = gaps.len().checked_sub(3).map_or(largest, |i| gaps[i]);
    let typical = if third > ROUNDED * largest { third } else { largest };
    gaps.retain(|g| *g > OFF_GRID * typical);
    let (Some(middle), Some(last)) = (gaps.get(gaps.len() / 2).copied().filter(|g| *g > 0.0), sorted.last()) else {
        let what = format!("all vectors have the same {name}: a field needs at least two rows and two columns");
        return Err(not_a_grid(table, what));
    };
    // Positions are rounded: the spacing over the whole width is the better one.
    let steps = ((last - sorted[0]) / middle).round().max(1.0);
    let spacing = (last - sorted[0]) / steps;
    // Each step of a column has a vector, but for holes.
    if !(spacing > 0.0 && steps <= (4 * values.len() + 16) as f64) {
        let what = format!(
            "the positions do not form a regular grid: {name} runs from {} to {last} in {steps} steps of {middle}, with {} vectors; export the field on \
             its grid",
            sorted[0],
            values.len()
        );
        return Err(not_a_grid(table, what));
    }
    if let Some(off) = values
        .iter()
        .find(|v| (((**v - sorted[0]) / spacing).round() * spacing + sorted[0] - **v).abs() > OFF_GRID * spacing)
    {
        let what = format!(
            "the positions do not form a regular grid: {name} = {off} lies between columns or rows {spacing:.4} apart; export the field on its grid"
        );
        return Err(not_a_grid(table, what));
    }
    Ok((sorted[0], spacing, steps as usize + 1))
}

impl PlanarField {
    /// The field of a table.
    ///
    /// # Errors
    /// [`Invalid::File`] where the positions do not form a regular grid or one occurs twice.
    pub fn new(table: &FieldTable) -> Result<Self> {
        let (x0, sx, nx) = axis(table, "x", &table.x)?;
        let (y0, sy, ny) = axis(table, "y", &table.y)?;
        let n = table.x.len();
        // A scatter of points would fill a vast grid with holes.
        if nx.saturating_mul(ny) > 4 * n + 16 {
            let what = format!(
                "{n} positions on {nx} columns and {ny} rows are no grid; export the field on its regular grid"
            );
            return Err(not_a_grid(table, what));
        }
        let mut vectors = vec![None; nx * ny];
        let mut sigmas = table.sigma.as_ref().map(|_| vec![Vector2::repeat(f64::NAN); nx * ny]);
        let mut seen = vec![false; nx * ny];
        for i in 0..n {
            let column = ((table.x[i] - x0) / sx).round() as usize;
            let row = ((table.y[i] - y0) / sy).round() as usize;
            let at = row * nx + column;
            if seen[at] {
                let what = format!(
                    "two vectors at x = {}, y = {}; a file must hold one field of one moment",
                    table.x[i], table.y[i]
                );
                return Err(not_a_grid(table, what));
            }
            seen[at] = true;
            if let (Some(to), Some([sx, sy])) = (&mut sigmas, &table.sigma) {
                to[at] = Vector2::new(sx[i], sy[i]);
            }
            vectors[at] = table.dx[i].is_finite().then(|| Vector2::new(table.dx[i], table.dy[i]));
        }
        let (origin, spacing, count) = ([x0, y0], [sx, sy], [nx, ny]);
        Ok(Self { origin, spacing, count, vectors, sigmas, overlap: OVERLAP, file: table.file.clone() })
    }

    /// The same field of windows that share this part with their neighbours; half of it ([`OVERLAP`]) is assumed where it is not said.
    ///
    /// # Errors
    /// [`Invalid::Value`] below 0, and from 1 on.
    pub fn overlapping(self, overlap: f64) -> Result<Self> {
        if !(0.0..1.0).contains(&overlap) {
            let what = "a part of a window: 0 (windows beside each other) or more, and less than 1; 0.5 for windows of 32 px every 16 px";
            return Err(Invalid::value("overlap", overlap, what).into());
        }
        Ok(Self { overlap, ..self })
    }

    /// Correlation of the errors of windows so many columns or rows apart.
    fn alike(&self, lag: usize) -> f64 {
        (1.0 - (1.0 - self.overlap) * lag as f64).max(0.0)
    }

    /// Vectors that are there, and places of the grid.
    pub fn filled(&self) -> (usize, usize) {
        (self.vectors.iter().filter(|v| v.is_some()).count(), self.vectors.len())
    }

    /// Positions of the vectors that are there.
    pub(super) fn positions(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let filled = (0..self.vectors.len()).filter(|i| self.vectors[*i].is_some());
        filled.map(|i| {
            [0, 1].map(|a| self.origin[a] + self.spacing[a] * [i % self.count[0], i / self.count[0]][a] as f64)
        })
    }

    /// Whether the file has standard deviations.
    pub(super) fn has_sigmas(&self) -> bool {
        self.sigmas.is_some()
    }

    /// The standard deviations of all vectors that are there.
    pub(super) fn stated(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let all = self.sigmas.iter().flatten().zip(&self.vectors);
        all.filter(|(_, v)| v.is_some()).map(|(s, _)| *s)
    }

    /// Variances of a vector that is there; none where the file has none.
    fn variances(&self, column: isize, row: isize) -> Option<Vector2<f64>> {
        let at = row * self.count[0] as isize + column;
        self.sigmas.as_ref().map(|s| s[at as usize].map(|x| x * x))
    }

    /// `[x_min, y_min, x_max, y_max]` of the positions.
    pub(super) fn extent(&self) -> [f64; 4] {
        let end = [0, 1].map(|a| self.origin[a] + self.spacing[a] * (self.count[a] - 1) as f64);
        [self.origin[0], self.origin[1], end[0], end[1]]
    }

    fn vector(&self, column: isize, row: isize) -> Option<Vector2<f64>> {
        let [nx, ny] = self.count.map(|n| n as isize);
        if (0..nx).contains(&column) && (0..ny).contains(&row) {
            self.vectors[(row * nx + column) as usize]
        } else {
            None
        }
    }

    /// The displacement at a place: cubic where the sixteen vectors around it are there, else linear from four, else a
    /// plane through those that are left.
    pub(super) fn at(&self, x: f64, y: f64) -> Option<Between> {
        let s = [(x - self.origin[0]) / self.spacing[0], (y - self.origin[1]) / self.spacing[1]];
        // On a grid point nothing is interpolated; rounding must not ask for neighbours.
        let snapped = s.map(|s| if (s - s.round()).abs() < 1e-6 { s.round() } else { s });
        let base = snapped.map(|s| s.floor() as isize);
        let t = [snapped[0] - base[0] as f64, snapped[1] - base[1] as f64];
        let cubic = |t: f64| {
            [
                t * (-0.5 + t * (1.0 - 0.5 * t)),
                1.0 + t * t * (1.5 * t - 2.5),
                t * (0.5 + t * (2.0 - 1.5 * t)),
                t * t * (0.5 * t - 0.5),
            ]
        };
        let linear = |t: f64| [0.0, 1.0 - t, t, 0.0];
        for (order, weights) in [(0, t.map(cubic)), (1, t.map(linear))] {
            if let Some((vector, variance, sigma)) = self.weighted(base, &weights) {
                let unevenness = self.unevenness(base, t);
                return Some(Between { vector, variance, sigma, lowered: order == 1, unevenness });
            }
        }
        let inside = (0..2).all(|a| snapped[a] >= 0.0 && snapped[a] <= (self.count[a] - 1) as f64);
        if inside { self.local_plane(base, t) } else { None }
    }

    /// A plane through the vectors that are left among the sixteen around, near ones counting more; none where fewer than
    /// [`FEWEST_AROUND`] are left or they lie to one side.
    fn local_plane(&self, base: [isize; 2], t: [f64; 2]) -> Option<Between> {
        let mut around = vec![];
        let mut normal = Matrix3::zeros();
        for j in -1..3 {
            for i in -1..3 {
                let Some(v) = self.vector(base[0] + i, base[1] + j) else { continue };
                let (x, y) = (i as f64 - t[0], j as f64 - t[1]);
                let weight = (-(x * x + y * y) / (2.0 * NEAR * NEAR)).exp();
                let row = Vector3::new(1.0, x, y);
                normal += row * row.transpose() * weight;
                around.push((v, row, weight, self.variances(base[0] + i, base[1] + j)));
            }
        }
        if around.len() < FEWEST_AROUND {
            return None;
        }
        let first = normal.cholesky()?.solve(&Vector3::x());
        let parts: Vec<f64> = around.iter().map(|(_, row, weight, _)| weight * first.dot(row)).collect();
        let squares = parts.iter().map(|p| p * p).sum::<f64>();
        let (mut vector, mut variance, mut own) = (Vector2::zeros(), 0.0, Vector2::zeros());
        for ((v, row, _, variances), part) in around.iter().zip(&parts) {
            vector += v * *part;
            own += variances.unwrap_or_default() * (part * part);
            for ((_, other, _, _), part_of_other) in around.iter().zip(&parts) {
                let [i, j] = [1, 2].map(|a| (row[a] - other[a]).abs().round() as usize);
                variance += part * part_of_other * self.alike(i) * self.alike(j);
            }
        }
        let sigma = self.sigmas.as_ref().map(|_| own.map(|own| (variance * own / squares).sqrt()));
        let unevenness = self.unevenness(base, t);
        // As much as a measured vector's variance, were errors independent: extrapolated from one side.
        (squares < 1.0).then_some(Between { vector, variance, sigma, lowered: true, unevenness })
    }

    /// Squared change per vector about the nearest vector: half that from one neighbour to the other, or that to the one that is there.
    fn unevenness(&self, base: [isize; 2], t: [f64; 2]) -> f64 {
        let [i, j] = [0, 1].map(|a| base[a] + isize::from(t[a] >= 0.5));
        let change = |di: isize, dj: isize| {
            let (before, here, after) = (self.vector(i - di, j - dj), self.vector(i, j), self.vector(i + di, j + dj));
            match (before, here, after) {
                (Some(b), _, Some(a)) => 0.25 * (a - b).norm_squared(),
                (Some(b), Some(h), None) => (h - b).norm_squared(),
                (None, Some(h), Some(a)) => (a - h).norm_squared(),
                _ => 0.0,
            }
        };
        change(1, 0) + change(0, 1)
    }

    /// Variance of a sum along one axis.
    fn along(&self, w: &[f64; 4]) -> f64 {
        let pairs = (0..4).flat_map(|i| (0..4).map(move |j| (i, j)));
        pairs.map(|(i, j): (usize, usize)| w[i] * w[j] * self.alike(i.abs_diff(j))).sum()
    }

    fn weighted(&self, base: [isize; 2], w: &[[f64; 4]; 2]) -> Option<(Vector2<f64>, f64, Option<Vector2<f64>>)> {
        let (mut sum, mut squares, mut own) = (Vector2::zeros(), 0.0, Vector2::zeros());
        for (j, wy) in w[1].iter().enumerate().filter(|(_, w)| **w != 0.0) {
            for (i, wx) in w[0].iter().enumerate().filter(|(_, w)| **w != 0.0) {
                let at = [base[0] + i as isize - 1, base[1] + j as isize - 1];
                sum += self.vector(at[0], at[1])? * (wx * wy);
                squares += (wx * wy).powi(2);
                own += self.variances(at[0], at[1]).unwrap_or_default() * (wx * wy).powi(2);
            }
        }
        let variance = self.along(&w[0]) * self.along(&w[1]);
        Some((sum, variance, self.sigmas.as_ref().map(|_| own.map(|own| (variance * own / squares).sqrt()))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::parse_field;

    fn field(f: impl Fn(f64, f64) -> Option<(f64, f64)>) -> PlanarField {
        let mut text = "x_px,y_px,dx_px,dy_px\n".to_string();
        for j in 0..9 {
            for i in 0..8 {
                let (x, y) = (10.0 + 16.0 * f64::from(i), 5.0 + 12.0 * f64::from(j));
                match f(x, y) {
                    Some((a, b)) => text.push_str(&format!("{x},{y},{a},{b}\n")),
                    None => text.push_str(&format!("{x},{y},nan,nan\n")),
                }
            }
        }
        PlanarField::new(&parse_field(&text, "f").unwrap()).unwrap()
    }

    /// Positions so far apart that their distance is no number, or that no file holds as many steps.
    #[test]
    fn positions_without_a_spacing_are_no_grid() {
        for far in [0.8e308, 1e12, 1e9] {
            let places = [-2.125 * far, -far, 0.0, far, 2.125 * far, 1.0, 2.0];
            let rows: Vec<String> =
                places.iter().flat_map(|x| [0, 1].map(|y| format!("{x:e},{y},0.1,0.2\n"))).collect();
            let text = format!("x_mm,y_mm,dx_mm,dy_mm\n{}", rows.concat());
            let error = PlanarField::new(&parse_field(&text, "f").unwrap()).unwrap_err().to_string();
            assert!(error.contains("grid") || error.contains("two vectors"), "{far}: {error}");
        }
    }

    #[test]
    fn quadratic_fields_are_met_between_the_vectors_and_holes_lower_the_order() {
        let f = |x: f64, y: f64| (1.0 + 0.01 * x + 1e-4 * x * y, 2.0 - 3e-4 * y * y);
        let whole = field(|x, y| Some(f(x, y)));
        for (x, y) in [(40.0, 33.0), (61.7, 50.2), (58.0, 41.0)] {
            let b = whole.at(x, y).unwrap();
            assert!((b.vector - Vector2::new(f(x, y).0, f(x, y).1)).norm() < 1e-12 && !b.lowered);
            assert!(b.variance <= 1.0 + 1e-12);
        }
        assert_eq!(whole.at(58.0, 41.0).unwrap().variance, 1.0);
        // A hole two columns away: linear, and wrong by the curvature alone.
        let holed = field(|x, y| (x != 90.0 || y != 41.0).then(|| f(x, y)));
        let b = holed.at(61.7, 50.2).unwrap();
        assert!(b.lowered && (b.vector.y - f(61.7, 50.2).1).abs() < 3e-4 * 144.0 / 8.0 * 2.0);
        for (x, y) in [(91.0, 42.0), (90.0, 41.0)] {
            let b = holed.at(x, y).unwrap();
            assert!(b.lowered && (b.vector - Vector2::new(f(x, y).0, f(x, y).1)).norm() < 0.15, "{}", b.vector);
        }
        assert!(holed.at(500.0, 41.0).is_none() && holed.at(9.0, 41.0).is_none());
        let half = field(|x, y| (x < 50.0).then(|| f(x, y)));
        assert!(half.at(45.0, 41.0).is_none() || half.at(45.0, 41.0).unwrap().lowered);
        assert!(half.at(70.0, 41.0).is_none());
        assert_eq!(holed.filled(), (71, 72));
    }

    #[test]
    fn what_windows_share_does_not_average_out() {
        let whole = field(|x, y| Some((x, y)));
        assert!(
            (whole.at(40.0, 33.0).unwrap().variance
                - whole.clone().overlapping(0.5).unwrap().at(40.0, 33.0).unwrap().variance)
                .abs()
                < 1e-15
        );
        // In the middle of four, by hand: c = (-1, 9, 9, -1) / 16 along either axis.
        let c = [-1.0, 9.0, 9.0, -1.0].map(|c: f64| c / 16.0);
        let middle = (10.0 + 2.5 * 16.0, 5.0 + 4.5 * 12.0);
        for overlap in [0.0, 0.25, 0.5, 0.75, 0.9] {
            let rho = |k: f64| (1.0 - (1.0 - overlap) * k).max(0.0);
            let one = (c.map(|c| c * c).iter().sum::<f64>())
                + 2.0
                    * (rho(1.0) * (2.0 * c[0] * c[1] + c[1] * c[2])
                        + rho(2.0) * 2.0 * c[0] * c[2]
                        + rho(3.0) * c[0] * c[3]);
            let found = whole.clone().overlapping(overlap).unwrap().at(middle.0, middle.1).unwrap().variance;
            assert!((found - one * one).abs() < 1e-12, "{overlap}: {found} {}", one * one);
        }
        for wrong in [-0.1, 1.0, f64::NAN] {
            assert!(whole.clone().overlapping(wrong).unwrap_err().to_string().contains("overlap"));
        }
        // A plane through what is left says as much of four windows that are one.
        let holed = field(|x, y| (x != 90.0 || y != 41.0).then_some((x, y)));
        let [apart, near] =
            [0.0, 0.999].map(|o| holed.clone().overlapping(o).unwrap().at(91.0, 42.0).unwrap().variance);
        assert!(apart < 0.7 && (near - 1.0).abs() < 0.02, "{apart} {near}");
    }

    #[test]
    fn what_is_no_grid_is_refused() {
        let of = |text: &str| PlanarField::new(&parse_field(text, "f.csv").unwrap()).unwrap_err().to_string();
        let head = "x_px,y_px,dx_px,dy_px\n";
        assert!(of(&format!("{head}0,0,1,1\n1,0,1,1\n2,0,1,1\n")).contains("same y"));
        assert!(
            of(&format!("{head}0,0,1,1\n10,0,1,1\n0,10,1,1\n0,10,2,2\n10,10,1,1\n"))
                .contains("two vectors at x = 0, y = 10")
        );
        assert!(of(&format!("{head}0,0,1,1\n10,0,1,1\n20,0,1,1\n4,10,1,1\n30,10,1,1\n")).contains("regular grid"));
    }
}
