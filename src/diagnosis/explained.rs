//! Findings that are there because of another one.
//!
//! A view that is wrong, or a camera that was moved, bends the whole estimate: priors seem to contradict the images, and these to ask for lens terms. A prior
//! that is wrong, or a lens term that is lacking, bends it as well, and views seem to contradict each other. So all is asked again without what may be the
//! cause:
//! ```text
//! A   without the wrong views: which priors and tests of the model are to be looked at all the same?
//! B   without those priors, and with those lens terms: do views contradict each other all the same?
//! ```
//! | A | B | what goes |
//! |---|---|---|
//! | any | views contradict | what A does not find again goes with the views |
//! | finds all again | views agree | the views go with them |
//! | does not | views agree | the same as above, whichever explains less by a likelihood ratio of 100; where both explain as much, findings that are more than the views |
//!
//! (what they explain: T of the views together, see [`super::culprit`]; twice the gain in log-likelihood of B; both less their degrees of freedom.)
//! Beside a move, whose part [`super::model_tests`] has, priors are asked again without what the second camera saw afterwards. Where single views hide behind sigmas that were
//! enlarged for them ([`super::enlarged`]) it is asked again without these whether there was a move.

use super::culprit::{TOLD_APART, Wrong, contradict};
use super::field::SeenSheet;
use super::keys::Keys;
use super::model_tests::{ModelTests, model_tests};
use super::priors::{Priors, priors};
use super::probes::Probes;
use super::views::Views;
use super::{Asked, Subject, Watch, brief, flags, near_its_minimum};
use crate::bundle::{
    Adjustment, ImageObservations, Moved, NamedCovariance, adjust, listed, named_covariance, readjusted_without,
};
use crate::error::Result;
use crate::record::{ModelTest, Prior};

/// A row that tells of something.
pub(super) trait Finding {
    /// What was asked, which tells it from others.
    fn asks(&self) -> &str;
    /// Whether the answer is yes, felt or not.
    fn is_found(&self) -> bool;
    fn words(&self) -> &str;
    fn say(&mut self, words: String);
}

impl Finding for Prior {
    fn asks(&self) -> &str {
        &self.name
    }
    fn is_found(&self) -> bool {
        self.conflict
    }
    fn words(&self) -> &str {
        &self.words
    }
    fn say(&mut self, words: String) {
        self.words = words;
    }
}

impl Finding for ModelTest {
    fn asks(&self) -> &str {
        &self.question
    }
    fn is_found(&self) -> bool {
        self.needed
    }
    fn words(&self) -> &str {
        &self.words
    }
    fn say(&mut self, words: String) {
        self.words = words;
    }
}

impl<T: Finding> Asked<T> {
    /// Not to be looked at before something else, for a reason in words.
    pub(super) fn goes_after(&mut self, reason: &str) {
        self.flagged = false;
        self.row.say(format!("{}; {reason}", self.found));
    }
}

/// What bends the estimate.
struct Cause<'a> {
    words: String,
    without: &'a Adjustment,
}

impl Cause<'_> {
    /// Takes away what is not to be looked at without it; the number of findings.
    fn takes<T: Finding>(&self, found: &mut [Asked<T>], again: &[Asked<T>]) -> usize {
        let mut taken = 0;
        for one in found.iter_mut().filter(|one| one.flagged && !stands(one, again)) {
            let same = again.iter().find(|other| other.row.asks() == one.row.asks());
            let less = if same.is_some_and(|other| other.row.is_found()) { "less so" } else { "not" };
            one.goes_after(&format!("{less} without {}", self.words));
            taken += 1;
        }
        taken
    }

    /// What is asked, of the adjustment without it.
    fn subject<'s>(&'s self, s: &Subject<'s>, covariance: &'s NamedCovariance) -> Subject<'s> {
        Subject { adjustment: self.without, covariance, ..*s }
    }
}

/// Whether the same was found again.
fn stands<T: Finding>(one: &Asked<T>, again: &[Asked<T>]) -> bool {
    again.iter().any(|other| other.row.asks() == one.row.asks() && other.flagged)
}

fn all_stand<T: Finding>(found: &[Asked<T>], again: &[Asked<T>]) -> bool {
    found.iter().filter(|one| one.flagged).all(|one| stands(one, again))
}

