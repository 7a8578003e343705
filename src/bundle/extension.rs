//! Whether the model lacks something: score tests of further unknowns at the minimum, without adjusting them.
//!
//! | question | further unknowns | degrees of freedom |
//! |---|---|---|
//! | a lens term, pixel aspect, pupil ratio; is a value right that is held? | one intrinsic of one camera | 1 |
//! | k3, where the images ask for k2 | k3 beside k2: what both explain less what k2 does | 1 |
//! | is a radius right that is held? | that radius | 1 |
//! | is the plate bent? | `dz = (a x^2 + b x y + c y^2) / L^2`, L half the extent, common to all views | 3 |
//! | are the dots displaced? | (dx, dy) of every disc, common to all views | 2 per disc less what a shift, turn and scale take up |
//!
//! The further unknowns are those the adjustment has anyway, so their derivatives are the ones that are tested elsewhere; the test itself
//! is [`crate::solve::ScoreTests`]. With a robust loss its size is right to a percent (Huber at 3 sigma).

use super::adjust::{Adjustment, problem};
use super::layout::Places;
use super::model::{Model, TargetShape};
use super::state::State;
use crate::camera::INTRINSICS;
use crate::solve::{Problem, Score, ScoreTests};
use crate::stats::chi_square_above;
use nalgebra::{DMatrix, DVector, Vector2};

/// Discs beyond which single displacements are not tested together: the matrix would outgrow the adjustment.
const MOST_DISCS: usize = 600;
/// Prior of an offset that leaves it free, mm.
const FREE_MM: f64 = 1e4;

/// Places of k2 and k3 in [`crate::camera::INTRINSIC_NAMES`].
const K2: usize = 7;
const K3: usize = 8;
/// Chance below which k2 is asked for so clearly that k3 is looked at beside it.
const ASKED_FOR: f64 = 1e-3;

/// What might be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extension {
    /// An intrinsic parameter that is held.
    Intrinsic {
        /// Camera.
        camera: usize,
        /// Index in [`crate::camera::INTRINSIC_NAMES`].
        parameter: usize,
    },
    /// A radius of the target that is held.
    Radius {
        /// Its place in the shape of the target.
        parameter: usize,
    },
    /// The plate is bent.
    BentTarget,
    /// The dots are not at their nominal places.
    DisplacedDiscs,
}

/// Result of one test.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtensionTest {
    /// What was tested.
    pub extension: Extension,
    /// Chi-square where the model lacks nothing.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees: usize,
    /// Estimate: change of the intrinsic (its unit) or radius, mm; peak to valley of the bend beside a plane, mm; root mean square displacement of
    /// the dots beside noise and any smooth stretch of the whole, mm.
    pub size: f64,
    /// Its standard deviation; `NaN` where it has none in this form.
    pub sigma: f64,
    /// Change of the global unknowns if it were added.
    pub shift: DVector<f64>,
}

/// All tests of an adjustment.
pub struct ExtensionTests {
    /// Those that it allows; the ones about which the images say nothing are left out.
    pub list: Vec<ExtensionTest>,
    tests: ScoreTests,
    /// What each of them frees.
    freed: Vec<Freed>,
}

/// Further unknowns, and the columns that span what is freed of them.
struct Freed {
    tested: Vec<usize>,
    basis: DMatrix<f64>,
}

impl ExtensionTests {
    /// Chi-square and degrees of freedom of one of the list beside others of it: what all of them explain less what the others do. `None` where
    /// nothing is left of it.
    pub fn beside(&self, one: usize, others: &[usize]) -> Option<(f64, usize)> {
        let alone = self.together(others)?;
        let all = self.together(&[others, &[one]].concat())?;
        let degrees = all.degrees.saturating_sub(alone.degrees);
        (degrees > 0).then(|| ((all.statistic - alone.statistic).max(0.0), degrees))
    }

    fn together(&self, some: &[usize]) -> Option<Score> {
        let freed: Vec<&Freed> = some.iter().map(|k| &self.freed[*k]).collect();
        let tested: Vec<usize> = freed.iter().flat_map(|f| &f.tested).copied().collect();
        let columns = freed.iter().map(|f| f.basis.ncols()).sum();
        let mut basis = DMatrix::zeros(tested.len(), columns);
        let (mut row, mut column) = (0, 0);
        for f in freed {
            basis.view_mut((row, column), f.basis.shape()).copy_from(&f.basis);
            (row, column) = (row + f.basis.nrows(), column + f.basis.ncols());
        }
        self.tests.test(&tested, &basis)
    }
}

