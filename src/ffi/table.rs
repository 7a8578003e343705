//! The handle table: the only global state of the library.
//!
//! ```text
//! handle = type << 48 | generation << 20 | index        below 2^52: exact also where a host keeps it in a double
//! ```
//! A slot counts its generations, so that a handle of a destroyed object never names the object that took its place.

use super::context::Context;
use super::detection::DetectionState;
use super::door::Fault;
use super::job::Job;
use super::results::CalibrationState;
use super::rig::RigState;
use super::{SPIVCAL_ERROR_HANDLE, SPIVCAL_ERROR_HANDLE_TYPE, SPIVCAL_ERROR_MEMORY};
use crate::image::GrayImage;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

const INDEX_BITS: u32 = 20;
const GENERATION_BITS: u32 = 28;
const INDEX_MASK: u64 = (1 << INDEX_BITS) - 1;
const GENERATION_MASK: u64 = (1 << GENERATION_BITS) - 1;

/// What a handle names; the numbers are part of the handle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Context = 1,
    Image = 2,
    Detection = 3,
    Rig = 4,
    Job = 5,
    Calibration = 6,
}

impl Kind {
    pub(super) const ALL: [Kind; 6] =
        [Kind::Context, Kind::Image, Kind::Detection, Kind::Rig, Kind::Job, Kind::Calibration];

    /// What it is called in messages.
    pub(super) fn words(self) -> &'static str {
        match self {
            Kind::Context => "a context",
            Kind::Image => "an image",
            Kind::Detection => "a detection",
            Kind::Rig => "a rig description",
            Kind::Job => "a job",
            Kind::Calibration => "a calibration",
        }
    }
}

/// What an object holds.
pub(super) enum Body {
    Context(Context),
    Image(Arc<GrayImage>),
    Detection(Mutex<DetectionState>),
    Rig(Mutex<RigState>),
    Job(Job),
    Calibration(Arc<CalibrationState>),
}

impl Body {
    pub(super) fn kind(&self) -> Kind {
        match self {
            Body::Context(_) => Kind::Context,
            Body::Image(_) => Kind::Image,
            Body::Detection(_) => Kind::Detection,
            Body::Rig(_) => Kind::Rig,
            Body::Job(_) => Kind::Job,
            Body::Calibration(_) => Kind::Calibration,
        }
    }
}

/// Whether a context lives, for all that was made in it.
#[derive(Default)]
pub(super) struct Life {
    /// Its destruction has begun.
    pub(super) ends: AtomicBool,
    /// Held shared by every call that is under way in it.
    pub(super) under_way: RwLock<()>,
}

/// An object behind a handle.
pub(super) struct Object {
    /// Handle of the context it was made in; 0 for a context.
    pub(super) context: u64,
    /// That of its context.
    pub(super) life: Arc<Life>,
    pub(super) body: Body,
    /// Text of the last call that failed.
    pub(super) error: Mutex<String>,
    /// Set by a panic: whatever the object holds may be half done.
    pub(super) poisoned: AtomicBool,
}

struct Slot {
    generation: u64,
    object: Option<Arc<Object>>,
}

struct Table {
    slots: Vec<Slot>,
    free: Vec<usize>,
}

static TABLE: RwLock<Table> = RwLock::new(Table { slots: Vec::new(), free: Vec::new() });

fn encode(kind: Kind, generation: u64, index: usize) -> u64 {
    (kind as u64) << (INDEX_BITS + GENERATION_BITS) | generation << INDEX_BITS | index as u64
}

fn kind_of(handle: u64) -> Option<Kind> {
    let number = handle >> (INDEX_BITS + GENERATION_BITS);
    Kind::ALL.into_iter().find(|k| *k as u64 == number)
}

fn index_of(handle: u64) -> usize {
    (handle & INDEX_MASK) as usize
}

impl Slot {
    fn holds(&self, handle: u64) -> bool {
        self.generation == (handle >> INDEX_BITS & GENERATION_MASK)
    }
}

/// What is said of an object whose context was destroyed meanwhile.
pub(super) fn gone() -> Fault {
    Fault::new(SPIVCAL_ERROR_HANDLE, "the context was destroyed")
}

