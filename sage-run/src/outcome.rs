//! How a command ends, and the exit code that says so to a scheduler.

use std::{
    io::{self, ErrorKind},
    process::ExitCode,
};

use advsage::in_one_line;
use sage_core::{
    defect::{self, Defect},
    files::LockError,
};

use crate::{
    error::{AnyError, Error, Result, causes, io_causes},
    progress,
};

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
pub fn caught<T, E: From<Error>>(work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    defect::caught(work).map_err(Error::Defect)?
}

/// The results without those of scenes that met a defect, which are named.
///
/// *Errors*: the first other error, in the order of the scenes.
pub fn without_defects<T, E: AsRef<AnyError>>(all: Vec<Result<T, E>>) -> Result<Vec<T>, E> {
    let is_left_out = |result: &Result<T, E>| {
        let error = result.as_ref().err().map(AsRef::as_ref).filter(|error| is_defect(*error));
        error.inspect(|error| progress::say(&format!("error: {}", in_one_line(*error)))).is_some()
    };
    all.into_iter().filter(|result| !is_left_out(result)).collect()
}

/// True if an error is a panic of this program.
pub fn is_defect(error: &AnyError) -> bool {
    causes(error).any(|cause| cause.is::<Defect>())
}

/// The exit code of a command that an error ended.
pub fn code_of(error: &AnyError) -> u8 {
    let outcome = |cause: &AnyError| match cause.downcast_ref() {
        Some(Error::BadScenes(_)) => Some(Outcome::BadScenes),
        Some(Error::Retry(_)) => Some(Outcome::Retry),
        _ => None,
    };
    let outcome =
        if may_succeed_later(error) { Some(Outcome::Retry) } else { causes(error).find_map(outcome) };
    outcome.map_or(1, Outcome::code)
}

/// True if the system refused to read or write, or another run holds the output, so that another try may succeed. A path
/// that does not exist, or is of the wrong kind, is the user's.
pub fn may_succeed_later(error: &AnyError) -> bool {
    let is_held = |cause: &AnyError| matches!(cause.downcast_ref(), Some(LockError::Held { .. }));
    io_causes(error).any(is_of_the_system) || causes(error).any(is_held)
}

/// The same for an error of one scene, whose file was there when the scenes were listed.
pub fn may_pass(error: &AnyError) -> bool {
    may_succeed_later(error) || io_causes(error).any(|error| error.kind() == ErrorKind::NotFound)
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
    use super::*;

    fn of(error: io::Error) -> bool {
        may_succeed_later(&Error::from(error).within("cannot read `a`"))
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
        let held = Error::Lock(held).within("shard 1");
        assert!(may_succeed_later(&held));
        // Also as a cause of an error of the caller.
        #[derive(Debug, thiserror::Error)]
        #[error("the command")]
        struct Command(#[source] Error);
        let bad = |error| Command(Error::BadScenes(Box::new(error)));
        assert_eq!(code_of(&bad(held)), RETRY);
        assert_eq!(code_of(&bad(Error::Refused("damaged".to_owned()))), BAD_SCENES);
        assert_eq!(code_of(&Error::Refused("damaged".to_owned())), 1);
    }

    #[test]
    fn a_defect_costs_one_result_and_another_error_ends_all() {
        let one = |number: usize| {
            caught(|| Ok([1, 2][number])).map_err(|error: Error| error.within(format!("scene {number}")))
        };
        let kept = without_defects(vec![one(0), one(5), one(1)]).unwrap();
        assert_eq!(kept, [1, 2]);
        assert!(without_defects(vec![one(0), one(5), Err(Error::Refused("damaged".to_owned()))]).is_err());
    }
}
