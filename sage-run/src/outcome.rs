//! How a command ends, and the exit code that says so to a scheduler.

use std::{
    error::Error,
    fmt,
    io::{self, ErrorKind},
    process::ExitCode,
};

use advsage::as_cause;
use anyhow::Result;
use sage_core::{
    defect::{self, Defect},
    files::LockError,
};

use crate::progress;

/// Result of a command that ran to its end.
///
/// ```
/// use sage_run::Outcome;
///
/// // What a scheduler sees: try again at 74, look at the scenes at 65, report a defect at 70.
/// let codes = [Outcome::Done, Outcome::BadScenes, Outcome::Defect, Outcome::Retry].map(Outcome::code);
/// assert_eq!(codes, [0, 65, 70, 74]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All work is done.
    Done,
    /// What was checked does not hold: tests fail, or a claim does.
    NotHeld,
    /// Some scenes are bad and were named; the others are done. Another try changes nothing.
    BadScenes,
    /// Some scenes could not be read or written; another try may succeed.
    Retry,
    /// Scenes met a defect of this program; the others are done.
    Defect,
}

/// `EX_DATAERR` of `sysexits.h`.
const BAD_SCENES: u8 = 65;
/// `EX_IOERR` of `sysexits.h`.
const RETRY: u8 = 74;
/// `EX_SOFTWARE` of `sysexits.h`.
const DEFECT: u8 = 70;

impl Outcome {
    /// The exit code.
    pub fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::NotHeld => 1,
            Self::BadScenes => BAD_SCENES,
            Self::Retry => RETRY,
            Self::Defect => DEFECT,
        }
    }
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        Self::from(outcome.code())
    }
}

/// The result of work on a scene. A panic within is an error of that scene.
///
/// *Errors*: those of `work`; a [`defect::Defect`].
pub fn caught<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    defect::caught(work)?
}

/// The results without those of scenes that met a defect, which are named.
///
/// *Errors*: the first other error, in the order of the scenes.
pub fn without_defects<T>(all: Vec<Result<T>>) -> Result<Vec<T>> {
    let is_defect = |result: &Result<T>| {
        let error = result.as_ref().err().filter(|error| error.is::<Defect>());
        error.inspect(|error| progress::say(&format!("error: {error:#}"))).is_some()
    };
    all.into_iter().filter(|result| !is_defect(result)).collect()
}

/// The exit code of a command that an error ended.
pub fn code_of(error: &anyhow::Error) -> u8 {
    if may_succeed_later(error) {
        return Outcome::Retry.code();
    }
    error.downcast_ref().map_or(1, |EndsWith(outcome, _)| outcome.code())
}

/// An error that ends a command with another outcome than failure.
#[derive(Debug)]
pub struct EndsWith(pub Outcome, pub anyhow::Error);

impl fmt::Display for EndsWith {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.1)
    }
}

impl Error for EndsWith {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.1.source()
    }
}

/// True if the system refused to read or write, or another run holds the output, so that another try may succeed. A path
/// that does not exist, or is of the wrong kind, is the user's.
pub fn may_succeed_later(error: &anyhow::Error) -> bool {
    error
        .chain()
        .any(|cause| matches!(cause.downcast_ref(), Some(LockError::Held { .. })) || is_refusal(cause))
}

/// True if an error is one of the system, which refused to read or write.
pub fn is_refusal(error: &(dyn Error + 'static)) -> bool {
    as_cause::<io::Error>(error).is_some_and(is_of_the_system)
}

/// The same for an error of one scene, whose file was there when the scenes were listed.
pub fn may_pass(error: &anyhow::Error) -> bool {
    let is_gone = |cause: &(dyn Error + 'static)| {
        as_cause::<io::Error>(cause).is_some_and(|error| error.kind() == ErrorKind::NotFound)
    };
    may_succeed_later(error) || error.chain().any(is_gone)
}

/// True for an error of the system; those of our readers about what a file holds have neither a number nor such a kind.
fn is_of_the_system(error: &io::Error) -> bool {
    // Temporary files wrap errors and drop their numbers.
    let is_refusal = matches!(
        error.kind(),
        ErrorKind::PermissionDenied
            | ErrorKind::ReadOnlyFilesystem
            | ErrorKind::StaleNetworkFileHandle
            | ErrorKind::ResourceBusy
            | ErrorKind::TimedOut
    );
    let is_wrong_path = matches!(
        error.kind(),
        ErrorKind::NotFound
            | ErrorKind::AlreadyExists
            | ErrorKind::IsADirectory
            | ErrorKind::NotADirectory
            | ErrorKind::InvalidInput
            | ErrorKind::InvalidFilename
    );
    is_refusal || sage_core::files::is_disk_full(error) || (error.raw_os_error().is_some() && !is_wrong_path)
}

#[cfg(test)]
mod tests {
    use anyhow::{Context as _, anyhow};

    use super::*;

    fn of(error: io::Error) -> bool {
        may_succeed_later(&Err::<(), _>(error).context("cannot read `a`").unwrap_err())
    }

    #[test]
    fn errors_of_the_system_may_pass_and_errors_of_content_stay() {
        for number in [5, 13, 28, 116] {
            assert!(of(io::Error::from_raw_os_error(number)), "{number}");
        }
        for number in [2, 20, 21] {
            assert!(!of(io::Error::from_raw_os_error(number)), "{number}");
        }
        assert!(!of(io::Error::new(ErrorKind::InvalidData, "damaged")));
        assert!(!of(ErrorKind::UnexpectedEof.into()));
        assert!(of(ErrorKind::StorageFull.into()));
        assert!(of(io::Error::new(ErrorKind::ReadOnlyFilesystem, "wrapped")));
        let held = LockError::Held { path: "a".into(), holder: "process 1".to_owned() };
        assert!(may_succeed_later(&held.into()));
    }

    #[test]
    fn a_defect_costs_one_result_and_another_error_ends_all() {
        let one = |number: usize| caught(|| Ok([1, 2][number])).with_context(|| format!("scene {number}"));
        let kept = without_defects(vec![one(0), one(5), one(1)]).unwrap();
        assert_eq!(kept, [1, 2]);
        assert!(without_defects(vec![one(0), one(5), Err(anyhow!("damaged"))]).is_err());
    }
}