/// Puts an object into the table and gives its handle.
pub(super) fn insert(context: u64, body: Body) -> Result<u64, Fault> {
    let kind = body.kind();
    let mut table = TABLE.write().unwrap_or_else(PoisonError::into_inner);
    // Another thread may have destroyed the context since the call began; nothing may be left behind in it.
    let owner = table.slots.get(index_of(context)).filter(|s| s.holds(context)).and_then(|s| s.object.as_ref());
    let life = match owner {
        _ if kind == Kind::Context => Arc::default(),
        Some(owner) => Arc::clone(&owner.life),
        None => return Err(gone()),
    };
    let object = Object { context, life, body, error: Mutex::default(), poisoned: AtomicBool::new(false) };
    let index = match table.free.pop() {
        Some(index) => index,
        None if table.slots.len() as u64 > INDEX_MASK || table.slots.try_reserve(1).is_err() => {
            let count = table.slots.len();
            // The object may have a thread to wait for: nobody else has to.
            drop(table);
            let text = format!("there are {count} objects already; destroy those that are not used");
            return Err(Fault::new(SPIVCAL_ERROR_MEMORY, text));
        }
        None => {
            table.slots.push(Slot { generation: 1, object: None });
            table.slots.len() - 1
        }
    };
    let slot = &mut table.slots[index];
    slot.object = Some(Arc::new(object));
    Ok(encode(kind, slot.generation, index))
}

/// The object of a handle, of any type.
pub(super) fn find(handle: u64) -> Result<Arc<Object>, i32> {
    let kind = kind_of(handle).ok_or(SPIVCAL_ERROR_HANDLE)?;
    let table = TABLE.read().unwrap_or_else(PoisonError::into_inner);
    let slot = table.slots.get(index_of(handle)).filter(|s| s.holds(handle)).ok_or(SPIVCAL_ERROR_HANDLE)?;
    let object = slot.object.as_ref().filter(|o| o.body.kind() == kind).ok_or(SPIVCAL_ERROR_HANDLE)?;
    Ok(Arc::clone(object))
}

/// The object of a handle of the type wanted.
pub(super) fn find_kind(handle: u64, wanted: Kind) -> Result<Arc<Object>, i32> {
    let object = find(handle)?;
    if object.body.kind() == wanted { Ok(object) } else { Err(SPIVCAL_ERROR_HANDLE_TYPE) }
}

/// Takes an object out of the table, and with a context everything that was made in it; they end when the last call
/// that uses them returns.
pub(super) fn remove(handle: u64, wanted: Kind) -> Result<Vec<Arc<Object>>, i32> {
    find_kind(handle, wanted)?;
    let mut table = TABLE.write().unwrap_or_else(PoisonError::into_inner);
    let table = &mut *table;
    let mut removed = Vec::new();
    for (index, slot) in table.slots.iter_mut().enumerate() {
        let own = index == index_of(handle) && slot.holds(handle);
        let child = wanted == Kind::Context && slot.object.as_ref().is_some_and(|o| o.context == handle);
        if !(own || child) {
            continue;
        }
        if let Some(object) = slot.object.take() {
            removed.push(object);
            // A slot that has used up its generations is never used again.
            if slot.generation < GENERATION_MASK {
                slot.generation += 1;
                table.free.push(index);
            }
        }
    }
    // Two threads may destroy the same handle at once: one of them comes too late.
    if removed.is_empty() { Err(SPIVCAL_ERROR_HANDLE) } else { Ok(removed) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_handle_survives_a_double_and_names_its_parts() {
        let handle = encode(Kind::Calibration, GENERATION_MASK, INDEX_MASK as usize);
        assert_eq!(handle as f64 as u64, handle);
        assert!(handle < 1 << 52);
        assert_eq!(kind_of(handle), Some(Kind::Calibration));
        assert_eq!(index_of(handle) as u64, INDEX_MASK);
        assert_eq!(kind_of(0), None);
        assert_eq!(kind_of(u64::MAX), None);
        for kind in Kind::ALL {
            assert_eq!(kind_of(encode(kind, 1, 0)), Some(kind));
        }
    }
}
