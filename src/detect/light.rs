//! The light on either side of the edge: how rich a model the image asks for, and how noisy it is.
//!
//! A *surface* is a polynomial of the place in the image, in units of the semi-axes, `X = x/a`, `Y = y/b`, so that `X = cos t`,
//! `Y = sin t` on the contour:
//!
//! ```text
//! L = c_0 + c_1 rho + c_2 X + c_3 Y + c_4 (X^2 - Y^2) + c_5 2 X Y,     rho = X^2 + Y^2 - 1
//! ```
//!
//! The slope along the normal follows from the same numbers: light that rises across the disc costs two of them, not a slope per place.
//! `c_1` moves no level on the contour, only the radial slope; it is all but held at zero unless the pixels away from the edge
//! show it (a free radial slope costs half of what the image tells about the axes).
//!
//! Smoke follows no polynomial: there what it adds to the best one, levels, slopes and bends, stands at *nodes* around the contour, tied to
//! their neighbours as loosely as the pixels away from the edge show them to differ.
//! Levels walk from node to node in steps as large as those that are seen. Slopes and bends are chains with the standard deviation of
//! the light's derivatives along the contour and the length over which they change, `gradient / bend`, since smoke has no preferred direction.
//! Where that length says that few waves follow the light across the disc, they do, with all pixels inside ([`crate::detect::exact`]).
//!
//! | symbol | identifier | unit | meaning |
//! |---|---|---|---|
//! | c_0 .. c_5 | order of `Side::basis` | grey | coefficients of a surface |
//! | - | `gradient`, `bend` | grey | standard deviation of the first and second derivatives of the light in units of the semi-axes |
//! | - | `loose` | 1 | how many times wider slopes and bends are held than these two say |
//!
//! Smoke has no preferred direction in the plane of the disc; in the image it is foreshortened with the disc, which the units of the
//! semi-axes take out.
//!
//! Not valid where the light changes within a few blurs.

use crate::detect::contour::Contour;
use crate::detect::edge_model::Solution;
use crate::detect::sectors::{Away, Sectors};
use crate::stats::median;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::{PI, TAU};

/// Length of contour from node to node, px.
const NODE_PX: f64 = 6.0;
/// Most nodes around a contour.
const MOST_NODES: usize = 400;
/// Standard deviation of a radial slope that the image shows, grey steps per semi-axis.
const RADIAL: f64 = 0.15;
/// A slope held too tightly drags the edge along with it, one held too loosely costs little: the prior is this much wider than measured, from
/// light that goes up and down but a few times around the contour. Of a print not more: the halo of its edge is no light that rises, but would pass for it.
const LOOSE: f64 = 2.0;
/// The same where it is known that there is smoke, whose long waves are alike over more of the contour than its slopes show.
const LOOSE_IN_SMOKE: f64 = 2.5;
/// How much it must fall for slopes across the contour that no surface has: chance does that once in 20 000 discs.
const LEANS: f64 = 20.0;
/// Standard deviations by which light must vary to be called smoke.
const SURE: f64 = 3.5;
/// Standard deviations by which a stretch of the contour must be off for something to hide it, and the least share of the contour that must
/// be left: what hides more is smoke.
const ODD: f64 = 4.0;
const LEAST_SEEN: f64 = 0.75;
/// How much `chi^2` must fall for two more coefficients: their mean, 3.5 standard deviations, and 4 for having looked.
const WORTH: f64 = 13.0;

/// Second over first derivatives up to which a hundred waves follow light across a disc, per semi-axis: waves of one to four semi-axes have 3 to 6, of a
/// third of that 8 and more.
const SLOW: f64 = 6.0;

/// Light on both sides.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Light {
    /// A polynomial inside and one outside.
    Surface([Side; 2]),
    /// Nodes around the contour: how many, and the priors of either side.
    Nodes(usize, [NodePrior; 2]),
}

/// One polynomial.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    /// 0, 1 or 2.
    pub(crate) degree: usize,
    /// Standard deviation of `c_1`, grey.
    pub(crate) radial: f64,
    /// Step of the edge: the scale of everything, grey.
    pub(crate) step: f64,
}

