//! The record in plain words: what is determined, what is not, what to do next.

use super::number::{count, plain, with_unit};
use super::tables;
use crate::frames::{Cam, Rig};
use crate::record::{Known, MappingSigma, MappingUncertainty, Record, SHEET_ALONE, View, WHOLE_DISCS};

/// Residuals this many times the noise they were given say that the model or the noise is wrong.
const MISFIT: f64 = 1.5;
/// Sigmas that were enlarged by less are those that were expected.
const SHOWN_SCALE: f64 = 1.05;
/// Residuals of more than so many px and of so many times what the noise explains are no measure of anything.
const CONTRADICTED_PX: f64 = 1.0;
const CONTRADICTED_SIGMAS: f64 = 10.0;
/// A view whose rms is this many times the median of its camera is worth a look.
const VIEW_MISFIT: f64 = 2.0;
/// Views in fewer positions than this leave the cameras weak.
const FEW_VIEWS: usize = 4;
/// Why nothing was adjusted where a scene was simulated.
const TRUTH: &str = "truth";
/// More pixels about the discs of an image than this part, equal to the largest, are told.
pub const SATURATED: f64 = 0.02;
/// What that does, and what to do.
pub const CUT_OFF: &str = "if light was cut off there, edges are where they are not, and sigmas do not tell; reduce the exposure until the brightest parts keep their \
                           texture";
/// More pixels beside the contours of an image than this part, whose noise is cut off at grey level 0, are told.
pub const CUT_AT_ZERO: f64 = 0.02;
/// What that does, and what to do.
pub const TOO_BLACK: &str = "dark discs come out too large and bright ones too small by it, by some hundredths of a pixel that sigmas do not tell; raise the camera's offset \
                             (black level) until noise is not cut off";

/// How far a calibration is to be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Nothing speaks against it.
    Good,
    /// Usable, after the points named were looked at.
    Care,
    /// Not to be used.
    Bad,
}

/// What a calibration says about itself, in sentences.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// How far it is to be trusted.
    pub level: Level,
    /// One sentence.
    pub headline: String,
    /// What is determined, with numbers.
    pub determined: Vec<String>,
    /// What is not.
    pub open: Vec<String>,
    /// What to do next.
    pub next: Vec<String>,
}

/// Reads the verdict off a record.
pub fn verdict(record: &Record) -> Verdict {
    let level = level(record);
    let mut open = open_points(record);
    let next = next_steps(record);
    let headline = headline(record, level);
    if imported(record) {
        let truth = "Nothing: what is true in a simulated scene was chosen, and has no standard deviations.";
        let other = "Standard deviations: none are known, of the cameras nor of what follows from them.";
        open.push(if record.fit.termination == TRUTH { truth } else { other }.into());
    }
    if open.is_empty() {
        open.push("Nothing: the images determine every number that was estimated.".into());
    }
    Verdict { level, headline, determined: determined(record), open, next }
}

/// Whether nothing was adjusted.
fn imported(r: &Record) -> bool {
    r.fit.observations == 0
}

fn level(r: &Record) -> Level {
    let f = &r.fit;
    if !f.converged || !f.rms_px.is_finite() || contradicted(r) || sheet_elsewhere(r).is_some() {
        Level::Bad
    } else if imported(r)
        || f.nullity > 0
        || !f.undetermined.is_empty()
        || !f.flags.is_empty()
        || misfit(r) > MISFIT
        || r.fit.scattered()
    {
        Level::Care
    } else {
        Level::Good
    }
}