/// Priors and tests of the model that are there because of a moved camera or of wrong views are taken away, and wrong views that are there because of them;
/// what a user must be told of wrong views.
pub(super) fn explained(
    s: &Subject<'_>,
    names: &[&str],
    (of_priors, tests, views): (&mut Priors, &mut ModelTests, &mut Views),
    watch: &Watch<'_>,
) -> Result<Vec<String>> {
    let any = flags(&of_priors.asked).len() + flags(&tests.asked).len() > 0;
    if let Some(when) = tests.moved.filter(|when| !views.wrong.as_ref().is_some_and(|w| blames_no_move(w, *when, s))) {
        // Views that stand on either side of a move contradict each other, whichever they are.
        views.flags.clear();
        if let Some(without) = before_move(s, when, watch)? {
            let cause = Cause { words: "what was seen after the move, which goes first".into(), without: &without };
            if let Some(covariance) = named_covariance(&without) {
                cause.takes(&mut of_priors.asked, &priors(&cause.subject(s, &covariance)).asked);
            }
        }
        return Ok(vec![]);
    }
    let Some(wrong) = &views.wrong else { return Ok(vec![]) };
    // Beside sigmas that were enlarged for it nothing can be weighed.
    let s = &wrong.hidden.as_ref().map_or(*s, |(strict, _)| Subject { adjustment: strict, ..*s });
    let without = wrong.without.as_ref().filter(|_| any);
    let Some((without, covariance)) = without.and_then(|a| Some((a, named_covariance(a)?))) else {
        return Ok(views.contradictions(false));
    };
    let cause = Cause { words: named(wrong), without };
    // That a wrong view stands apart says the same twice, whatever comes of it.
    let twice = tests.apart.is_some_and(|view| wrong.views.iter().any(|c| c.view == view));
    if let (true, Some(row)) = (twice, tests.asked.last_mut()) {
        row.goes_after(&format!("not without {}", cause.words));
    }
    let subject = cause.subject(s, &covariance);
    let priors_again = priors(&subject);
    let sheet = SeenSheet::of(&covariance, s.sizes_px, names, s.sheet_frame.as_ref());
    let probes = sheet.and_then(|sheet| Probes::of(&covariance, &sheet));
    let again = model_tests(&subject, (&Keys::of(&covariance, names), probes.as_ref()), watch);
    let stand = || all_stand(&of_priors.asked, &priors_again.asked) && all_stand(&tests.asked, &again.asked);
    let granted = granted(s, names, (of_priors, tests), watch)?;
    if let Some(Granted { agree: true, explains, .. }) = granted
        && (stand() || explains > wrong.excess + TOLD_APART)
    {
        views.agree_once("what else is said of the priors and of the model is mended");
        return Ok(vec![]);
    }
    let fewer = flags(&of_priors.asked).len() + flags(&tests.asked).len() <= wrong.views.len();
    if fewer && granted.is_none_or(|g| g.agree && g.explains + TOLD_APART > wrong.excess) {
        return Ok(views.contradictions(twice));
    }
    let of_priors = cause.takes(&mut of_priors.asked, &priors_again.asked);
    let of_tests = cause.takes(&mut tests.asked, &again.asked);
    Ok(views.contradictions(twice || of_priors + of_tests > 0))
}

/// Whether views that hide behind enlarged sigmas are wrong by themselves, not those on one side of a move: whether there was one is asked without them.
fn blames_no_move(wrong: &Wrong, when: Moved, s: &Subject<'_>) -> bool {
    let n = s.adjustment.model.views.len();
    let is_out = |v: usize| wrong.views.iter().any(|c| c.view == v);
    let divided = match when {
        Moved::Before(k) => (0..n).all(|v| is_out(v) == (v >= k)) || (0..n).all(|v| is_out(v) == (v < k)),
        Moved::Steadily => false,
    };
    wrong.hidden.is_some() && !divided
}

/// An adjustment without the priors and with the lens terms that are to be looked at.
struct Granted {
    /// Whether views agree in it.
    agree: bool,
    /// By how much better all fit so, beyond expectation.
    explains: f64,
}

/// `None` where it does not get near its minimum.
fn granted(
    s: &Subject<'_>,
    names: &[&str],
    (of_priors, tests): (&Priors, &ModelTests),
    watch: &Watch<'_>,
) -> Result<Option<Granted>> {
    let a = s.adjustment;
    let (model, priors) = of_priors.without_flagged(&a.model);
    let (model, terms) = tests.granted(model);
    if priors + terms == 0 {
        return Ok(Some(Granted { agree: false, explains: 0.0 }));
    }
    let found = near_its_minimum(adjust(&model, a.state.clone(), &brief(s), &mut |i| watch.goes_on(i)))?;
    let told = |found: Adjustment| {
        let explains = 2.0 * (a.cost - found.cost) - (priors + terms) as f64;
        Ok(Granted { agree: !contradict(s, names, &found, watch)?, explains })
    };
    found.map(told).transpose()
}

fn named(wrong: &Wrong) -> String {
    let all: Vec<String> = wrong.views.iter().map(|c| c.view.to_string()).collect();
    match &all[..] {
        [one] => format!("view {one}, which contradicts the others and is to be mended"),
        _ => format!("views {}, which contradict the others and are to be mended", listed(&all)),
    }
}

/// The adjustment of what the second camera saw before a move, and the first one always; `None` where it does not get near its minimum, or for a drift.
fn before_move(s: &Subject<'_>, when: Moved, watch: &Watch<'_>) -> Result<Option<Adjustment>> {
    let Moved::Before(view) = when else { return Ok(None) };
    let is_out = |i: &ImageObservations| i.camera == 1 && i.view >= view;
    near_its_minimum(readjusted_without(s.adjustment, &is_out, &brief(s), &mut |i| watch.goes_on(i)))
}