/// What is known of light at nodes before seeing the edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NodePrior {
    /// Of the levels about the surface: what it leaves varies less than the light.
    about_gradient: f64,
    /// Of the light as a whole. Levels on the contour tell a surface, and all about its slopes only where light is one.
    pub(crate) gradient: f64,
    pub(crate) bend: f64,
    /// How many times wider than that slopes and bends are held.
    loose: [f64; 2],
    /// Surface about which the light varies, grey.
    about: SVector<f64, 6>,
    /// The poorest polynomial, and whether the light follows none.
    side: Side,
    smoke: bool,
}

/// The same at one node, as weights of level, slope and bend.
pub(crate) struct AtNode {
    /// Of the value itself.
    pub(crate) own: [f64; 3],
    /// Of its difference from that at the next node.
    pub(crate) tie: [f64; 3],
}

/// Weights of the values and of the differences of neighbours in a chain of which every value has the standard deviation `sigma` and neighbours
/// the correlation `r = exp(-apart)`, `apart` in lengths over which the values change (first-order autoregression): `(1 - r) / (1 + r) / sigma^2` and
/// `r / (1 - r^2) / sigma^2`. Values held one by one would fix their mean as if each knew of it; a walk with steps as small as those of
/// light that varies smoothly would not come as far as that light does.
fn chained(sigma: f64, apart: f64) -> [f64; 2] {
    let r = (-apart.max(1e-9)).exp();
    let weight = sigma.powi(-2) / (1.0 + r);
    [(1.0 - r) * weight, r / (1.0 - r) * weight]
}

impl NodePrior {
    /// Level, slope and bend of the surface on a sector.
    pub(crate) fn surface(&self, contour: &Contour, k: usize) -> [f64; 3] {
        let (value, climb) = Side::basis(contour, k);
        [value, climb, Side::bend(contour, k)].map(|x| self.about.iter().zip(&x).map(|(c, x)| c * x).sum())
    }

    /// One over the length along the contour in which light changes, in units of the semi-axes; what is measured as shorter than two nodes
    /// is noise.
    fn per_length(&self, nodes: usize) -> f64 {
        (self.bend / self.gradient).min(0.5 * nodes as f64)
    }

    /// Standard deviation of the third derivative in units of the semi-axes, grey, of waves of one length that run in all directions:
    /// `(10/9)^(1/2) bend^2 / gradient`.
    fn third(&self, nodes: usize) -> f64 {
        (10.0_f64 / 9.0).sqrt() * self.bend * self.per_length(nodes)
    }

    /// How many times the standard deviations of the light's first and second derivatives are those that means of stretches and their differences show.
    ///
    /// Of waves that run in all directions, with `x = (k h)^2`, `k` their wave number and `h` the length of a stretch, about as deep as long, both in semi-axes, means over stretches leave
    /// `exp(-x / 12)` of their variance, differences of neighbours `exp(-x / 16)` of that of first derivatives, those of three `exp(-5 x / 36)` of that of second
    /// ones (`sinc^2 z = exp(-z^2 / 3)`, directions with `cos^2` and `cos^4` as weights). So of the ratio of the derivatives, `(3/4)^(1/2) k`, is seen
    /// `exp(-11 x / 288)`, from which `x` follows.
    fn averaged_away(&self, nodes: usize) -> [f64; 2] {
        let seen = 4.0 / 3.0 * (TAU * self.per_length(nodes) / nodes as f64).powi(2);
        // Waves no shorter than two stretches.
        let x = (0..8).fold(seen, |x, _| (seen * (11.0 / 144.0 * x).exp()).min(PI * PI));
        [(7.0 / 96.0 * x).exp(), (x / 9.0).exp()]
    }

    /// This prior as loose as smoke that is known asks: what averaging takes is made up for where the light varies at all.
    fn in_smoke(self, nodes: usize) -> Self {
        let hidden = if self.smoke { self.averaged_away(nodes) } else { [1.0; 2] };
        Self { loose: hidden.map(|x| LOOSE_IN_SMOKE * x), ..self }
    }

    /// At node `i` of `nodes`.
    pub(crate) fn at(&self, contour: &Contour, i: usize, nodes: usize) -> AtNode {
        let k = i * contour.len() / nodes;
        let (along, across) = (contour.turn[k] * contour.perimeter_px / nodes as f64, contour.steepness(k));
        let slope = chained(self.loose[0] * self.gradient * across, along * self.per_length(nodes));
        let bend = chained(self.loose[1] * self.bend * across * across, along * self.per_length(nodes));
        AtNode { own: [0.0, slope[0], bend[0]], tie: [(self.about_gradient * along).powi(-2), slope[1], bend[1]] }
    }
}

