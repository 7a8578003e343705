//! The one error type: four families, by whose turn it is to act.
//!
//! | family | whose turn | exit code |
//! |---|---|---|
//! | [`Error::Invalid`] | the caller: a file, a key, a number is wrong | 2 |
//! | [`Error::Insufficient`] | the experimenter: the data cannot answer the question | 3 |
//! | [`Error::Unusable`] | the experimenter or the caller: no answer was reached | 3 |
//! | [`Error::Bug`] | us | 4 |
//!
//! Fields are numbers; the words are made in one place, here.

use thiserror::Error;

/// Result of every fallible function of the library.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, by whose turn it is.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Error {
    /// The caller gave something that has no meaning.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The images or views do not hold enough to answer.
    #[error(transparent)]
    Insufficient(#[from] Insufficient),
    /// Work ended before there was an answer that can be used.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// A promise of the library to itself was broken.
    #[error("internal error: {0}; please report it with the rig file")]
    Bug(String),
}

impl Error {
    /// Exit code of the program for this family (see `docs/` and `program.md` of the design).
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Invalid(_) => 2,
            Error::Insufficient(_) | Error::Unusable(_) => 3,
            Error::Bug(_) => 4,
        }
    }
}

/// Wrong input: the caller can mend it.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Invalid {
    /// A number that must be finite and within limits is not.
    #[error("{name} = {value} is not allowed: expected {expected}")]
    Value {
        /// Name as the user knows it.
        name: String,
        /// The offending value.
        value: f64,
        /// What would have been accepted.
        expected: String,
    },
    /// Text of a file does not say what it should.
    #[error("{file}:{line}: {message}")]
    Syntax {
        /// File as the user named it.
        file: String,
        /// Line, counted from 1; 0 where the whole file is meant.
        line: usize,
        /// What is wrong and what was expected.
        message: String,
    },
    /// A file cannot be read or written.
    #[error("{path}: {message}")]
    File {
        /// Path as the user named it.
        path: String,
        /// What happened and what to do.
        message: String,
    },
    /// An image has another size than the camera's other images.
    #[error(
        "{path}: the image is {width} x {height} px, but the other images of camera \"{camera}\" are {expected_width} x {expected_height} px; all images of a camera must have one size"
    )]
    ImageSize {
        /// Path of the image.
        path: String,
        /// Name of the camera.
        camera: String,
        /// Width found.
        width: usize,
        /// Height found.
        height: usize,
        /// Width of the camera's first image.
        expected_width: usize,
        /// Height of the camera's first image.
        expected_height: usize,
    },
    /// An image has another size than those that its camera was calibrated with.
    #[error(
        "{path}: the image is {width} x {height} px, but camera \"{camera}\" was calibrated with {expected_width} x {expected_height} px; record with the sensor area of the calibration, or calibrate anew"
    )]
    CalibratedSize {
        /// Path of the image.
        path: String,
        /// Name of the camera.
        camera: String,
        /// Width found.
        width: usize,
        /// Height found.
        height: usize,
        /// Width at the calibration.
        expected_width: usize,
        /// Height at the calibration.
        expected_height: usize,
    },
    /// The system starts no further thread.
    #[error("not all of {threads} threads can be started ({message}); ask for fewer, or end what holds so many")]
    Threads {
        /// Threads that were asked for.
        threads: usize,
        /// What the system says.
        message: String,
    },
    /// There is not as much memory as that.
    #[error("there is no memory for {what}, {bytes} bytes; ask for less, or end what holds so much")]
    Memory {
        /// What it is for.
        what: String,
        /// How much is needed.
        bytes: usize,
    },
    /// Two statements of the caller exclude each other.
    #[error("{0}")]
    Contradiction(String),
}