/// All tests; `None` where nothing can be said.
pub fn extension_tests(adjustment: &Adjustment) -> Option<ExtensionTests> {
    let base = Places::of(&adjustment.model);
    let (model, state) = extended(adjustment);
    let places = Places::of(&model);
    let equations = problem(&model).linearise(&state)?;
    let tests = ScoreTests::of(&equations, shared(&base, &places))?;
    let (mut list, mut freed) = (vec![], vec![]);
    for (camera, old) in base.charts.iter().enumerate() {
        for parameter in 0..old.len() {
            let (None, Some(at)) = (old[parameter], places.charts[camera][parameter]) else { continue };
            // k3 alone says no more than k2 alone.
            let k2 = places.charts[camera][K2].filter(|_| parameter == K3 && old[K2].is_none());
            let tested = match k2 {
                Some(k2) => beside(&tests, k2, at),
                None => tests.test(&[at], &DMatrix::identity(1, 1)),
            };
            let Some(score) = tested else { continue };
            let parameter = model.cameras[camera].intrinsic_of(parameter);
            list.push(of_one(Extension::Intrinsic { camera, parameter }, score));
            freed.push(Freed { tested: vec![at], basis: DMatrix::identity(1, 1) });
        }
    }
    for (parameter, (old, new)) in base.shape.iter().zip(&places.shape).enumerate() {
        let (None, Some(at)) = (old, *new) else { continue };
        let Some(score) = tests.test(&[at], &DMatrix::identity(1, 1)) else { continue };
        list.push(of_one(Extension::Radius { parameter }, score));
        freed.push(Freed { tested: vec![at], basis: DMatrix::identity(1, 1) });
    }
    if let (None, Some(first)) = (base.offsets, places.offsets) {
        for (test, own) in
            [bent(&tests, &model, &state, first), displaced(&tests, &model, &state, first)].into_iter().flatten()
        {
            list.push(test);
            freed.push(own);
        }
    }
    Some(ExtensionTests { list, tests, freed })
}

/// The last of what is tested, alone or beside others.
fn of_one(extension: Extension, score: Score) -> ExtensionTest {
    let last = score.estimate.len() - 1;
    ExtensionTest {
        extension,
        statistic: score.statistic,
        degrees: score.degrees,
        size: score.estimate[last],
        sigma: score.covariance[(last, last)].sqrt(),
        shift: score.shift,
    }
}

/// What a second number explains that a first one does not, where the images ask for the first.
fn beside(tests: &ScoreTests, first: usize, second: usize) -> Option<Score> {
    let alone = tests.test(&[first], &DMatrix::identity(1, 1))?;
    if chi_square_above(alone.statistic, 1.0) > ASKED_FOR {
        return None;
    }
    let both = tests.test(&[first, second], &DMatrix::identity(2, 2)).filter(|both| both.degrees == 2)?;
    let statistic = (both.statistic - alone.statistic).max(0.0);
    Some(Score { statistic, degrees: 1, shift: &both.shift - &alone.shift, ..both })
}

/// Model and state with everything that is tested made free.
fn extended(adjustment: &Adjustment) -> (Model, State) {
    let (mut model, mut state) = (adjustment.model.clone(), adjustment.state.clone());
    model.cameras.iter_mut().for_each(|camera| *camera = camera.clone().freed(0..INTRINSICS));
    let lattice = matches!(model.target.shape, TargetShape::Lattice(_));
    if !model.target.per_view() {
        model.target.free[1..if lattice { 2 } else { 3 }].fill(true);
    }
    let contours = model.images.iter().all(|i| i.pairs.is_empty());
    let discs = model.target.disc_count();
    if lattice && contours && model.target.offset_sigma_mm.is_none() && (4..=MOST_DISCS).contains(&discs) {
        model.target.offset_sigma_mm = Some([FREE_MM; 4]);
        state.offsets_mm = vec![[0.0; 4]; discs];
    }
    (model, state)
}

/// Where the global unknowns of the smaller model stand in the larger one.
fn shared(base: &Places, places: &Places) -> Vec<usize> {
    let mut out = vec![0; base.global];
    let mut put = |from: Option<usize>, to: Option<usize>, n: usize| {
        if let (Some(from), Some(to)) = (from, to) {
            (0..n).for_each(|k| out[from + k] = to + k);
        }
    };
    for (old, new) in base.charts.iter().zip(&places.charts) {
        old.iter().zip(new).for_each(|(a, b)| put(*a, *b, 1));
    }
    base.motions.iter().zip(&places.motions).for_each(|(a, b)| put(*a, *b, 6));
    for (old, new) in base.windows.iter().zip(&places.windows) {
        old.iter().zip(new).for_each(|(a, b)| put(*a, *b, 1));
    }
    put(base.plane, places.plane, 3);
    base.shape.iter().zip(&places.shape).for_each(|(a, b)| put(*a, *b, 1));
    put(base.ovals, places.ovals, 4);
    let offsets = base.offsets.map_or(0, |at| base.global - at);
    put(base.offsets, places.offsets, offsets);
    out
}

