//! Long work: in the calling thread, or in a thread of its own that is polled, waited for or stopped.

use super::abi::*;
use super::detection::context_of;
use super::door::{Fault, Outcome, destroy, enter, lock, panic_text};
use super::keys::*;
use super::memory::{Out, Plain};
use super::results::{CalibrationState, calibration_of, keep};
use super::rig::{Task, rig_state};
use super::table::{self, Body, Kind, Object};
use crate::error::{Error, Invalid};
use crate::pipeline::{CalibrateOptions, Progress, STACK_BYTES, SheetOptions, calibrate, find_sheet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// What is to be done.
struct Work {
    task: Task,
    /// Cameras known: the sheet alone is wanted.
    known: Option<Arc<CalibrationState>>,
    threads: usize,
}

impl Work {
    fn of(rig: &Object, calibration: Option<u64>) -> Result<Self, Fault> {
        let known = calibration.map(calibration_of).transpose()?;
        Ok(Self { task: rig_state(rig)?.task()?, known, threads: context_of(rig)?.threads })
    }

    fn run(&self, progress: &mut (dyn FnMut(Progress) -> bool + Send)) -> Result<CalibrationState, Fault> {
        let Task { job, .. } = &self.task;
        let source = |view: usize, camera: usize| self.task.image(view, camera);
        let (record, residuals) = match &self.known {
            Some(known) => {
                let options = SheetOptions { threads: self.threads };
                (find_sheet(job, &source, &known.record, &options, progress)?.record, None)
            }
            None => {
                let options = CalibrateOptions { threads: self.threads, ..CalibrateOptions::default() };
                let output = calibrate(job, &source, &options, progress)?;
                (output.record, Some(output.residuals))
            }
        };
        CalibrationState::new(record, residuals)
    }
}

/// How far a job is.
#[derive(Clone, Copy)]
struct Stage {
    images_done: u64,
    images: u64,
    iteration: u64,
    decrement: f64,
}

/// What the job's thread and its callers share.
struct Shared {
    cancelled: AtomicBool,
    stage: Mutex<Stage>,
    result: Mutex<Option<Result<Arc<CalibrationState>, Fault>>>,
    ended: Condvar,
}

impl Shared {
    fn tell(&self, progress: Progress) -> bool {
        let mut stage = lock(&self.stage);
        match progress {
            Progress::Image { done, total, .. } => (stage.images_done, stage.images) = (done as u64, total as u64),
            Progress::Searching => {}
            Progress::Iteration { number, decrement, .. } => {
                (stage.iteration, stage.decrement) = (number as u64, decrement);
            }
        }
        !self.cancelled.load(Ordering::Relaxed)
    }

    fn work(&self, work: &Work) {
        let done = catch_unwind(AssertUnwindSafe(|| work.run(&mut |p| self.tell(p))));
        let result = match done {
            Ok(_) if self.cancelled.load(Ordering::Relaxed) => {
                Err(Fault::new(SPIVCAL_ERROR_CANCELLED, "the job was stopped by spivcal_job_cancel"))
            }
            Ok(result) => result.map(Arc::new),
            Err(payload) => Err(Fault::new(SPIVCAL_ERROR_PANIC, panic_text(&*payload, "the job has no result"))),
        };
        *lock(&self.result) = Some(result);
        self.ended.notify_all();
    }

    fn state(&self) -> i32 {
        match &*lock(&self.result) {
            None => SPIVCAL_JOB_RUNNING,
            Some(Ok(_)) => SPIVCAL_JOB_DONE,
            Some(Err(fault)) if fault.status == SPIVCAL_ERROR_CANCELLED => SPIVCAL_JOB_CANCELLED,
            Some(Err(_)) => SPIVCAL_JOB_FAILED,
        }
    }
}

/// A job; its thread has ended when it is dropped.
pub(super) struct Job {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Job {
    fn start(work: Work) -> Result<Self, Fault> {
        let shared = Arc::new(Shared {
            cancelled: AtomicBool::new(false),
            stage: Mutex::new(Stage { images_done: 0, images: 0, iteration: 0, decrement: f64::NAN }),
            result: Mutex::new(None),
            ended: Condvar::new(),
        });
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("spivcal-job".into())
            .stack_size(STACK_BYTES)
            .spawn(move || own.work(&work))
            .map_err(|e| Error::from(Invalid::Threads { threads: 1, message: e.to_string() }))?;
        Ok(Self { shared, thread: Mutex::new(Some(thread)) })
    }

    /// Stops the work and waits for its thread, also while other threads still wait for the job.
    pub(super) fn end(&self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
        if let Some(thread) = lock(&self.thread).take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Job {
    fn drop(&mut self) {
        self.end();
    }
}

/// Calibrates cameras, rig, target and sheet; blocks until it is done.
///
/// `rig`: the description with its images, in which discs are looked for as its target asks (detections are of no use here). `calibration`: receives
/// the handle of the result. Nothing but the end of its context stops it: a host that lets its user cancel takes spivcal_job_start.
/// SPIVCAL_OK; SPIVCAL_WARNING_FLAGGED with a result that must be looked at; SPIVCAL_ERROR_INVALID_INPUT,
/// SPIVCAL_ERROR_INSUFFICIENT or SPIVCAL_ERROR_UNUSABLE without one. The error text belongs to `rig`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_run(rig: u64, calibration: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter(rig, Kind::Rig, |object| unsafe { at_once(object, None, calibration) })
}

/// Finds the laser sheet alone, from the views of `rig` recorded in the sheet, with the cameras of a calibration held.
///
/// `cameras`: handle of that calibration; its sigmas are part of those of the sheet. `calibration`: receives the handle of the
/// result, a calibration with the new sheet. Its views are those of `cameras`, none of them in the sheet any more, and after them those of `rig` that found it,
/// not used for the cameras; fit and verdict are those of the cameras, and there is no table of residuals. Cameras behind windows are refused. Blocks; status and
/// error text as for spivcal_calibration_run.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_calibration_run_sheet(rig: u64, cameras: u64, calibration: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter(rig, Kind::Rig, |object| unsafe { at_once(object, Some(cameras), calibration) })
}

/// # Safety
/// `calibration` is null or can be written.
unsafe fn at_once(rig: &Object, known: Option<u64>, calibration: *mut u64) -> Outcome {
    // SAFETY: the contract of this function.
    let out = unsafe { Out::new(calibration, "calibration") }?;
    let ends = || rig.life.ends.load(Ordering::Acquire);
    let state = Work::of(rig, known)?.run(&mut |_| !ends());
    let state = state.map_err(|fault| if ends() { table::gone() } else { fault })?;
    keep(rig.context, Arc::new(state), out)
}

/// Starts spivcal_calibration_run in a thread of its own.
///
/// The description is copied: `rig` may be changed or destroyed meanwhile. `job`: receives the handle. What is wrong with the description
/// itself is found here (SPIVCAL_ERROR_INVALID_INPUT), with the images by spivcal_job_result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_job_start(rig: u64, job: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter(rig, Kind::Rig, |object| unsafe { start(object, None, job) })
}

/// Starts spivcal_calibration_run_sheet in a thread of its own; as spivcal_job_start.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_job_start_sheet(rig: u64, cameras: u64, job: *mut u64) -> i32 {
    // SAFETY: the contract of the header.
    enter(rig, Kind::Rig, |object| unsafe { start(object, Some(cameras), job) })
}

