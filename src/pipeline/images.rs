//! Images to labelled discs, in parallel, each image by itself.

use super::blacks::cut_at_zero;
use super::exposure::{explained, saturated_about};
use super::{Progress, Source};
use crate::detect::pattern::{Labelling, label_discs};
use crate::detect::{DetectMemory, DetectOptions, Detection, LabelledDisc, Smoke, find_discs_while};
use crate::error::{Error, Insufficient, Invalid, Result, Unusable};
use crate::image::GrayImage;
use crate::record::ImageFile;
use crate::rig::OpenImage;
use crate::rig_file::{RigDescription, TargetDescription};
use crate::target::Target;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// One image with what was found in it.
#[derive(Debug, Clone)]
pub struct SeenImage {
    /// View of the rig file.
    pub view: usize,
    /// Camera of the rig file.
    pub camera: usize,
    /// Name as in the rig file.
    pub name: String,
    /// The image itself.
    pub image: Arc<GrayImage>,
    /// Everything found.
    pub detection: Detection,
    /// Discs of the target.
    pub discs: Vec<LabelledDisc>,
    /// Indices of discs found that are neither of the target nor marks of it.
    pub left_over: Vec<usize>,
    /// What the labelling assumed, in words.
    pub warnings: Vec<String>,
    /// Labels that the image alone leaves open.
    pub open: OpenImage,
    /// Part of the pixels about its discs that are at the end of the camera's scale.
    pub saturated: f64,
    /// Part of the pixels beside their contours whose noise is cut off at grey level 0.
    pub cut_at_zero: f64,
}

impl SeenImage {
    /// The image in the record.
    pub(super) fn file(&self, job: &RigDescription) -> ImageFile {
        ImageFile {
            path: self.name.clone(),
            view: self.view,
            camera: job.cameras[self.camera].name.clone(),
            sha256: None,
            saturated: self.saturated,
            cut_at_zero: self.cut_at_zero,
        }
    }
}

/// Loads, searches and labels all images of a job; order: views, then cameras.
pub(super) fn see_all(
    job: &RigDescription,
    source: &Source,
    progress: &Mutex<&mut (dyn FnMut(Progress) -> bool + Send)>,
) -> Result<Vec<SeenImage>> {
    let mut wanted = vec![];
    for (view, v) in job.views.iter().enumerate() {
        for (camera, name) in v.images.iter().enumerate() {
            wanted.extend(name.as_ref().map(|n| (view, camera, n.clone())));
        }
    }
    let names: Vec<([usize; 2], String)> = wanted.iter().map(|w| ([w.0, w.1], w.2.clone())).collect();
    let total = wanted.len();
    let done = Mutex::new(0usize);
    let stopped = AtomicBool::new(false);
    let memory = DetectMemory::default();
    // Every image is looked at even after one failed: the error told is the first in the order of the file, and the others are named.
    let all: Vec<Result<SeenImage>> = wanted
        .into_par_iter()
        .map(|(view, camera, name)| {
            if stopped.load(Ordering::Relaxed) {
                return Err(Unusable::Cancelled.into());
            }
            let go_on = || {
                // Whoever holds it asks for himself.
                if let Ok(mut tell) = progress.try_lock()
                    && !tell(Progress::Searching)
                {
                    stopped.store(true, Ordering::Relaxed);
                }
                !stopped.load(Ordering::Relaxed)
            };
            let seen = see(job, source, (view, camera, &name), &memory, &go_on);
            if let (Ok(mut n), Ok(mut tell)) = (done.lock(), progress.lock()) {
                *n += 1;
                if !tell(Progress::Image { done: *n, total, name: &name }) {
                    stopped.store(true, Ordering::Relaxed);
                }
            }
            seen
        })
        .collect();
    if stopped.load(Ordering::Relaxed) {
        return Err(Unusable::Cancelled.into());
    }
    let lacks = |seen: &Result<SeenImage>| matches!(seen, Err(Error::Insufficient(_)));
    let failed = all.iter().zip(&names).filter(|(seen, _)| lacks(seen));
    let failed: Vec<([usize; 2], &str)> = failed.map(|(_, (at, name))| (*at, name.as_str())).collect();
    let without = left_out(job, &failed);
    let failed: Vec<&str> = failed.iter().map(|(_, name)| *name).collect();
    let images: Vec<SeenImage> =
        all.into_iter().collect::<Result<_>>().map_err(|e| with_others(e, &failed, without))?;
    check_sizes(job, &images)?;
    refuse_repeated(job, &images)?;
    Ok(images)
}

/// Images named in a message at most.
const NAMED: usize = 24;

