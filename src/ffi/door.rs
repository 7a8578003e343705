//! What every call goes through: lookup, poisoning, panics, the error text of the object.

use super::abi::*;
use super::table::{self, Body, Kind, Life, Object};
use crate::error::{Error, Invalid, Unusable};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLockReadGuard};

/// A call that did not do what it was asked for: status and words.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fault {
    pub(super) status: i32,
    pub(super) text: String,
}

impl Fault {
    pub(super) fn new(status: i32, text: impl Into<String>) -> Self {
        Self { status, text: text.into() }
    }

    pub(super) fn null(argument: &str) -> Self {
        Self::new(SPIVCAL_ERROR_NULL, format!("{argument} is a null pointer"))
    }

    pub(super) fn argument(text: impl Into<String>) -> Self {
        Self::new(SPIVCAL_ERROR_ARGUMENT, text)
    }

    pub(super) fn index(what: &str, index: u64, count: usize) -> Self {
        Self::new(SPIVCAL_ERROR_INDEX, format!("{what} {index} does not exist: there are {count}, counted from 0"))
    }

    /// Refuses an index where a key counts nothing.
    pub(super) fn unless_zero(index: u64) -> Result<(), Self> {
        let text = || format!("index {index}: this key counts nothing, its index is 0");
        if index == 0 { Ok(()) } else { Err(Self::new(SPIVCAL_ERROR_INDEX, text())) }
    }

    /// A handle that came as a further argument.
    pub(super) fn handle(argument: &str, status: i32) -> Self {
        let what = if status == SPIVCAL_ERROR_HANDLE_TYPE { "names another type of object" } else { "names no object" };
        Self::new(status, format!("{argument} {what}"))
    }
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Invalid(Invalid::Threads { .. } | Invalid::Memory { .. }) => SPIVCAL_ERROR_MEMORY,
            Error::Invalid(_) => SPIVCAL_ERROR_INVALID_INPUT,
            Error::Insufficient(_) => SPIVCAL_ERROR_INSUFFICIENT,
            Error::Unusable(Unusable::Cancelled) => SPIVCAL_ERROR_CANCELLED,
            Error::Unusable(_) => SPIVCAL_ERROR_UNUSABLE,
            Error::Bug(_) => SPIVCAL_ERROR_INTERNAL,
        };
        Self::new(status, error.to_string())
    }
}

/// What a call gives: a status that is no error, or a fault.
pub(super) type Outcome = Result<i32, Fault>;

/// A lock whose holder cannot have left it half done: what panicked is poisoned as an object.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Words of a panic, and what it leaves.
pub(super) fn panic_text(payload: &(dyn Any + Send), left: &str) -> String {
    let words = payload
        .downcast_ref::<&str>()
        .map(|s| (*s).to_string())
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".into());
    format!("internal error (panic): {words}; {left}; please report it")
}

/// The object of a handle. One of another type is told so in its own error text, unless that tells of a panic.
fn object_of(handle: u64, kind: Kind) -> Result<Arc<Object>, i32> {
    let object = table::find(handle)?;
    let found = object.body.kind();
    if found == kind {
        return Ok(object);
    }
    if !object.poisoned.load(Ordering::Acquire) {
        let text = format!("this handle names {}; the function takes {}", found.words(), kind.words());
        *lock(&object.error) = text;
    }
    Err(SPIVCAL_ERROR_HANDLE_TYPE)
}

/// Holds off the end of a context while a call is under way in it. There is no call within a call: the library calls nothing of the host.
fn under_way(life: &Life) -> RwLockReadGuard<'_, ()> {
    life.under_way.read().unwrap_or_else(PoisonError::into_inner)
}

/// Runs a call on an object of type `kind`.
pub(super) fn enter(handle: u64, kind: Kind, call: impl FnOnce(&Object) -> Outcome) -> i32 {
    let object = match object_of(handle, kind) {
        Ok(object) => object,
        Err(status) => return status,
    };
    let life = Arc::clone(&object.life);
    let under_way = under_way(&life);
    let status = if life.ends.load(Ordering::Acquire) { SPIVCAL_ERROR_HANDLE } else { run(&object, call) };
    // The last user of an object that was destroyed meanwhile ends it here.
    let ended = catch_unwind(AssertUnwindSafe(|| drop(object)));
    drop(under_way);
    if ended.is_err() { SPIVCAL_ERROR_PANIC } else { status }
}

fn run(object: &Arc<Object>, call: impl FnOnce(&Object) -> Outcome) -> i32 {
    if object.poisoned.load(Ordering::Acquire) {
        return SPIVCAL_ERROR_POISONED;
    }
    match catch_unwind(AssertUnwindSafe(|| call(object))) {
        Ok(Ok(status)) => status,
        Ok(Err(fault)) => {
            *lock(&object.error) = fault.text;
            fault.status
        }
        Err(payload) => {
            // These never change, or hold plain values alone (jobs): what was half done is what was to be made of them, and that is gone.
            let whole = !matches!(object.body, Body::Rig(_) | Body::Detection(_));
            object.poisoned.store(!whole, Ordering::Release);
            let left = match object.body {
                Body::Context(_) => "nothing was made",
                _ if whole => "this object is as it was",
                _ => "this object can only be destroyed now",
            };
            *lock(&object.error) = panic_text(&*payload, left);
            SPIVCAL_ERROR_PANIC
        }
    }
}

/// Runs a call that has no object to keep its error text.
pub(super) fn enter_without_object(call: impl FnOnce() -> Outcome) -> i32 {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(status)) => status,
        Ok(Err(fault)) => fault.status,
        Err(_) => SPIVCAL_ERROR_PANIC,
    }
}

/// Destroys an object; with a context everything that was made in it, when the calls that are under way there have returned.
pub(super) fn destroy(handle: u64, kind: Kind) -> i32 {
    enter_without_object(|| {
        let refused = |status| Fault::new(status, "");
        let life = Arc::clone(&object_of(handle, kind).map_err(refused)?.life);
        let all = kind == Kind::Context;
        let under_way = (!all).then(|| under_way(&life));
        let removed = table::remove(handle, kind).map_err(refused)?;
        // What still works in the context is stopped where it can be.
        life.ends.fetch_or(all, Ordering::AcqRel);
        for object in &removed {
            // Another thread may still hold the job while it waits for it; its own thread must not outlive this call.
            if let Body::Job(job) = &object.body {
                job.end();
            }
        }
        drop(removed);
        drop(under_way);
        if all {
            drop(life.under_way.write().unwrap_or_else(PoisonError::into_inner));
        }
        Ok(SPIVCAL_OK)
    })
}