/// # Safety
/// `job` is null or can be written.
unsafe fn start(rig: &Object, known: Option<u64>, job: *mut u64) -> Outcome {
    // SAFETY: the contract of this function.
    let out = unsafe { Out::new(job, "job") }?;
    out.set(table::insert(rig.context, Body::Job(Job::start(Work::of(rig, known)?)?))?);
    Ok(SPIVCAL_OK)
}

/// How far a job is; returns at once.
///
/// `state`: receives SPIVCAL_JOB_*. The others may be NULL: `images_done` and `images` count searched images, `iteration` counts the
/// steps of the adjustment that runs (there are several), `decrement` is how far its last step was from the minimum, in sigmas (NaN
/// before the first).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_job_poll(
    job: u64,
    state: *mut i32,
    images_done: *mut u64,
    images: *mut u64,
    iteration: *mut u64,
    decrement: *mut f64,
) -> i32 {
    on(job, |shared| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(state, "state") }?;
        let stage = *lock(&shared.stage);
        out.set(shared.state());
        // SAFETY: the contract of the header.
        unsafe {
            set_unless_null(images_done, stage.images_done);
            set_unless_null(images, stage.images);
            set_unless_null(iteration, stage.iteration);
            set_unless_null(decrement, stage.decrement);
        }
        Ok(SPIVCAL_OK)
    })
}