/// Not enough, or degenerate, data: the experimenter can mend it.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Insufficient {
    /// Fewer views than the model has unknowns for.
    #[error(
        "camera \"{camera}\" has {found} usable view(s), at least {needed} are needed; record the target in more positions, tilted differently"
    )]
    TooFewViews {
        /// Name of the camera.
        camera: String,
        /// Usable views found.
        found: usize,
        /// Views needed.
        needed: usize,
    },
    /// The image does not show the discs that the target has.
    #[error("{image}: found {found} disc(s), the target needs {needed}; {hint}")]
    TooFewDiscs {
        /// Image name.
        image: String,
        /// Discs found.
        found: usize,
        /// Discs needed.
        needed: usize,
        /// What was seen instead and what to do.
        hint: String,
    },
    /// The discs are there but do not form the target's pattern.
    #[error("{image}: {message}")]
    Pattern {
        /// Image name.
        image: String,
        /// What does not fit and what to do.
        message: String,
    },
    /// Two discs touch, overlap or contain one another: they do not have four common tangents.
    #[error(
        "the two discs are not separated (gap {gap:.3}, in the unit of their radii): they have no four common tangents; keep the discs apart"
    )]
    NotSeparated {
        /// Signed gap along the best separating direction; px in an image, mm on a target.
        gap: f64,
    },
    /// The views do not determine a quantity that the next step needs.
    #[error("{0}")]
    Degenerate(String),
    /// The adjustment fits one camera, but not the other with the same scene.
    #[error("{0}")]
    Inconsistent(String),
}

/// There is no result: work ended before it.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Unusable {
    /// The adjustment did not reach its minimum.
    #[error(
        "the adjustment stopped ({reason}) with a Newton decrement of {decrement:.2e}, wanted {wanted:.0e}, so there is no result; do the right images stand beside the right cameras and views, are nominal values near the truth, and is no sigma in the rig file far smaller than anyone can know?{besides}"
    )]
    NotConverged {
        /// Name of the termination.
        reason: String,
        /// Newton decrement reached, in sigmas.
        decrement: f64,
        /// Newton decrement wanted, in sigmas.
        wanted: f64,
        /// What else is known to stand in the way, a sentence after a blank; empty: nothing.
        besides: String,
    },
    /// The caller stopped the work.
    #[error("the work was stopped before it was done")]
    Cancelled,
}

impl Invalid {
    /// A [`Invalid::Value`] from borrowed words.
    pub fn value(name: impl Into<String>, value: f64, expected: impl Into<String>) -> Self {
        Invalid::Value { name: name.into(), value, expected: expected.into() }
    }
}

/// Refuses lists of other lengths than that of the first.
pub(crate) fn same_length(name: &str, wanted: usize, lists: &[&[f64]]) -> Result<()> {
    match lists.iter().find(|l| l.len() != wanted) {
        None => Ok(()),
        Some(l) => Err(Invalid::value(
            format!("number of {name}"),
            l.len() as f64,
            format!("lists of one length, as the first with {wanted}"),
        )
        .into()),
    }
}

/// That there is memory for so many bytes of what `what` says: without it the process would end where they are taken.
pub(crate) fn room(what: impl FnOnce() -> String, bytes: usize) -> Result<()> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| Invalid::Memory { what: what(), bytes }.into())
}

/// What a reader of files says of types, in words of its users.
pub(crate) fn in_plain_types(message: &str) -> String {
    let words = [
        ("expected f64", "expected a number"),
        ("expected usize", "expected a whole number"),
        ("expected u64", "expected a whole number"),
        ("expected u32", "expected a whole number"),
        ("expected i64", "expected a whole number"),
        ("expected i32", "expected a whole number"),
        ("expected u8", "expected a whole number"),
        ("expected an array of length", "expected a list of length"),
        ("expected a sequence", "expected a list"),
        ("invalid type: sequence", "invalid type: a list"),
        ("invalid type: map", "invalid type: a table"),
        ("missing field", "missing key"),
        ("unknown field", "unknown key"),
    ];
    words.iter().fold(message.to_owned(), |m, (from, to)| m.replace(from, to))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_told() {
        assert!(room(|| "nothing".into(), 0).is_ok());
        assert!(room(|| "an image".into(), 1 << 20).is_ok());
        let told = room(|| "searching an image of 9 x 9 px".into(), usize::MAX).map_err(|e| e.to_string());
        assert!(told.is_err_and(|e| e.starts_with("there is no memory for searching an image of 9 x 9 px, ")));
    }
}
