//! The adjustment in which the second camera stands otherwise from one view on: its motion there is one of its own.

use super::{FEWEST, Moved};
use crate::bundle::adjust::Bundle;
use crate::bundle::assemble;
use crate::bundle::facts;
use crate::bundle::image_map::{MappedNormal, Slot};
use crate::bundle::layout::Places;
use crate::bundle::model::{ImageObservations, Model};
use crate::bundle::reach::Observe;
use crate::bundle::retraction;
use crate::bundle::state::State;
use crate::frames::{Cam, Rig};
use crate::rigid::{Motion, rotation_log};
use crate::solve::{Iteration, NormalEquations, Options, Outcome, Problem, Step, Termination, minimise, predict};
use crate::threads::gathered;
use nalgebra::{DMatrix, Vector3};

/// A step of the second camera, adjusted from a state that may be no minimum without it.
#[derive(Debug, Clone)]
pub struct MovedFit {
    /// Before which view.
    pub when: Moved,
    view: usize,
    stood: Stood,
}

impl MovedFit {
    /// The state in which an image was taken.
    pub fn state_of(&self, image: &ImageObservations) -> &State {
        if image.camera == 1 && image.view >= self.view { &self.stood.after } else { &self.stood.before }
    }

    /// Angle by which one camera turned against the other, rad, and distance by which its projection centre moved, mm.
    pub fn moved_by(&self) -> [f64; 2] {
        let step = self.stood.step();
        [rotation_log(&step.rotation).norm(), step.translation_mm.norm()]
    }
}

/// Of steps before each view the one that leaves the least cost; `None` with one camera, too few views, or where none comes to an end. `observe` sees the
/// iterations, from several threads, and returns false to stop.
pub fn moved_before(model: &Model, start: &State, options: &Options, observe: Observe<'_>) -> Option<MovedFit> {
    let places = Places::of(model);
    let motion = (*places.motions.get(1)?)?;
    let views: Vec<usize> = (1..model.views.len()).collect();
    if model.views.len() < FEWEST {
        return None;
    }
    let one = |&view: &usize| {
        let apart = Apart::of(model, &places, motion, view);
        let start = Stood { before: start.clone(), after: start.clone() };
        let out = minimise(&apart, start, options, &mut |i| observe(i));
        (out.termination == Termination::Converged).then_some((view, out))
    };
    let found: Vec<Option<(usize, Outcome<Stood>)>> = gathered(true, &views, one);
    let found = found.into_iter().flatten().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    found.map(|(view, out)| MovedFit { when: Moved::Before(view), view, stood: out.state })
}

/// Where both cameras stand before, and the second one afterwards.
#[derive(Debug, Clone)]
pub(super) struct Stood {
    pub(super) before: State,
    pub(super) after: State,
}

/// A model with a second motion of the second camera among the unknowns that all share.
pub(super) struct Apart<'a> {
    model: &'a Model,
    bundle: Bundle<'a>,
    /// Places of both motions.
    motions: [usize; 2],
    /// The first view afterwards.
    view: usize,
}

impl<'a> Apart<'a> {
    pub(super) fn of(model: &'a Model, places: &Places, motion: usize, view: usize) -> Self {
        let bundle = Bundle::with_places(model, places.with_further(6));
        Self { model, bundle, motions: [motion, places.shared()], view }
    }

    pub(super) fn places(&self) -> &Places {
        self.bundle.places()
    }

    /// Places of both motions.
    pub(super) fn motions(&self) -> [usize; 2] {
        self.motions
    }

    fn is_after(&self, o: &ImageObservations) -> bool {
        o.camera == 1 && o.view >= self.view
    }

    /// The minimum, and its cost less than at the start.
    pub(super) fn adjusted(&self, start: &State, observe: &mut dyn FnMut(&Iteration) -> bool) -> Option<(Stood, f64)> {
        let start = Stood { before: start.clone(), after: start.clone() };
        let cost = self.cost(&start)?;
        let out = minimise(self, start, &Options { decrement: 1e-2, iterations: 200 }, observe);
        (out.termination == Termination::Converged).then_some((out.state, cost - out.cost))
    }

