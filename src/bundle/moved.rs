//! Whether the cameras were moved against each other between views: score tests of a step of their motion, and of a steady drift.
//!
//! Views follow each other as in the model, in epochs of one view (of more beyond [`MOST_EPOCHS`]). The motion of the second camera is given a step of its
//! own in every epoch, which moves its images there as the motion itself does:
//! ```text
//! delta_e in R^6,  d image / d delta_e = d image / d motion    for images of the second camera in epoch e
//! any:    all delta_e free (but their common part, which is the motion)         chi2_any
//! step:   delta_e = eta for e >= k, else 0    chi2_k
//! drift:  delta_e = eta e / (E - 1)                                                 chi2_d
//! ```
//! Where the largest is a step beyond chance, it is adjusted ([`apart`]), since a camera that was pushed moves images by pixels, where equations bend:
//! ```text
//! chi2_max = 2 (cost without the step - cost with it),   chi2_rest = chi2_any at that minimum
//! ```
//! else (and for a drift) `chi2_rest = chi2_any - chi2_max`. Standard deviations of an adjusted step are those of its minimum, times the square root of
//! what is left over its degrees of freedom where that is below one: those of the images may have been enlarged for the step.
//!
//! What differs from view to view without any order (a plate that bends, a mount that gives way) would pass for the largest step. So a step is compared with
//! what is left beside it:
//! ```text
//! chi2_rest within chance (above 1 %), and that of no other division of the epochs in two which has five sixths of chi2_max:
//!         p = (number of steps and drifts) P(chi-square > chi2_max)
//! else    p = part of all orders of the epochs in which chi2_max is as large (a sample of them)
//! ```
//! (that of others in units of what the true one leaves, where this is below its degrees of freedom; of few views that scatter some division leaves
//! nothing but chance: that it is the one in their order has to be as clear.)
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | eta | `estimate` | rad, mm | solver frame of the second camera | turn and shift of the camera; the shift is that of its projection centre |
//! | delta_e | `tested` | rad, mm | the same | step of an epoch |
//! | M, g | `information`, `slope` | | | information on delta that the other unknowns leave, and its right-hand side ([`crate::solve::ScoreTests`]) |
//! | E | `epochs` | 1 | | number of epochs |
//!
//! One camera that moves and the other that moves the opposite way are one and the same where poses are free: which of both was moved is not told.
//! Source: score tests for a change at an unknown time, Page, Biometrika 42 (1955); orders drawn at random, Pitman, Suppl. J. R. Stat. Soc. 4 (1937).

mod apart;

use super::adjust::{Adjustment, Bundle};
use super::assemble;
use super::image_map::{MappedNormal, Slot};
use super::layout::Places;
use super::model::Model;
use super::state::State;
use crate::solve::{Iteration, Score, ScoreTests};
use crate::stats::chi_square_above;
use apart::{Apart, Stood};
pub use apart::{MovedFit, moved_before};
use nalgebra::{DMatrix, DVector, Matrix6, Vector3, Vector6};

/// Epochs at most.
const MOST_EPOCHS: usize = 40;
/// Fewer views tell no move from a view that is wrong by itself.
const FEWEST: usize = 4;
/// Chance of what is left beside a step below which views differ by more than noise.
const SCATTERED: f64 = 0.01;
/// Orders that are drawn, and of how many as good as the true one it is enough to know.
const ORDERS: usize = 4999;
const ENOUGH: usize = 100;
/// Part of a step from which on that of another division is as good.
const RIVAL: f64 = 5.0 / 6.0;
/// Discs in all images at most where each is estimated: their equations are kept.
const KEPT: usize = 200_000;
/// Part of what an epoch says of its step by itself that is too little to be looked at.
const RIDGE: f64 = 1e-9;

/// When the cameras were moved against each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moved {
    /// Before this view, an index of the model's list; where epochs have several views, the first of one.
    Before(usize),
    /// By and by over all views.
    Steadily,
}

impl Moved {
    /// The view that alone stands on one side, of so many.
    pub fn alone(self, views: usize) -> Option<usize> {
        match self {
            Moved::Before(1) => Some(0),
            Moved::Before(view) => Some(view).filter(|view| view + 1 == views),
            Moved::Steadily => None,
        }
    }