fn headline(r: &Record, level: Level) -> String {
    let f = &r.fit;
    if let Some(apart_px) = sheet_elsewhere(r).filter(|_| f.converged && !contradicted(r)) {
        return format!(
            "Do not use this calibration: the cameras see the target that stood in the sheet {} px (rms) apart on it, so the sheet is not there.",
            plain(apart_px, 2)
        );
    }
    match level {
        Level::Bad if f.converged && contradicted(r) => format!(
            "Do not use this calibration: its images contradict each other by {} px (rms), where a few hundredths are usual.",
            plain(f.rms_px, 2)
        ),
        Level::Bad => format!(
            "Do not use this calibration: the adjustment stopped before its minimum ({}).",
            if f.termination.is_empty() { "no reason given" } else { &f.termination }
        ),
        Level::Care if imported(r) && f.termination == TRUTH => {
            "The true values of a simulated scene: nothing was measured.".into()
        }
        Level::Care if imported(r) => {
            "Cameras as another program found them: how certain they are is not known, for no image was looked at."
                .into()
        }
        Level::Care if shared_nullity(r) > 0 => format!(
            "Usable only for what is determined: {} of the solution {} not fixed by the images.",
            count(shared_nullity(r), "direction"),
            if shared_nullity(r) == 1 { "is" } else { "are" }
        ),
        Level::Care => "Usable, but first read what is not determined and what to look at.".into(),
        Level::Good if r.sheet.is_none() => {
            "The cameras are complete and consistent; where the laser sheet is, no image told.".into()
        }
        Level::Good => "The calibration is complete and consistent.".into(),
    }
}

/// Undetermined directions of what the views share.
fn shared_nullity(r: &Record) -> usize {
    r.fit.nullity.saturating_sub(r.covariance.null_directions.len() - r.covariance.shared_nullity())
}

/// Whether the residuals are no noise of any image that shows discs.
fn contradicted(r: &Record) -> bool {
    r.fit.rms_px > CONTRADICTED_PX && r.fit.sigma_scale.max(misfit(r)) > CONTRADICTED_SIGMAS
}

/// How far apart the cameras see the sheet's target on the sheet, px, where neither residuals nor standard deviations explain it.
fn sheet_elsewhere(r: &Record) -> Option<f64> {
    let apart_px = r.sheet.as_ref()?.disparity_rms_px?;
    let sigma_px = r.mapping_uncertainty.as_ref().map_or(0.0, |m| m.largest.disparity_px);
    (apart_px > CONTRADICTED_PX.max(CONTRADICTED_SIGMAS * r.fit.rms_px.max(sigma_px))).then_some(apart_px)
}

/// Root mean square of the residuals in units of the noise that they were given; 1 where it cannot be told.
fn misfit(r: &Record) -> f64 {
    let dof = r.fit.degrees_of_freedom;
    if dof == 0 || !r.fit.chi2.is_finite() { 1.0 } else { (r.fit.chi2 / dof as f64).sqrt() }
}

/// How the residuals compare with what the images' noise explains.
fn scatter(r: &Record) -> String {
    if r.fit.sigma_scale > SHOWN_SCALE {
        format!(
            "whole discs scatter up to {} times more than noise and roughness along their contours explain, and all sigmas \
             have been enlarged for it",
            plain(r.fit.sigma_scale, 2)
        )
    } else {
        let low = tables::why_low(r).map_or_else(String::new, |why| format!(" ({why})"));
        format!("that is {} times the scatter expected{low}", plain(misfit(r), 2))
    }
}

/// How many observations there are and how they agree.
fn agreement(r: &Record) -> String {
    let used = r.views.iter().filter(|v| v.used).count();
    let per_camera: Vec<_> = r.cameras.iter().map(|c| format!("{} {}", c.name, plain(c.rms_px, 3))).collect();
    format!(
        "{} of {} and {}: the places of discs agree to {} px rms ({} px); {}.",
        count(r.fit.observations, "observation"),
        count(r.cameras.len(), "camera"),
        count(used, "view"),
        plain(r.fit.rms_px, 3),
        per_camera.join(", "),
        scatter(r)
    )
}

/// On which side of the first camera the second one stands: whoever exchanged all images can see it here, and nowhere else.
fn side(r: &Record) -> Option<String> {
    let [first, second] = r.cameras.as_slice() else { return None };
    let at = second.cam_from_rig.motion::<Cam, Rig>().inverse().translation_mm;
    let word = match (at.x.abs() >= at.y.abs(), at.x > 0.0, at.y > 0.0) {
        _ if !(at.x.is_finite() && at.y.is_finite()) => return None,
        (true, true, _) => "to the right of",
        (true, false, _) => "to the left of",
        (false, _, true) => "below",
        (false, _, false) => "above",
    };
    Some(format!(", camera {} {word} camera {} as its images show it", second.name, first.name))
}