impl Side {
    /// Most coefficients.
    pub(crate) const MOST: usize = 6;

    /// A polynomial without radial slope.
    pub(crate) fn plain(degree: usize, step: f64) -> Self {
        Self { degree, radial: 1e-5 * step, step }
    }

    /// Standard deviation of the radial slope of light that bends along the contour as its coefficients say: it bends across as well.
    pub(crate) fn bend_across<const N: usize>(c: &SVector<f64, N>) -> f64 {
        (0.5 * (c[4] * c[4] + c[5] * c[5])).sqrt()
    }

    /// Number of coefficients.
    pub(crate) fn count(&self) -> usize {
        2 + 2 * self.degree
    }

    /// Standard deviations of the coefficients before seeing the image, grey: weak, to keep hidden stretches finite.
    pub(crate) fn prior_sigmas(&self) -> [f64; Self::MOST] {
        let s = self.step;
        [1e3 * s, self.radial, 2.0 * s, 2.0 * s, s, s]
    }

    /// The polynomials on a sector of the contour and their derivatives along the normal, 1 and 1/px.
    #[inline]
    pub(crate) fn basis(contour: &Contour, k: usize) -> ([f64; Self::MOST], [f64; Self::MOST]) {
        let (c, s, [gx, gy]) = (contour.cos[k], contour.sin[k], contour.climb[k]);
        let value = [1.0, 0.0, c, s, c * c - s * s, 2.0 * c * s];
        let climb = [0.0, 2.0 * (c * gx + s * gy), gx, gy, 2.0 * (c * gx - s * gy), 2.0 * (s * gx + c * gy)];
        (value, climb)
    }

    /// Their second derivatives along the normal, 1/px^2.
    fn bend(contour: &Contour, k: usize) -> [f64; Self::MOST] {
        let [gx, gy] = contour.climb[k];
        [0.0, 2.0 * (gx * gx + gy * gy), 0.0, 0.0, 2.0 * (gx * gx - gy * gy), 4.0 * gx * gy]
    }
}

/// Places of the coefficients as they come in with the degree, the radial slope last.
const ORDER: [usize; Side::MOST] = [0, 2, 3, 4, 5, 1];

/// Columns of [`Fits`]: those of a surface, and `rho X`, `rho Y`, which change no level on the contour but the slopes across it.
const FITTED: usize = Side::MOST + 2;
/// The last two.
const LEANING: [usize; 2] = [Side::MOST, Side::MOST + 1];

/// Sums of squares that polynomials leave on the pixels away from the edge.
#[derive(Debug)]
pub(crate) struct Fits<const N: usize> {
    /// Products of the polynomials, of them with the grey values, and of these.
    pub(crate) matrix: SMatrix<f64, N, N>,
    pub(crate) right: SVector<f64, N>,
    pub(crate) squares: f64,
}

/// What polynomials of degree 0, 1 and 2 without a radial slope leave, and their coefficients.
pub(crate) type Degrees<const N: usize> = [(f64, SVector<f64, N>); 3];

impl Fits<FITTED> {
    fn new(contour: &Contour, sectors: &Sectors, side: usize) -> Self {
        let mut fits = Self { matrix: SMatrix::zeros(), right: SVector::zeros(), squares: 0.0 };
        for k in (0..contour.len()).filter(|k| sectors.keep[*k]) {
            let x = &sectors.away[side][k];
            if x.n == 0.0 {
                continue;
            }
            let (surface, slope) = Side::basis(contour, k);
            let (mut value, mut climb) = ([0.0; FITTED], [0.0; FITTED]);
            value[..Side::MOST].copy_from_slice(&surface);
            climb[..Side::MOST].copy_from_slice(&slope);
            (climb[LEANING[0]], climb[LEANING[1]]) = (slope[1] * contour.cos[k], slope[1] * contour.sin[k]);
            for i in 0..FITTED {
                for j in 0..=i {
                    fits.matrix[(i, j)] += value[i] * value[j] * x.n
                        + (value[i] * climb[j] + climb[i] * value[j]) * x.d
                        + climb[i] * climb[j] * x.dd;
                }
                fits.right[i] += value[i] * x.y + climb[i] * x.yd;
            }
            fits.squares += x.yy;
        }
        fits.matrix.fill_upper_triangle_with_lower_triangle();
        fits
    }
}