fn bent(tests: &ScoreTests, model: &Model, state: &State, first: usize) -> Option<(ExtensionTest, Freed)> {
    let (at, _) = model.target.spread(&state.shape_mm);
    let n = at.len();
    let basis = DMatrix::from_fn(n, 3, |j, k| {
        let p = at[j];
        [p.x * p.x, p.x * p.y, p.y * p.y][k]
    });
    let tested: Vec<usize> = (0..n).map(|j| first + 4 * j + 2).collect();
    let score = tests.test(&tested, &basis)?;
    // Beside the plane that fits best: a constant and a tilt belong to the pose.
    let plane = DMatrix::from_fn(n, 3, |j, k| [1.0, at[j].x, at[j].y][k]);
    let gram = plane.tr_mul(&plane).try_inverse()?;
    let beside = &basis - &plane * (gram * plane.tr_mul(&basis));
    let dz = &beside * &score.estimate;
    let (high, low) = (dz.argmax().0, dz.argmin().0);
    let across = beside.row(high) - beside.row(low);
    let variance = (&across * &score.covariance * across.transpose())[(0, 0)];
    let test = ExtensionTest {
        extension: Extension::BentTarget,
        statistic: score.statistic,
        degrees: score.degrees,
        size: dz[high] - dz[low],
        sigma: variance.max(0.0).sqrt(),
        shift: score.shift,
    };
    Some((test, Freed { tested, basis }))
}

fn displaced(tests: &ScoreTests, model: &Model, state: &State, first: usize) -> Option<(ExtensionTest, Freed)> {
    let discs = model.target.disc_count();
    let tested: Vec<usize> = (0..discs).flat_map(|j| [first + 4 * j, first + 4 * j + 1]).collect();
    // What a stretch or a bend of the whole field of dots explains, cameras and poses explain as well: it is not said to
    // be the dots'. The rest is tested, in an orthonormal basis.
    let eigen = beside_smooth(&model.target.spread(&state.shape_mm).0).symmetric_eigen();
    let rough: Vec<usize> = (0..discs).filter(|&k| eigen.eigenvalues[k] > 0.5).collect();
    let basis = DMatrix::from_fn(2 * discs, 2 * rough.len(), |i, k| {
        if i % 2 == k % 2 { eigen.eigenvectors[(i / 2, rough[k / 2])] } else { 0.0 }
    });
    let score = tests.test(&tested, &basis)?;
    let square = score.estimate.norm_squared() - score.covariance.trace();
    let test = ExtensionTest {
        extension: Extension::DisplacedDiscs,
        statistic: score.statistic,
        degrees: score.degrees,
        size: (square.max(0.0) / discs as f64).sqrt(),
        sigma: f64::NAN,
        shift: score.shift,
    };
    Some((test, Freed { tested, basis }))
}

/// Projector that takes a quadratic field out of one number per disc (a linear one where the discs are few).
fn beside_smooth(at: &[Vector2<f64>]) -> DMatrix<f64> {
    let discs = at.len();
    let columns = if discs >= 12 { 6 } else { 3 };
    let smooth = DMatrix::from_fn(discs, columns, |j, k| {
        let p = at[j];
        [1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y][k]
    });
    // On a grid of two rows a square is a constant: what is not independent of the rest takes nothing out.
    let gram = smooth.tr_mul(&smooth).symmetric_eigen();
    let least = 1e-10 * gram.eigenvalues.max();
    let mut out = DMatrix::identity(discs, discs);
    for k in (0..columns).filter(|k| gram.eigenvalues[*k] > least) {
        let field = &smooth * gram.eigenvectors.column(k);
        out.ger(-1.0 / gram.eigenvalues[k], &field, &field, 1.0);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a grid of two rows the square across is a constant: five fields are taken out, not six, and these wholly.
    #[test]
    fn fields_of_two_rows_are_taken_out_once() {
        for (columns, rows, fields) in [(10, 2, 5.0), (2, 9, 5.0), (6, 5, 6.0), (12, 1, 3.0), (3, 3, 3.0)] {
            let place = |j: usize| Vector2::new(0.1 * (j % columns) as f64, 0.1 * (j / columns) as f64 - 0.3);
            let at: Vec<_> = (0..columns * rows).map(place).collect();
            let projector = beside_smooth(&at);
            assert!((projector.trace() - (at.len() as f64 - fields)).abs() < 1e-9, "{columns} x {rows}");
            assert!((&projector * &projector - &projector).amax() < 1e-9, "{columns} x {rows}");
            let linear = DMatrix::from_fn(at.len(), 3, |j, k| [1.0, at[j].x, at[j].y][k]);
            assert!((&projector * linear).amax() < 1e-9, "{columns} x {rows}");
        }
    }
}
