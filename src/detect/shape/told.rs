//! What one disc tells of the blur that it is seen through.
//!
//! Beside its two numbers c and e a blur may be wider along one direction of the image than across: motion, an oblique window. Its covariance is
//! `s^2 (1 + p, q; q, 1 - p)` then, and adds to the share g of the disc in a pixel, to first order,
//!
//! ```text
//! s^2/2 (p (g_uu - g_vv) + 2 q g_uv),   of which along the normal, at the angle f from u:   s^2/2 (g_nn - g_tt) (p cos 2f + q sin 2f)
//! ```
//!
//! Disc i, fitted with `x0 = (c, e, 0, 0)`, says by its score `g_i` and information `S_i` where x = (c, e, p, q) is ([`Told`]): with `C_i` the
//! derivatives of the grey values by x, over the noise, `J_i` those by all unknowns of the disc, `A_i` their equations and `r_i` what these left,
//!
//! ```text
//! S_i = C^T C - C^T J A^-1 J^T C,   g_i = C^T r,   geometry follows by -A^-1 J^T C
//! ```
//!
//! | symbol | identifier | shape | unit | meaning |
//! |---|---|---|---|---|
//! | c, e | - | 2 | 1 | the shape, see [`crate::detect::shape`] |
//! | p, q | - | 2 | 1 | by what part the variance is larger along u than along v, and along the diagonals |
//! | s | `blur_px` | 1 | px | standard deviation, the mean of all directions |
//! | g_nn, g_tt | - | 2 | 1/px^2 | second derivatives across and along the contour |
//! | S_i, g_i | `Told::information`, `Told::right` | 4 x 4, 4 | 1 | information and score |
//! | - | `Told::follows` | 5 x 4 | px | change of the geometry, in regular coordinates, with x |

use super::orders_of_edge;
use crate::detect::band::LANES;
use crate::detect::dense::Dense;
use crate::detect::profile::Profile;
use crate::lanes::{self, Kernel};
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};

/// Numbers of a disc.
pub(crate) const OWN: usize = 4;
/// What a fit may leave of the squares that noise explains, or of those that are there: at little noise a shape explains most at once, the rest later.
const MOST_LEFT: f64 = 2.0;
const MOSTLY: f64 = 0.25;

/// What one disc says.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    pub(crate) information: Matrix4<f64>,
    pub(crate) right: Vector4<f64>,
    /// Change of the geometry in regular coordinates with the shape, px.
    pub(crate) follows: SMatrix<f64, 5, OWN>,
    /// Covariance of the geometry, px^2.
    pub(crate) covariance: SMatrix<f64, 5, 5>,
    /// Squares that the fit left, over the noise, and number of pixels.
    pub(crate) squares: f64,
    pub(crate) pixels: f64,
}

/// What [`LANES`] pixels see of the edge near them: their distances from it, and the eccentric angles of their foot points.
pub(crate) struct Edges {
    pub(crate) profile: Profile,
    /// Cosine and sine of the angle of the major axis.
    pub(crate) turn: [f64; 2],
    pub(crate) distance: [f64; LANES],
    pub(crate) cos: [f64; LANES],
    pub(crate) sin: [f64; LANES],
}

impl Kernel for Edges {
    /// Derivatives of the share of the disc by c, e, p and q, and by the distance.
    type Output = ([[f64; LANES]; OWN], [f64; LANES]);
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) -> Self::Output {
        let Profile { blur_px, a, b, .. } = self.profile;
        let seen = self.profile.at(&self.distance, &self.cos, &self.sin);
        let mut out = [[0.0; LANES]; OWN];
        for l in 0..LANES {
            let (x, y) = (b * self.cos[l], a * self.sin[l]);
            let square = x * x + y * y;
            let length = square.sqrt();
            let kappa = a * b / (square * length);
            let orders = orders_of_edge(seen.depth[l], blur_px * kappa);
            for (k, order) in orders.iter().enumerate() {
                out[k][l] = seen.density[l] * order.share;
            }
            // g_nn - g_tt, as the second derivatives of `surface`.
            let bend = -seen.slope[l] * (seen.depth[l] / blur_px + kappa) / square;
            [out[2][l], out[3][l]] = by_stretch(blur_px, [bend * x * x, bend * x * y, bend * y * y], self.turn);
        }
        (out, seen.slope)
    }
}

/// Derivatives by p and q of what has the second derivatives xx, xy, yy (1/px^2) in a frame that is turned by the angle with this cosine and sine; what is
/// alike in all directions says nothing.
pub(crate) fn by_stretch(blur_px: f64, [xx, xy, yy]: [f64; 3], [cos, sin]: [f64; 2]) -> [f64; 2] {
    let (half, along, mixed) = (0.5 * blur_px * blur_px, xx - yy, 2.0 * xy);
    let (cos2, sin2) = ((cos - sin) * (cos + sin), 2.0 * cos * sin);
    [half * (along * cos2 - mixed * sin2), half * (along * sin2 + mixed * cos2)]
}

/// Sums over the pixels of one disc, from which it tells: pixels that are [`LANES`] apart go into one.
pub(crate) struct Sums {
    /// Of products with the columns of the unknowns.
    mixed: Vec<[[f64; LANES]; OWN]>,
    information: [[[f64; LANES]; OWN]; OWN],
    right: [[f64; LANES]; OWN],
    squares: [f64; LANES],
    pixels: usize,
    /// The columns of the unknowns at the pixels that are added.
    pub(crate) columns: Vec<[f64; LANES]>,
}