impl<const N: usize> Fits<N> {
    /// What each degree leaves; none where the pixels do not fix them.
    pub(crate) fn degrees(&self) -> Option<Degrees<N>> {
        Some([self.left_by(&ORDER[..1])?, self.left_by(&ORDER[..3])?, self.left_by(&ORDER[..5])?])
    }

    /// The poorest polynomial that `seen` pixels with noise of this variance do not contradict.
    pub(crate) fn side(&self, degrees: &Degrees<N>, variance: f64, seen: f64, step: f64) -> Side {
        let mut side = Side::plain(0, step);
        let fall = |a: usize, b: usize| (degrees[a].0 - degrees[b].0) / variance;
        side.degree = if fall(1, 2) > WORTH && seen > 24.0 { 2 } else { usize::from(fall(0, 1) > WORTH) };
        if side.degree == 2 {
            side.radial = Side::bend_across(&degrees[2].1);
        }
        let mut with_radial: Vec<usize> = ORDER[..1 + 2 * side.degree].to_vec();
        with_radial.push(1);
        if let Some((left, _)) = self.left_by(&with_radial) {
            if (degrees[side.degree].0 - left) / variance > 16.0 {
                side.radial = side.radial.max(0.5 * RADIAL * step);
            }
        }
        side
    }

    /// Sum of squares left by the coefficients listed, and these.
    pub(crate) fn left_by(&self, which: &[usize]) -> Option<(f64, SVector<f64, N>)> {
        let n = which.len();
        let reduced = SMatrix::<f64, N, N>::from_fn(|i, j| match (i < n, j < n) {
            (true, true) => self.matrix[(which[i], which[j])],
            _ => f64::from(u8::from(i == j)),
        });
        let right = SVector::<f64, N>::from_fn(|i, _| if i < n { self.right[which[i]] } else { 0.0 });
        let x = reduced.cholesky()?.solve(&right);
        let mut all = SVector::zeros();
        which.iter().enumerate().for_each(|(i, w)| all[*w] = x[i]);
        Some(((self.squares - right.dot(&x)).max(0.0), all))
    }
}

/// What the pixels away from the edge say about one side.
struct Verdict {
    prior: NodePrior,
    /// By how many standard deviations the stretch at each node is off the best surface, `sum r / (n variance)^(1/2)` over its `n` pixels away from the
    /// edge with residuals `r`, grey; none where too few pixels tell.
    off: Vec<f64>,
}

/// The poorest model of the light that the pixels away from the edge do not contradict; nodes where there is `smoke`, looser ones where that was `known`
/// before: slow smoke of which noise shows a polynomial has more than that, too little to be seen and enough to move a contour by more than its sigmas.
/// Stretches that something hides, where all the others follow polynomials, are set aside.
pub(crate) fn choose(contour: &Contour, sectors: &mut Sectors, step: f64, [smoke, known]: [bool; 2]) -> Light {
    let nodes = ((contour.perimeter_px / NODE_PX) as usize).clamp(6, MOST_NODES);
    let mut verdicts = judge_both(contour, sectors, step, nodes);
    if !smoke && smoky(&verdicts) {
        verdicts = set_aside(contour, sectors, step, nodes, &verdicts).unwrap_or(verdicts);
    }
    if !smoke && !known && !smoky(&verdicts) {
        return Light::Surface(verdicts.map(|v| v.prior.side));
    }
    let prior = |v: Verdict| if known { v.prior.in_smoke(nodes) } else { v.prior };
    Light::Nodes(nodes, verdicts.map(prior))
}

fn judge_both(contour: &Contour, sectors: &Sectors, step: f64, nodes: usize) -> [Verdict; 2] {
    [0, 1].map(|side| judge(contour, sectors, side, step.abs(), nodes))
}

fn smoky(verdicts: &[Verdict; 2]) -> bool {
    verdicts.iter().any(|v| v.prior.smoke)
}