fn determined(r: &Record) -> Vec<String> {
    let mut out = Vec::new();
    if !imported(r) {
        out.push(agreement(r));
    }
    if let Some(rig) = &r.rig {
        out.push(format!(
            "The cameras stand {} apart{}; their lens axes make {}.",
            with_unit(rig.baseline_mm, rig.sigma.baseline_mm, "mm"),
            side(r).unwrap_or_default(),
            with_unit(rig.axes_angle_deg, rig.sigma.axes_angle_deg, "°")
        ));
    }
    if let Some(s) = &r.sheet {
        let disparity = s
            .disparity_rms_px
            .map_or(String::new(), |d| format!(" Both cameras see it coincide to {} px rms.", plain(d, 3)));
        out.push(format!(
            "The laser sheet lies {} from the first camera and makes {} with the baseline.{disparity}",
            with_unit(s.distance_mm, s.sigma.distance_mm, "mm"),
            with_unit(s.angle_to_baseline_deg, s.sigma.angle_to_baseline_deg, "°")
        ));
    }
    out.extend(r.mapping_uncertainty.as_ref().and_then(felt));
    if let Some(scale) = &r.scale {
        let given = if scale.sigma_mm > 0.0 || scale.sigma_mm.is_nan() {
            with_unit(scale.value_mm, scale.sigma_mm, "mm")
        } else {
            format!("{} mm, taken as exact", plain(scale.value_mm, 8))
        };
        out.push(format!("The scale comes from one given length: {} = {given}.", scale.fact));
    }
    out
}

/// What the calibration alone adds to a measured displacement.
fn felt(m: &MappingUncertainty) -> Option<String> {
    let percent = |x: f64| format!("{} %", plain(100.0 * x, 2));
    // A camera above the other makes of v what one beside it makes of u.
    let of = |l: &MappingSigma| {
        let by = &l.displacement;
        [by[0][0], by[1][1], by[2][2], by[0][2].max(by[1][2]), by[2][0].max(by[2][1]), l.disparity_px]
    };
    let is_known = |all: &[f64; 6]| all.iter().all(|x| x.is_finite());
    let stated = of(&m.largest);
    let all = Some(of(&m.at_worst())).filter(is_known).unwrap_or(stated);
    let [u, v, w, of_w, into_w, disparity_px] = all;
    m.largest.displacement.iter().flatten().chain(&stated).all(|x| x.is_finite()).then(|| {
        format!(
            "To a measured displacement the calibration adds, at worst over the sheet, {} of u, {} of v, {} of w, {} of w that leaks into u or v, and {} of u or v \
             that leaks into w; the two cameras' images lie on each other to {} px (one sigma each).{}",
            percent(u),
            percent(v),
            percent(w),
            percent(of_w),
            percent(into_w),
            plain(disparity_px, 2),
            larger_than_stated(m)
        )
    })
}

/// Where the views differ by more than their noise, or equations bend: what they say of that.
fn larger_than_stated(m: &MappingUncertainty) -> String {
    let [u, v, w] = m.enlarged();
    if [u, v, w] == [1.0; 3] {
        return String::new();
    }
    let beyond_noise = m.by_views.as_ref().is_some_and(|views| views.beyond_noise);
    let why = match (beyond_noise, &m.by_likelihood) {
        (true, None) => "The views, which differ by more than their noise, tell",
        (false, _) => {
            "The images hardly tell some numbers (an axis point of a lens without much distortion), and equations bend with these: their likelihood tells"
        }
        (true, Some(_)) => "The views, which differ by more than their noise, and equations that bend tell",
    };
    format!(
        " {why} {}, {} and {} times as much for u, v and w in the middle of the sheet; the standard deviations of vectors that spivcal reconstruct states are \
         enlarged so.",
        plain(u, 2),
        plain(v, 2),
        plain(w, 2)
    )
}

