//! Positions and shapes of candidate dots, and who is near whom.

use crate::detect::Detection;
use crate::stats;
use nalgebra::{Matrix2, Vector2};

/// Candidate dots, structure of arrays; entry k is disc k of the detection.
pub(super) struct Dots {
    pub(super) at: Vec<Vector2<f64>>,
    /// Shape matrix of each ellipse, px^2.
    pub(super) shape: Vec<Matrix2<f64>>,
    /// Inverse square root of the median shape of the neighbourhood: takes the foreshortening out.
    pub(super) round: Vec<Matrix2<f64>>,
    bins: Bins,
}

/// How many neighbours the local shape is the median of: enough to outvote stray blobs and large marks.
const MEDIAN_OF: usize = 9;

impl Dots {
    pub(super) fn new(detection: &Detection) -> Self {
        let at: Vec<_> =
            detection.discs.iter().map(|d| Vector2::new(d.ellipse.center_px.u_px, d.ellipse.center_px.v_px)).collect();
        let shape: Vec<_> = detection
            .discs
            .iter()
            .map(|d| {
                let (s, c) = d.ellipse.angle_rad.sin_cos();
                let r = Matrix2::new(c, -s, s, c);
                let (a, b) = (d.ellipse.semi_major_px, d.ellipse.semi_minor_px);
                r * Matrix2::new(a * a, 0.0, 0.0, b * b) * r.transpose()
            })
            .collect();
        let bins = Bins::new(&at);
        let round = (0..at.len())
            .map(|i| {
                let near = bins.nearest(&at, &at[i], MEDIAN_OF);
                let median = |get: fn(&Matrix2<f64>) -> f64| median(near.iter().map(|k| get(&shape[*k])).collect());
                let m12 = median(|m| m.m12);
                let m = Matrix2::new(median(|m| m.m11), m12, m12, median(|m| m.m22));
                inverse_square_root(&m).or_else(|| inverse_square_root(&shape[i])).unwrap_or_else(Matrix2::identity)
            })
            .collect();
        Self { at, shape, round, bins }
    }
    pub(super) fn len(&self) -> usize {
        self.at.len()
    }
    /// Radius of the circle of equal area, px.
    pub(super) fn radius(&self, i: usize) -> f64 {
        self.shape[i].determinant().max(0.0).powf(0.25)
    }
    /// The `count` dots nearest to `p`, nearest first (a dot at `p` itself included).
    pub(super) fn nearest(&self, p: &Vector2<f64>, count: usize) -> Vec<usize> {
        self.bins.nearest(&self.at, p, count)
    }
    /// Dots within `radius` of `p`.
    pub(super) fn within(&self, p: &Vector2<f64>, radius: f64) -> Vec<usize> {
        self.bins.within(&self.at, p, radius)
    }
}

/// Median; 0 for nothing.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    stats::median(&mut values).unwrap_or(0.0)
}

fn inverse_square_root(m: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let e = m.symmetric_eigen();
    let ok = e.eigenvalues.iter().all(|x| x.is_finite() && *x > 0.0);
    ok.then(|| {
        e.eigenvectors * Matrix2::from_diagonal(&e.eigenvalues.map(|x| 1.0 / x.sqrt())) * e.eigenvectors.transpose()
    })
}

/// Square bins over the bounding box, about two dots each.
struct Bins {
    origin: Vector2<f64>,
    size: f64,
    columns: usize,
    rows: usize,
    items: Vec<Vec<usize>>,
}

impl Bins {
    fn new(at: &[Vector2<f64>]) -> Self {
        let mut low = Vector2::new(f64::INFINITY, f64::INFINITY);
        let mut high = -low;
        for p in at {
            low = low.inf(p);
            high = high.sup(p);
        }
        if at.is_empty() {
            (low, high) = (Vector2::zeros(), Vector2::zeros());
        }
        let span = high - low;
        let size = (2.0 * (span.x + 1.0) * (span.y + 1.0) / at.len().max(1) as f64).sqrt().max(1.0);
        let (columns, rows) = ((span.x / size) as usize + 1, (span.y / size) as usize + 1);
        let mut bins = Self { origin: low, size, columns, rows, items: vec![Vec::new(); columns * rows] };
        for (i, p) in at.iter().enumerate() {
            let (c, r) = bins.bin(p);
            bins.items[r * columns + c].push(i);
        }
        bins
    }
    fn bin(&self, p: &Vector2<f64>) -> (usize, usize) {
        let index = |x: f64, count: usize| ((x / self.size).max(0.0) as usize).min(count - 1);
        (index(p.x - self.origin.x, self.columns), index(p.y - self.origin.y, self.rows))
    }
    fn within(&self, at: &[Vector2<f64>], p: &Vector2<f64>, radius: f64) -> Vec<usize> {
        let reach = Vector2::new(radius, radius);
        let ((c0, r0), (c1, r1)) = (self.bin(&(p - reach)), self.bin(&(p + reach)));
        let mut out = Vec::new();
        for r in r0..=r1 {
            for c in c0..=c1 {
                out.extend(self.items[r * self.columns + c].iter().filter(|i| (at[**i] - p).norm() <= radius));
            }
        }
        out
    }
    fn nearest(&self, at: &[Vector2<f64>], p: &Vector2<f64>, count: usize) -> Vec<usize> {
        let mut radius = self.size * (count as f64).sqrt();
        let mut found = self.within(at, p, radius);
        while found.len() < count.min(at.len()) {
            radius *= 1.6;
            found = self.within(at, p, radius);
        }
        found.sort_by(|a, b| (at[*a] - p).norm().total_cmp(&(at[*b] - p).norm()).then(a.cmp(b)));
        found.truncate(count);
        found
    }
}