    /// What happened, of so many views.
    pub fn words(self, views: usize) -> String {
        if let Some(view) = self.alone(views) {
            let when = if view == 0 { "after" } else { "before" };
            return format!(
                "view {view} stands apart from the others, as if one camera was moved {when} it (or the target, between its two exposures)"
            );
        }
        match self {
            Moved::Before(view) => format!(
                "one camera was moved between view {} and view {view} of {views} (in the order of the rig file)",
                view - 1
            ),
            Moved::Steadily => {
                "the cameras drift against each other from view to view (in the order of the rig file), from the first to the last".into()
            }
        }
    }

    /// What to do.
    pub fn advice(self, views: usize) -> &'static str {
        match self {
            when if when.alone(views).is_some() => {
                "leave it out; if your recordings were made on its side, take the other views again"
            }
            Moved::Before(_) => {
                "calibrate the views before and those after by themselves (each needs a length and a view in the sheet of its own), and take those of \
                 the time of your recordings"
            }
            Moved::Steadily => "fasten the cameras, let them warm up, and take the views again",
        }
    }
}

/// The most significant of all steps, and the drift.
#[derive(Debug, Clone, PartialEq)]
pub struct MovedTest {
    /// When.
    pub when: Moved,
    /// Chi-square where the cameras stood still and only noise differs from view to view.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees: usize,
    /// Probability of so large a step by chance, of all that were asked.
    pub p_value: f64,
    /// Whether views differ by more than noise, but as they do in other orders, too.
    pub scattered: bool,
    /// Angle by which one camera turned against the other (between the first view and the last, for a drift), and its standard deviation, rad.
    pub turn_rad: [f64; 2],
    /// By how much the projection centre of one moved as seen from the other, and its standard deviation, mm.
    pub shift_mm: [f64; 2],
    /// Change of the global unknowns if it were added: to those of the first view, and of the last.
    pub changes: [DVector<f64>; 2],
}

/// The test; `None` with one camera, too few views, or where the images say nothing. `observe` sees the iterations of the adjustment with a step, and
/// returns false to do without it.
pub fn moved_test(adjustment: &Adjustment, observe: &mut dyn FnMut(&Iteration) -> bool) -> Option<MovedTest> {
    let (model, state) = (&adjustment.model, &adjustment.state);
    let places = Places::of(model);
    let motion = (*places.motions.get(1)?)?;
    let views = model.views.len();
    if views < FEWEST || places.offsets.is_some() && model.images.len() * model.target.disc_count() > KEPT {
        return None;
    }
    let epochs = Epochs { views, each: views.div_ceil(MOST_EPOCHS), motions: [motion; 2], first: places.shared() };
    let images = assemble::of_each_image(model, &places, state)?;
    let steps = Steps::of(model, (&places, &epochs), images, state)?;
    let (any, asked) = (steps.any()?, epochs.steps());
    let found = asked.iter().filter_map(|step| Some((*step, steps.test(*step)?)));
    let (step, score) = found.max_by(|a, b| a.1.statistic.total_cmp(&b.1.statistic))?;
    let mut change = DVector::zeros(places.global);
    change.rows_mut(0, places.shared()).copy_from(&score.shift.rows(0, places.shared()));
    let mut at_last = change.clone();
    (0..6).for_each(|k| at_last[motion + k] += score.estimate[k]);
    let chance = |statistic: f64| (asked.len() as f64 * chi_square_above(statistic, score.degrees as f64)).min(1.0);
    let mut out = MovedTest {
        when: step.map_or(Moved::Steadily, |k| Moved::Before(k * epochs.each)),
        statistic: score.statistic,
        degrees: score.degrees,
        p_value: chance(score.statistic),
        scattered: false,
        turn_rad: size(&score, 0),
        shift_mm: size(&score, 3),
        changes: [change, at_last],
    };
    if out.p_value > SCATTERED {
        return Some(out);
    }
    let degrees = any.degrees.saturating_sub(score.degrees);
    let mut rest = Rest { statistic: any.statistic - score.statistic, degrees };
    if let Moved::Before(view) = out.when {
        let apart = Apart::of(model, &places, motion, view);
        if let Some((stood, less)) = apart.adjusted(state, observe) {
            rest = beside(model, (&apart, &stood), &epochs)?;
            let scale = rest.noise().sqrt();
            [out.turn_rad, out.shift_mm] = apart.moved_by(&stood)?.map(|[size, sigma]| [size, scale * sigma]);
            out.statistic = 2.0 * less;
            out.p_value = chance(out.statistic);
        }
    }
    let among = steps.among_orders(&asked, step);
    let of_rival = |statistic: f64| Rest { statistic: (any.statistic - statistic) / rest.noise(), degrees };
    if !rest.by_chance() || among.rival.is_some_and(|rival| of_rival(rival).by_chance()) {
        (out.p_value, out.scattered) = (among.as_large, true);
    }
    Some(out)
}