/// Glare and dirt upon even light look like smoke: nodes would follow their skirts, and slacken all around the contour. Hides the stretches that
/// are furthest off, with those beside them, until the rest follows polynomials; all are there again where it does not.
fn set_aside(
    contour: &Contour,
    sectors: &mut Sectors,
    step: f64,
    nodes: usize,
    first: &[Verdict; 2],
) -> Option<[Verdict; 2]> {
    let (count, before) = (contour.len(), sectors.keep.clone());
    let off = |of: &[Verdict; 2]| -> Vec<f64> {
        let at = |i: usize| of.iter().filter_map(|v| v.off.get(i)).fold(0.0_f64, |most, r| most.max(r.abs()));
        (0..nodes).map(at).collect()
    };
    let mut off_now = off(first);
    let mut hidden = vec![false; count];
    loop {
        let worst = off_now.iter().copied().fold(0.0, f64::max);
        let odd = |i: usize| off_now[i] > ODD.max(0.5 * worst);
        for k in 0..count {
            let i = k * nodes / count;
            hidden[k] |= odd(i) || odd((i + 1) % nodes) || odd((i + nodes - 1) % nodes);
            sectors.keep[k] &= !hidden[k];
        }
        let kept = sectors.keep.iter().filter(|k| **k).count() as f64 / count as f64;
        if worst < ODD || kept < LEAST_SEEN {
            sectors.keep = before;
            return None;
        }
        let verdicts = judge_both(contour, sectors, step, nodes);
        if !smoky(&verdicts) {
            sectors.hide(&hidden);
            return Some(verdicts);
        }
        off_now = off(&verdicts);
    }
}

/// Sums in equal stretches of the contour, about a polynomial or about zero.
fn stretches(
    contour: &Contour,
    sectors: &Sectors,
    side: usize,
    count: usize,
    about: &SVector<f64, FITTED>,
) -> Vec<Away> {
    let mut all = vec![Away::default(); count];
    for k in (0..contour.len()).filter(|k| sectors.keep[*k]) {
        let x = sectors.away[side][k];
        let (value, climb) = Side::basis(contour, k);
        let level: f64 = (0..Side::MOST).map(|i| about[i] * value[i]).sum();
        let slope: f64 = (0..Side::MOST).map(|i| about[i] * climb[i]).sum();
        let (y, yy) = x.about(level, slope, 0.0);
        let rest = Away { y, yy, yd: x.yd - level * x.d - slope * x.dd, ..x };
        all[k * count / contour.len()].add(&rest);
    }
    all
}

/// Variance about a line along the normal within single sectors: what varies between them, or rises in all of them, is light, which must not
/// count as noise; none where too few pixels tell.
fn within_sectors(contour: &Contour, sectors: &Sectors, side: usize, about: &SVector<f64, FITTED>) -> Option<f64> {
    let (mut scatter, mut freedom) = (0.0, 0.0);
    for x in stretches(contour, sectors, side, contour.len(), about) {
        let depth = x.dd - x.d * x.d / x.n;
        if x.n >= 3.0 && depth > 1e-6 * x.dd {
            let along = x.yd - x.y * x.d / x.n;
            scatter += (x.yy - x.y * x.y / x.n - along * along / depth).max(0.0);
            freedom += x.n - 2.0;
        }
    }
    (freedom >= 6.0).then(|| scatter / freedom)
}

fn judge(contour: &Contour, sectors: &Sectors, side: usize, step: f64, nodes: usize) -> Verdict {
    let floor = 1e-4 * step;
    let (mut poorest, about) = (Side::plain(0, step), SVector::zeros());
    let still = NodePrior {
        about_gradient: floor,
        gradient: floor,
        bend: floor,
        loose: [LOOSE; 2],
        about,
        side: poorest,
        smoke: false,
    };
    let fits = Fits::new(contour, sectors, side);
    let seen: f64 = (0..contour.len()).filter(|k| sectors.keep[*k]).map(|k| sectors.away[side][k].n).sum();
    let Some(degrees) = fits.degrees().filter(|_| seen >= 12.0) else {
        // Too few pixels to ask. On a small disc a gradient of the light and a shift of the centre look alike; a large one can bear it.
        poorest.degree = usize::from(contour.perimeter_px > 40.0);
        return Verdict { prior: NodePrior { side: poorest, ..still }, off: vec![] };
    };
    let about = stretches(contour, sectors, side, nodes, &degrees[2].1);
    let least = (1e-6 * step).powi(2).max(1e-300);
    let whole = degrees[2].0 / (seen - 5.0);
    let variance = within_sectors(contour, sectors, side, &degrees[2].1).unwrap_or(whole).max(least);
    poorest = fits.side(&degrees, variance, seen, step);
    let leaning: Vec<usize> = ORDER.iter().chain(&LEANING).copied().collect();
    let leans = fits
        .left_by(&leaning)
        .is_some_and(|(left, _)| fits.left_by(&ORDER).is_some_and(|(without, _)| (without - left) / variance > LEANS));
    let off: Vec<f64> = about.iter().map(|x| if told(x) { x.y / (x.n * variance).sqrt() } else { 0.0 }).collect();
    let smoke = leans || varies(&off, about.iter().filter(|x| told(x)).count());
    let raw = stretches(contour, sectors, side, nodes, &SVector::zeros());
    let derivatives = |of: &[Away]| rough_derivatives(contour, of, variance).map(|x| x.max(floor));
    let [gradient, bend] = derivatives(&raw);
    let about_gradient = derivatives(&about)[0];
    let surface = degrees[2].1.fixed_rows::<{ Side::MOST }>(0).into_owned();
    let loose = [LOOSE; 2];
    Verdict { prior: NodePrior { about_gradient, gradient, bend, loose, about: surface, side: poorest, smoke }, off }
}