/// What can be done without the images (view and camera) that lack something: leave them out, or their views.
fn left_out(job: &RigDescription, failed: &[([usize; 2], &str)]) -> &'static str {
    let kept = |v: usize| -> usize {
        let named = |c: &usize| job.views[v].images[*c].is_some() && !failed.iter().any(|f| f.0 == [v, *c]);
        (0..job.cameras.len()).filter(named).count()
    };
    let views = |least: usize| (0..job.views.len()).filter(|v| kept(*v) >= least).count();
    let every_view_stays = failed.iter().all(|f| kept(f.0[0]) > 0);
    match job.cameras.len() {
        // As many as a camera needs, and one that both see.
        2 if every_view_stays && views(2) >= 2 => "; an image may also be left out: a view may lack a camera",
        _ if views(job.cameras.len()) >= 2 => "; the view may also be left out",
        _ => "",
    }
}

/// What an image lacks, with the others that lack something, and what can be done without them.
fn with_others(e: Error, failed: &[&str], without: &str) -> Error {
    let others = match failed {
        [] | [_] => String::new(),
        [_, others @ ..] => {
            let more = if others.len() > NAMED { ", ..." } else { "" };
            let named = others.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
            format!("; {} more of the images lack something, too: {named}{more}", others.len())
        }
    };
    match e {
        Error::Insufficient(Insufficient::TooFewDiscs { image, found, needed, hint }) => {
            Insufficient::TooFewDiscs { image, found, needed, hint: format!("{hint}{others}{without}") }.into()
        }
        Error::Insufficient(Insufficient::Pattern { image, message }) => {
            Insufficient::Pattern { image, message: format!("{message}{others}{without}") }.into()
        }
        e => e,
    }
}

/// What is known of the discs of a target.
fn options_for(target: &TargetDescription) -> DetectOptions {
    let smoke = if matches!(target.target, Target::Bubbles(_)) { Smoke::Full } else { Smoke::None };
    DetectOptions { polarity: target.polarity, smoke, ..DetectOptions::default() }
}

fn see(
    job: &RigDescription,
    source: &Source,
    (view, camera, name): (usize, usize, &str),
    memory: &DetectMemory,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Result<SeenImage> {
    let image = source(view, camera)?;
    let detection = find_discs_while(&image.view(), &options_for(&job.target), memory, go_on)?;
    let labelling: Labelling = label_discs(name, &detection, &job.target.target)
        .map_err(|e| explained(e, &job.target, name, &image.view()))?;
    if labelling.discs.is_empty() {
        return Err(
            Insufficient::Pattern { image: name.into(), message: "no disc of the target was found".into() }.into()
        );
    }
    let Labelling { discs, left_over, warnings, alternatives, origin_is_arbitrary, .. } = labelling;
    let open = OpenImage { alternatives, any_origin: origin_is_arbitrary };
    let own = || discs.iter().map(|d| &detection.discs[d.disc]);
    let (saturated, cut_at_zero) = (saturated_about(&image.view(), own()), cut_at_zero(&image.view(), own()));
    let name = name.into();
    Ok(SeenImage { view, camera, name, image, detection, discs, left_over, warnings, open, saturated, cut_at_zero })
}

fn check_sizes(job: &RigDescription, images: &[SeenImage]) -> Result<()> {
    for c in 0..job.cameras.len() {
        let mut own = images.iter().filter(|i| i.camera == c);
        let Some(first) = own.next() else {
            return Err(Insufficient::TooFewViews { camera: job.cameras[c].name.clone(), found: 0, needed: 2 }.into());
        };
        for i in own {
            if (i.image.width(), i.image.height()) != (first.image.width(), first.image.height()) {
                return Err(Invalid::ImageSize {
                    path: i.name.clone(),
                    camera: job.cameras[c].name.clone(),
                    width: i.image.width(),
                    height: i.image.height(),
                    expected_width: first.image.width(),
                    expected_height: first.image.height(),
                }
                .into());
            }
        }
    }
    Ok(())
}

/// Refuses a picture that stands in two places: noise makes every exposure another one, so it is the same file twice. It would count
/// as new evidence, and the standard deviations would come out too small.
fn refuse_repeated(job: &RigDescription, images: &[SeenImage]) -> Result<()> {
    for (k, second) in images.iter().enumerate() {
        let Some(first) = images[..k].iter().find(|first| first.image == second.image) else { continue };
        let place = |i: &SeenImage| format!("view {}, camera \"{}\" ({})", i.view, job.cameras[i.camera].name, i.name);
        return Err(Insufficient::Degenerate(format!(
            "{} and {} are one picture, equal to the last bit (views counted from 0): shown twice, it adds nothing; give each view \
             and camera its own image, or leave the view out of the rig file",
            place(first),
            place(second)
        ))
        .into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig_file::Adjust;
    use crate::target::{Pair, Polarity};

    /// Bubbles are full of smoke, printed discs are not.
    #[test]
    fn the_target_says_what_its_discs_are_full_of() {
        let (polarity, adjust, point_sigma_mm) = (Polarity::Bright, Adjust::Shape, None);
        let of = |target| options_for(&TargetDescription { target, polarity, adjust, point_sigma_mm });
        let bubbles = of(Target::Bubbles(Pair::default()));
        assert!(bubbles.smoke == Smoke::Full && bubbles.polarity == Polarity::Bright);
        assert_eq!(of(Target::TwoDiscs(Pair::default())).smoke, Smoke::None);
    }
}