    /// Angle by which the second camera turned, rad, and distance by which its projection centre moved, mm, each with its standard deviation (`NaN` where
    /// nothing determines it). Motions take left steps `(w, v)`, before and after:
    /// ```text
    /// d |turn| = n . (w_a - w_b),  n the axis          d |shift| = m . (v_a - R v_b),  m along the shift, R the turn
    /// ```
    pub(super) fn moved_by(&self, stood: &Stood) -> Option<[[f64; 2]; 2]> {
        let equations = self.linearise(stood)?;
        let step = stood.step();
        let [turn, shift] = [rotation_log(&step.rotation), step.translation_mm];
        let [axis, along] = [turn, shift].map(|x| x.try_normalize(0.0).unwrap_or_else(Vector3::x));
        let before = step.rotation.transpose() * along;
        let mut rows = DMatrix::zeros(2, equations.b_g.len());
        let [first, second] = self.motions;
        for k in 0..3 {
            (rows[(0, second + k)], rows[(0, first + k)]) = (axis[k], -axis[k]);
            (rows[(1, second + 3 + k)], rows[(1, first + 3 + k)]) = (along[k], -before[k]);
        }
        let known = predict(&equations, &rows)?;
        let sigma = |k: usize| if known.determined[k] { known.covariance[(k, k)].max(0.0).sqrt() } else { f64::NAN };
        Some([[turn.norm(), sigma(0)], [shift.norm(), sigma(1)]])
    }

    /// View and equations of each image.
    pub(super) fn of_each_image(&self, stood: &Stood) -> Option<Vec<(usize, MappedNormal)>> {
        let state = |o: &ImageObservations| if self.is_after(o) { &stood.after } else { &stood.before };
        let [first, second] = self.motions;
        let mut images = assemble::of_each_image_in(self.model, self.places(), &stood.before, state)?;
        for ((_, image), _) in images.iter_mut().zip(&self.model.images).filter(|(_, o)| self.is_after(o)) {
            for slot in &mut image.slots {
                match *slot {
                    Slot::Global(at) if (first..first + 6).contains(&at) => *slot = Slot::Global(second + at - first),
                    _ => {}
                }
            }
        }
        Some(images)
    }
}

/// The second camera from the first.
fn motion(state: &State) -> Motion<Cam, Rig> {
    state.camera_from_first[1]
}

impl Stood {
    /// Where a point of the second camera's frame before is in that afterwards.
    fn step(&self) -> Motion<Cam, Cam> {
        motion(&self.after) * motion(&self.before).inverse()
    }
}

impl Problem for Apart<'_> {
    type State = Stood;
    fn layout(&self) -> crate::solve::Layout {
        self.bundle.layout()
    }
    fn cost(&self, stood: &Stood) -> Option<f64> {
        let state = |o: &ImageObservations| if self.is_after(o) { &stood.after } else { &stood.before };
        Some(
            assemble::cost_in(self.model, &stood.before, state)?
                + facts::cost(self.model, self.places(), &stood.before)?,
        )
    }
    fn linearise(&self, stood: &Stood) -> Option<NormalEquations> {
        let images = self.of_each_image(stood)?;
        self.bundle.summed(images.iter(), &stood.before)
    }
    fn scales(&self, stood: &Stood) -> Step {
        let mut scales = self.bundle.scales(&stood.before);
        let [first, second] = self.motions;
        let own = scales.global.rows(first, 6).into_owned();
        scales.global.rows_mut(second, 6).copy_from(&own);
        scales
    }
    fn retract(&self, stood: &Stood, step: &Step) -> Option<Stood> {
        let mut step = self.bundle.step_by_view(step);
        let before = retraction::retract(self.model, self.places(), &stood.before, &step)?;
        let [first, second] = self.motions;
        let moved = step.global.rows(second, 6).into_owned();
        step.global.rows_mut(first, 6).copy_from(&moved);
        let alone = retraction::retract(self.model, self.places(), &stood.after, &step)?;
        // Where a length sets the scale, each step ends with one of its own.
        let distance = |state: &State| state.views.first().map(|v| v.first_from_target.translation_mm.norm());
        let mut after = before.clone();
        after.camera_from_first[1] = motion(&alone);
        after.camera_from_first[1].translation_mm *= distance(&before)? / distance(&alone)?;
        Some(Stood { before, after })
    }
}