/// Whether a stretch has pixels enough for a mean.
fn told(x: &Away) -> bool {
    x.n >= 2.0
}

/// Whether the means of stretches about a surface, of which `told` count, in standard deviations, differ by more than their noise: any two,
/// or those near each other the same way, which tells of light that varies slowly.
fn varies(r: &[f64], told: usize) -> bool {
    let n = told as f64;
    let freedom = n - 5.0;
    let between: f64 = r.iter().map(|r| r * r).sum();
    let near = (r.len() / 14).max(1);
    let alike: f64 = (1..=near).map(|m| r.iter().zip(r.iter().cycle().skip(m)).map(|(a, b)| a * b).sum::<f64>()).sum();
    freedom >= 6.0 && (between > freedom + SURE * (2.0 * freedom).sqrt() || alike > SURE * (n * near as f64).sqrt())
}

/// Root mean squares of first and second derivatives along the contour in units of the semi-axes, grey: the largest of what neighbouring
/// stretches, and those 2, 4, 8, ... apart, tell. Noise hides slow changes from neighbours, distance hides fast ones.
fn rough_derivatives(contour: &Contour, raw: &[Away], variance: f64) -> [f64; 2] {
    let mut largest = [0.0_f64; 2];
    let mut apart = 1;
    while apart <= (raw.len() / 12).max(1) {
        let found = differences(contour, raw, variance, apart);
        (0..2).for_each(|i| largest[i] = largest[i].max(found[i]));
        apart *= 2;
    }
    largest
}

/// The same from differences of stretches so far apart, beyond their noise.
fn differences(contour: &Contour, raw: &[Away], variance: f64, apart: usize) -> [f64; 2] {
    let nodes = raw.len();
    let spacing = contour.perimeter_px * apart as f64 / nodes as f64;
    let (mut first, mut firsts, mut second, mut seconds) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..nodes {
        let [a, b, c] = [0, apart, 2 * apart].map(|m| &raw[(i + m) % nodes]);
        if a.n < 2.0 || b.n < 2.0 {
            continue;
        }
        let (ma, mb) = (a.y / a.n, b.y / b.n);
        let along = (spacing * contour.turn[(i + apart) % nodes * contour.len() / nodes]).powi(2);
        first += (ma - mb).powi(2) - variance * (1.0 / a.n + 1.0 / b.n);
        firsts += along;
        if c.n >= 2.0 {
            second += (ma - 2.0 * mb + c.y / c.n).powi(2) - variance * (1.0 / a.n + 4.0 / b.n + 1.0 / c.n);
            seconds += along * along;
        }
    }
    [(first, firsts), (second, seconds)]
        .map(|(sum, weight)| if weight > 0.0 { (sum / weight).max(0.0).sqrt() } else { 0.0 })
}

impl Light {
    /// What either side follows beside a field of waves where light at nodes changes slowly enough inside for few of them to do, and follows a
    /// polynomial outside; none elsewhere.
    pub(crate) fn beside_slow_waves(&self) -> Option<[Side; 2]> {
        let Light::Nodes(nodes, [inside, outside]) = self else { return None };
        let slow = inside.per_length(*nodes) < SLOW && !outside.smoke;
        slow.then_some([Side::plain(0, outside.side.step), outside.side])
    }