/// The words with a capital first letter, unless it is that of a name such as `right.k1`, and a full stop.
pub(super) fn sentence(words: &str) -> String {
    let mut chars = words.trim().chars();
    let Some(first) = chars.next() else { return String::new() };
    let begin = words.split_whitespace().next().unwrap_or_default().trim_end_matches(['.', ':', ',']);
    let mut out: String = match begin.contains(['.', '_']) {
        true => words.trim().into(),
        false => first.to_uppercase().chain(chars).collect(),
    };
    if !out.ends_with(['.', '!', '?', ':']) {
        out.push('.');
    }
    out
}

fn open_points(r: &Record) -> Vec<String> {
    let mut out: Vec<String> = r.fit.undetermined.iter().map(|w| sentence(w)).collect();
    out.extend(r.fit.near_null.iter().map(|n| format!("Weak: {}", sentence(&n.words))));
    if r.sheet.is_none() {
        out.push("The laser sheet: no view was recorded in it.".into());
    }
    let missing = r.views.iter().filter(|v| !v.used && v.why_unused != SHEET_ALONE).map(|v| {
        let why = if v.why_unused.is_empty() { "no reason given" } else { &v.why_unused };
        format!("View {} was not used: {why}.", v.index)
    });
    out.extend(missing);
    out
}

const NOTHING: &str = "Nothing has to be done.";
const BY_ITSELF: &str = "Nothing has to be done for displacements as long as what was known beforehand is right: what the images leave open is counted by it \
                         in the uncertainties of u, v and w. Where one of those numbers is needed by itself, record further views, tilted about other axes, \
                         or give it a prior in the rig file.";

/// What further views would help, and what else that is not known beforehand.
fn more_views(r: &Record) -> Option<String> {
    if imported(r) {
        let advice = "To know how certain they are, calibrate from images of a target (spivcal calibrate).";
        return (r.fit.termination != TRUTH).then(|| advice.into());
    }
    let used = r.views.iter().filter(|v| v.used).count();
    let what = "a printed target, or the sheet itself, tilted by a few degrees in one or more further views; a parallel shift does not help.";
    let mut out = match shared_nullity(r) {
        0 if used >= FEW_VIEWS => return None,
        0 if used == 1 => format!("One view can be checked against nothing: record {what}"),
        0 => format!("{} can hardly be checked against each other: record {what}", count(used, "view")),
        _ => format!("Record {what}"),
    };
    let priors = r.fit.diagnosis.iter().flat_map(|d| &d.priors).filter(|p| p.stated);
    let stated: Vec<&str> = priors.map(|p| p.name.as_str()).collect();
    let held = |c: &str| r.fit.parameters.iter().any(|p| p.name == format!("{c}.f_px") && p.known == Known::Fixed);
    let f_known = |c: &str| held(c) || stated.iter().any(|name| *name == format!("focal length f of camera {c}"));
    let focus = stated.iter().any(|name| name.contains("plane of focus"));
    out += match (r.cameras.iter().all(|c| f_known(&c.name)), focus) {
        (false, false) => " A known focal length or the focus relation ([focus] in the rig file) helps as well.",
        (true, false) => " The focus relation ([focus] in the rig file) helps as well.",
        (false, true) => " A known focal length helps as well.",
        (true, true) => "",
    };
    Some(out)
}