/// # Safety
/// `to` is null or can be written.
unsafe fn set_unless_null<T: Plain>(to: *mut T, value: T) {
    // SAFETY: the contract of this function.
    if let Ok(out) = unsafe { Out::new(to, "") } {
        out.set(value);
    }
}

/// Waits until a job has ended, or the time is over.
///
/// `timeout_ms`: milliseconds; negative: as long as it takes. `state`: receives SPIVCAL_JOB_*.
/// SPIVCAL_OK where it has ended, SPIVCAL_WARNING_RUNNING where it still runs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_job_wait(job: u64, timeout_ms: i32, state: *mut i32) -> i32 {
    on(job, |shared| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(state, "state") }?;
        let runs = |r: &mut Option<_>| r.is_none();
        let result = lock(&shared.result);
        match u64::try_from(timeout_ms) {
            Ok(ms) => drop(shared.ended.wait_timeout_while(result, Duration::from_millis(ms), runs)),
            Err(_) => drop(shared.ended.wait_while(result, runs).unwrap_or_else(PoisonError::into_inner)),
        }
        let state = shared.state();
        out.set(state);
        Ok(if state == SPIVCAL_JOB_RUNNING { SPIVCAL_WARNING_RUNNING } else { SPIVCAL_OK })
    })
}

/// Asks a job to stop; returns at once. It ends after the discs that are just fitted, the iteration that just runs, or the part of the
/// diagnosis that is at work; finding the sheet alone is not interrupted once its images are searched.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_job_cancel(job: u64) -> i32 {
    on(job, |shared| {
        shared.cancelled.store(true, Ordering::Relaxed);
        Ok(SPIVCAL_OK)
    })
}

/// The result of a job that has ended.
///
/// `calibration`: receives a handle, which lives on when the job is destroyed; a further call gives a further handle.
/// Status as for spivcal_calibration_run, the error text is that of the job from this call on; SPIVCAL_ERROR_RUNNING where it has not ended, SPIVCAL_ERROR_CANCELLED where it was stopped.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spivcal_job_result(job: u64, calibration: *mut u64) -> i32 {
    enter(job, Kind::Job, |object| {
        // SAFETY: the contract of the header.
        let out = unsafe { Out::new(calibration, "calibration") }?;
        let result = lock(&shared_of(object)?.result).clone();
        let running = || Fault::new(SPIVCAL_ERROR_RUNNING, "the job has not ended yet; see spivcal_job_wait");
        keep(object.context, result.ok_or_else(running)??, out)
    })
}

/// Destroys a job; where it still runs, it is stopped and waited for.
#[unsafe(no_mangle)]
pub extern "C" fn spivcal_job_destroy(job: u64) -> i32 {
    destroy(job, Kind::Job)
}

fn shared_of(object: &Object) -> Result<&Shared, Fault> {
    match &object.body {
        Body::Job(job) => Ok(&job.shared),
        _ => Err(Fault::argument("this is no job")),
    }
}

fn on(job: u64, call: impl FnOnce(&Shared) -> Outcome) -> i32 {
    enter(job, Kind::Job, |object| call(shared_of(object)?))
}