/// What is left beside a step.
#[derive(Clone, Copy)]
struct Rest {
    statistic: f64,
    degrees: usize,
}

impl Rest {
    fn by_chance(self) -> bool {
        chi_square_above(self.statistic, self.degrees as f64) > SCATTERED
    }

    /// Variance of the noise over the one that is stated, one at most: sigmas that were enlarged for a move are too large for what is left beside it.
    fn noise(self) -> f64 {
        (self.statistic / self.degrees.max(1) as f64).clamp(f64::MIN_POSITIVE, 1.0)
    }
}

/// Beside a step that was adjusted.
fn beside(model: &Model, (apart, stood): (&Apart<'_>, &Stood), epochs: &Epochs) -> Option<Rest> {
    let images = apart.of_each_image(stood)?;
    let epochs = Epochs { motions: apart.motions(), first: apart.places().shared(), ..*epochs };
    let Score { statistic, degrees, .. } = Steps::of(model, (apart.places(), &epochs), images, &stood.before)?.any()?;
    Some(Rest { statistic, degrees })
}

/// Size of the turn or the shift that begins at a place of eta, and its standard deviation.
fn size(score: &Score, first: usize) -> [f64; 2] {
    let part: Vector3<f64> = score.estimate.fixed_rows::<3>(first).into_owned();
    let along = part.try_normalize(0.0).unwrap_or_else(Vector3::x);
    let variance = along.dot(&(score.covariance.fixed_view::<3, 3>(first, first) * along));
    [part.norm(), variance.max(0.0).sqrt()]
}

/// How views make epochs, and where the unknowns stand.
#[derive(Clone, Copy)]
struct Epochs {
    views: usize,
    /// Views of an epoch.
    each: usize,
    /// Places of the second camera's motion, first and last.
    motions: [usize; 2],
    /// Place of the first step.
    first: usize,
}

impl Epochs {
    fn count(&self) -> usize {
        self.views.div_ceil(self.each)
    }

    /// Epochs before which there may be a step, and the drift.
    fn steps(&self) -> Vec<Option<usize>> {
        (1..self.count()).map(Some).chain([None]).collect()
    }
}

/// What other orders of the epochs have.
struct Among {
    /// Part of them with a step, or a drift, as large.
    as_large: f64,
    /// That of another division of the epochs in two which is nearly as good.
    rival: Option<f64>,
}

/// Steps of all epochs, ready to be tested.
struct Steps {
    tests: ScoreTests,
    tested: Vec<usize>,
}

impl Steps {
    /// From the equations of each image at a state.
    fn of(
        model: &Model,
        (places, epochs): (&Places, &Epochs),
        mut images: Vec<(usize, MappedNormal)>,
        state: &State,
    ) -> Option<Self> {
        let first = epochs.first;
        for ((view, image), _) in images.iter_mut().zip(&model.images).filter(|(_, seen)| seen.camera == 1) {
            image.move_as_well(epochs.motions, first + 6 * (*view / epochs.each));
        }
        let with_steps = Bundle::with_places(model, places.with_further(6 * epochs.count()));
        let equations = with_steps.summed(images.iter(), state)?;
        let tested: Vec<usize> = (first..first + 6 * epochs.count()).collect();
        let base = (0..equations.b_g.len()).filter(|at| !tested.contains(at));
        Some(Self { tests: ScoreTests::of(&equations, base.collect())?, tested })
    }

    /// How much of eta there is in each epoch: of a step, or without one of a drift.
    fn part(&self, step: Option<usize>, epoch: usize) -> f64 {
        match step {
            Some(k) => f64::from(u8::from(epoch >= k)),
            None => epoch as f64 / (self.tested.len() / 6 - 1) as f64,
        }
    }

    fn test(&self, step: Option<usize>) -> Option<Score> {
        let follows = |i: usize, j: usize| if i % 6 == j { self.part(step, i / 6) } else { 0.0 };
        self.tests.test(&self.tested, &DMatrix::from_fn(self.tested.len(), 6, follows))
    }

    fn any(&self) -> Option<Score> {
        let n = self.tested.len();
        self.tests.test(&self.tested, &DMatrix::identity(n, n))
    }

    /// The steps, and the drift, of other orders of the epochs beside `best`, the largest of the true one.
    fn among_orders(&self, asked: &[Option<usize>], best: Option<usize>) -> Among {
        let (information, slope) = self.tests.left(&self.tested);
        let between = |e: usize, f: usize| information.fixed_view::<6, 6>(6 * e, 6 * f);
        // Of the epoch by itself, with what keeps directions of which it says nothing from being divided by.
        let alone = |e: usize| between(e, e) + Matrix6::from_diagonal(&(between(e, e).diagonal() * RIDGE));
        let statistic = |m: Matrix6<f64>, g: &Vector6<f64>| m.cholesky().map_or(0.0, |m| g.dot(&m.solve(g)));
        let epochs = self.tested.len() / 6;
        let after = |step: usize| (step..epochs).fold(0_u64, |set, e| set | 1 << e);
        let divided = best.map(after);
        let all = after(0);
        // The largest, and the largest that does not divide the epochs as the true one does.
        let largest = |order: &[usize]| {
            let (mut out, mut other, mut set) = (0.0_f64, 0.0_f64, 0_u64);
            let [mut of_step, mut of_drift] = [(Matrix6::zeros(), Vector6::zeros()); 2];
            for (place, &e) in order.iter().enumerate().rev() {
                let (own, slope) = (self.part(None, place), slope.fixed_rows::<6>(6 * e));
                of_step = (of_step.0 + alone(e), of_step.1 + slope);
                of_drift = (of_drift.0 + alone(e) * own.powi(2), of_drift.1 + slope * own);
                for (later, &f) in order.iter().enumerate().skip(place + 1) {
                    let both = between(e, f) + between(f, e);
                    of_step.0 += both;
                    of_drift.0 += both * (own * self.part(None, later));
                }
                set |= 1 << e;
                if asked.contains(&Some(place)) {
                    let own = statistic(of_step.0, &of_step.1);
                    out = out.max(own);
                    if divided.is_some_and(|d| d != set && d != all ^ set) {
                        other = other.max(own);
                    }
                }
            }
            (out.max(statistic(of_drift.0, &of_drift.1)), other)
        };
        let mut order: Vec<usize> = (0..epochs).collect();
        let (true_one, mut rival) = largest(&order);
        let (mut as_large, mut drawn, mut state) = (0, 0, 1_u64);
        while drawn < ORDERS && as_large < ENOUGH {
            for i in (1..order.len()).rev() {
                // Knuth's generator; its upper bits are the good ones.
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                order.swap(i, (state >> 33) as usize % (i + 1));
            }
            drawn += 1;
            let (own, other) = largest(&order);
            as_large += usize::from(own >= true_one);
            rival = rival.max(other);
        }
        Among {
            as_large: (as_large + 1) as f64 / (drawn + 1) as f64,
            rival: (rival > RIVAL * true_one).then_some(rival),
        }
    }
}

impl MappedNormal {
    /// Adds six global unknowns, from `first` on, that move the image as the motion of its camera does, which stands at one of two places.
    fn move_as_well(&mut self, motions: [usize; 2], first: usize) {
        let n = self.slots.len();
        let place = |g: usize| self.slots.iter().position(|s| matches!(s, Slot::Global(at) if *at == g));
        let own = |motion: usize| (motion..motion + 6).map(place).collect::<Option<Vec<usize>>>();
        let Some(like) = motions.into_iter().find_map(own) else { return };
        // The lower triangle by rows: of two of the old unknowns, whichever comes first.
        let at = |i: usize, j: usize| i.max(j) * (i.max(j) + 1) / 2 + i.min(j);
        for (k, &i) in like.iter().enumerate() {
            let with_old = (0..n).map(|j| self.h[at(i, j)]).collect::<Vec<_>>();
            let with_new = like[..=k].iter().map(|&j| self.h[at(i, j)]).collect::<Vec<_>>();
            self.h.extend([with_old, with_new].concat());
            self.b.push(self.b[i]);
            self.slots.push(Slot::Global(first + k));
            self.tied.iter_mut().for_each(|t| t.row.push(t.row[i]));
        }
        let with_discs = self.crosses.chunks_exact(n.max(1));
        self.crosses = with_discs.flat_map(|own| own.iter().copied().chain(like.iter().map(|i| own[*i]))).collect();
    }
}