/// What helps views that keep an undetermined direction to themselves.
fn loose_views(r: &Record) -> Option<String> {
    let views = r.covariance.loose_views();
    let what = if r.cameras.len() > 1 { "the other camera's image of it" } else { "a target of known size" };
    let (view, listed) = match views.as_slice() {
        [] => return None,
        [one] => ("View", one.to_string()),
        all => ("Views", all.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    };
    Some(format!("{view} {listed}: what is open there harms nothing else; {what} would settle it."))
}

fn next_steps(r: &Record) -> Vec<String> {
    let mut out: Vec<String> = r.fit.flags.iter().map(|w| sentence(w)).collect();
    if !r.fit.converged {
        out.push(
            "Check that the right images stand beside the right cameras, and that the nominal values in the rig file are \
             near the truth; then run again."
                .into(),
        );
    }
    if sheet_elsewhere(r).is_some() {
        out.push(
            "Check that the target lay in the light in every view marked sheet = true, and did not move between the two cameras' images."
                .into(),
        );
    }
    let misfit = misfit(r);
    if misfit > MISFIT {
        let sigmas = if r.fit.sigma_scale > 1.0 {
            format!("all sigmas were enlarged {} times", plain(r.fit.sigma_scale, 3))
        } else {
            "the sigmas below do not allow for it".into()
        };
        out.push(format!(
            "The residuals are {} times the noise ({sigmas}). Look at the arrows: if they repeat from view to view, the \
             target is not what the rig file says (adjust = \"points\") or the lens needs another term; if they are \
             random, the images are noisier than they look.",
            plain(misfit, 3)
        ));
    }
    if r.fit.flags.iter().any(|f| f.starts_with(WHOLE_DISCS)) {
        out.push(format!(
            "Whole discs scatter {} times more than noise explains ({} px rms), and the sigmas were enlarged for it, but a wrong model moves results, too. \
             Look at the arrows: discs whose arrows point outwards or inwards in all views are of another size than stated; dots that lie elsewhere are \
             adjusted with adjust = \"points\".",
            plain(r.fit.sigma_scale, 3),
            plain(r.fit.rms_px, 3)
        ));
    }
    let said = r.fit.flags.iter().any(|f| f.contains("outlier"));
    if r.fit.outliers > 0 && !said {
        out.push(format!(
            "{} left out: see the list of outliers and the red marks in the images.",
            if r.fit.outliers == 1 { "1 outlier was".into() } else { format!("{} outliers were", r.fit.outliers) }
        ));
    }
    out.extend(r.cameras.iter().flat_map(|c| bad_views(r, &c.name)));
    out.extend(saturated(r));
    out.extend(too_black(r));
    out.extend(more_views(r));
    out.extend(loose_views(r));
    if r.sheet.is_none() {
        out.push("To get the sheet, record one view of the target in the light sheet and mark it sheet = true.".into());
    }
    if out.is_empty() {
        out.push(if r.fit.undetermined.is_empty() { NOTHING } else { BY_ITSELF }.into());
    }
    out
}

/// Images whose discs or their surroundings were cut off at the end of the scale.
fn saturated(r: &Record) -> Option<String> {
    let all: Vec<_> = r.provenance.images.iter().filter(|i| i.saturated > SATURATED).collect();
    let worst = all.iter().max_by(|a, b| a.saturated.total_cmp(&b.saturated))?;
    Some(format!(
        "{} about the discs at the end of the scale ({} the most, {} %): {CUT_OFF}.",
        if all.len() == 1 { "1 image has pixels".into() } else { format!("{} images have pixels", all.len()) },
        worst.path,
        plain(100.0 * worst.saturated, 2)
    ))
}

/// Images whose noise beside discs is cut off at grey level 0.
fn too_black(r: &Record) -> Option<String> {
    let all: Vec<_> = r.provenance.images.iter().filter(|i| i.cut_at_zero > CUT_AT_ZERO).collect();
    let worst = all.iter().max_by(|a, b| a.cut_at_zero.total_cmp(&b.cut_at_zero))?;
    Some(format!(
        "In {} noise beside the contours of discs is cut off at grey level 0 ({} the most, {} % of the pixels): {TOO_BLACK}.",
        count(all.len(), "image"),
        worst.path,
        plain(100.0 * worst.cut_at_zero, 2)
    ))
}

/// Residuals of a view below this are nobody's concern, however small the others are, px.
const VIEW_FINE_PX: f64 = 0.03;

fn bad_views(r: &Record, camera: &str) -> Vec<String> {
    let rms = |v: &View| v.rms_px.get(camera).copied().filter(|x| v.used && x.is_finite());
    let mut all: Vec<f64> = r.views.iter().filter_map(rms).collect();
    all.sort_by(f64::total_cmp);
    if all.len() < 3 {
        return Vec::new();
    }
    let median = all[all.len() / 2];
    r.views
        .iter()
        .filter_map(|v| rms(v).filter(|&x| x > (VIEW_MISFIT * median).max(VIEW_FINE_PX)).map(|x| (v.index, x)))
        .map(|(view, x)| {
            format!(
                "Look at view {view}, camera {camera}: its residual of {} px is {} times the median of this camera.",
                plain(x, 2),
                plain(x / median, 2)
            )
        })
        .collect()
}