impl Sums {
    /// None yet, for `n` unknowns of the disc.
    pub(crate) fn new(n: usize) -> Self {
        let none = [0.0; LANES];
        Self {
            mixed: vec![[none; OWN]; n],
            information: [[none; OWN]; OWN],
            right: [none; OWN],
            squares: none,
            pixels: 0,
            columns: vec![none; n],
        }
    }

    /// Adds the first `count` of some pixels, whose columns are set: derivatives of their grey values by what is told, and what is left of these, over the noise.
    pub(crate) fn add(&mut self, mut own: [[f64; LANES]; OWN], mut left: [f64; LANES], count: usize) {
        for l in count.min(LANES)..LANES {
            own.iter_mut().for_each(|own| own[l] = 0.0);
            left[l] = 0.0;
        }
        self.pixels += count.min(LANES);
        lanes::run(Add { sums: self, own: &own, left: &left });
    }

    /// What the disc says, given the factor of its equations, the geometry last.
    pub(crate) fn told(self, dense: &Dense) -> Told {
        let sum = |sums: &[[f64; LANES]; OWN]| sums.map(|x| lanes::sum(&x));
        let totals = Totals {
            mixed: self.mixed.iter().map(sum).collect(),
            information: self.information.each_ref().map(sum),
            right: sum(&self.right),
            squares: lanes::sum(&self.squares),
            pixels: self.pixels as f64,
        };
        totals.told(dense)
    }
}

/// The same of all pixels.
pub(crate) struct Totals {
    /// Products with the columns of the unknowns.
    pub(crate) mixed: Vec<[f64; OWN]>,
    /// Of what is told with itself; the lower triangle counts.
    pub(crate) information: [[f64; OWN]; OWN],
    pub(crate) right: [f64; OWN],
    pub(crate) squares: f64,
    pub(crate) pixels: f64,
}

impl Totals {
    /// None yet, for `n` unknowns of the disc and so many pixels.
    pub(crate) fn new(n: usize, pixels: usize) -> Self {
        let none = [0.0; OWN];
        Self { mixed: vec![none; n], information: [none; OWN], right: none, squares: 0.0, pixels: pixels as f64 }
    }

    /// What the disc says, given the factor of its equations, the geometry last.
    pub(crate) fn told(self, dense: &Dense) -> Told {
        let n = self.mixed.len();
        let mut follows = self.mixed.clone();
        dense.solve_each(&mut follows);
        let known = Matrix4::from_fn(|a, b| (0..n).map(|k| self.mixed[k][a] * follows[k][b]).sum());
        Told {
            information: Matrix4::from_fn(|a, b| self.information[a.max(b)][a.min(b)]) - known,
            right: Vector4::from(self.right),
            follows: SMatrix::from_fn(|i, m| -follows[n - 5 + i][m]),
            covariance: dense.covariance,
            squares: self.squares,
            pixels: self.pixels,
        }
    }
}

/// [`Sums::add`] as wide as the processor is.
struct Add<'a> {
    sums: &'a mut Sums,
    own: &'a [[f64; LANES]; OWN],
    left: &'a [f64; LANES],
}

impl Kernel for Add<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: lanes::Lanes>(self) {
        let Self { sums, own, left } = self;
        for m in 0..OWN {
            for k in 0..=m {
                add_products(&mut sums.information[m][k], &own[m], &own[k]);
            }
            add_products(&mut sums.right[m], &own[m], left);
        }
        add_products(&mut sums.squares, left, left);
        for (mixed, column) in sums.mixed.iter_mut().zip(&sums.columns) {
            for m in 0..OWN {
                add_products(&mut mixed[m], &own[m], column);
            }
        }
    }
}

#[inline(always)]
fn add_products(sums: &mut [f64; LANES], a: &[f64; LANES], b: &[f64; LANES]) {
    for l in 0..LANES {
        sums[l] += a[l] * b[l];
    }
}

impl Told {
    /// How far off a shape is, given as what it adds to that of the fit.
    pub(super) fn off(&self, beside: &Vector4<f64>) -> f64 {
        let left = self.right - self.information * beside;
        self.information.try_inverse().map_or(0.0, |inverse| left.dot(&(inverse * left)))
    }

    /// Whether noise and a shape explain what it sees.
    pub(super) fn is_clean(&self) -> bool {
        let left = self.squares - self.off(&Vector4::zeros());
        self.information.determinant() > 0.0 && left < f64::max(MOST_LEFT * self.pixels, MOSTLY * self.squares)
    }

    /// By how much a blur that is wider along one direction moved the geometry, which the fit did not know, px.
    pub(crate) fn stretched(&self, [p, q]: [f64; 2]) -> SVector<f64, 5> {
        self.follows * Vector4::new(0.0, 0.0, p, q)
    }

    /// What not knowing the shape better adds to the covariance of the geometry, px^2.
    pub(crate) fn adds(&self, covariance: &Matrix4<f64>) -> SMatrix<f64, 5, 5> {
        self.follows * covariance * self.follows.transpose()
    }

    /// By how much the geometry moves, squared over its covariance.
    pub(super) fn moved(&self, by: &Vector4<f64>) -> f64 {
        let moved = self.follows * by;
        self.covariance.cholesky().map_or(0.0, |c| moved.dot(&c.solve(&moved)))
    }
}