    /// Third derivative of the light on either side, which no model follows, grey in units of the semi-axes; zero for a surface.
    pub(crate) fn bends(&self) -> [f64; 2] {
        match self {
            Light::Surface(_) => [0.0; 2],
            Light::Nodes(n, priors) => priors.map(|p| p.third(*n)),
        }
    }
}

/// Noise variance inside and outside, from the pixels away from the edge in the sectors that count; none where too few.
pub(crate) fn noise(
    sectors: &Sectors,
    light: &Light,
    found: &Solution,
    step: f64,
    sorted: &mut Vec<f64>,
) -> [Option<f64>; 2] {
    [0, 1].map(|side| {
        let each = |k: usize| {
            let x = &sectors.away[side][k];
            let (sum, squares) = x.about(found.level[side][k], found.slope[side][k], found.bend[side][k]);
            match light {
                Light::Surface(_) => (squares, x.n),
                // The nodes follow the noise a little; what scatters within a sector is the noise itself.
                Light::Nodes(..) if x.n > 1.0 => ((squares - sum * sum / x.n).max(0.0), x.n - 1.0),
                Light::Nodes(..) => (0.0, 0.0),
            }
        };
        let kept = || (0..sectors.len()).filter(|k| sectors.keep[*k]).map(each).filter(|x| x.1 > 0.0);
        let unknowns = if let Light::Surface(sides) = light { sides[side].count() as f64 - 1.0 } else { 0.0 };
        let freedom = kept().map(|x| x.1).sum::<f64>() - unknowns;
        if freedom < 8.0 {
            return None;
        }
        sorted.clear();
        sorted.extend(kept().map(|x| x.0 / x.1));
        let median = median(sorted)?;
        // A few glints must not make the rest look noisy, a few odd values on a clipped ground must still count.
        let clip = (8.0 * median).max((0.05 * step).powi(2));
        Some(kept().map(|x| x.0.min(clip * x.1)).sum::<f64>() / freedom)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Root mean squares of first and second differences of means over squares with sides `h`, along x, of waves of unit height in all directions, over `h` and
    /// `h^2`: means and differences summed up point by point.
    fn seen(k: f64, h: f64) -> [f64; 2] {
        const POINTS: usize = 12;
        const WAVES: i32 = 4000;
        let mut sums = [0.0; 2];
        for i in 0..WAVES {
            let (s, c) = (PI * f64::from(i) / f64::from(WAVES)).sin_cos();
            // In multiples of the golden section phases are as even as can be.
            let phase = TAU * 0.618_034 * f64::from(i);
            let mean = |stretch: usize| {
                let at = |j: usize| h * ((j as f64 + 0.5) / POINTS as f64);
                let of =
                    |j: usize| (k * (c * (at(j % POINTS) + h * stretch as f64) + s * at(j / POINTS)) + phase).cos();
                (0..POINTS * POINTS).map(of).sum::<f64>() / (POINTS * POINTS) as f64
            };
            let [a, b, d] = [0, 1, 2].map(mean);
            sums[0] += ((b - a) / h).powi(2);
            sums[1] += ((d - 2.0 * b + a) / (h * h)).powi(2);
        }
        sums.map(|sum| (sum / f64::from(WAVES)).sqrt())
    }

    /// Derivatives of waves of unit height are `k / 2` and `(3/16)^(1/2) k^2`; of the shortest, three stretches long, two fifths of the second are averaged away.
    #[test]
    fn what_stretches_average_away_of_waves_is_known() {
        let (nodes, about) = (60, SVector::zeros());
        let h = TAU / nodes as f64;
        for (length, tolerance) in [(12.0, 0.001), (6.0, 0.002), (4.0, 0.01), (3.0, 0.03)] {
            let k = TAU / (length * h);
            let [gradient, bend] = seen(k, h);
            let side = Side::plain(0, 1.0);
            let prior = NodePrior { about_gradient: 1.0, gradient, bend, loose: [1.0; 2], about, side, smoke: true };
            let [first, second] = prior.averaged_away(nodes);
            let off = [first * gradient / (0.5 * k) - 1.0, second * bend / ((3.0_f64 / 16.0).sqrt() * k * k) - 1.0];
            println!("waves of {length} stretches: {first:.3} {second:.3}, off by {off:.4?}");
            assert!(off.iter().all(|x| x.abs() < tolerance), "{length} stretches: off by {off:?}");
        }
    }
}
