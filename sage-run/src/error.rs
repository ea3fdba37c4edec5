//! Errors, grouped by how a caller can react.

use std::{error::Error as StdError, io, iter};

use advsage::as_cause;
use sage_core::{defect::Defect, files::LockError};

/// An error of any type.
pub type AnyError = dyn StdError + 'static;

/// What this crate returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// An error of this crate, or of a crate below.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What was asked cannot be done: with these options, in this folder, from this file.
    #[error("{0}")]
    Refused(String),
    /// An error within what was done.
    #[error("{what}")]
    Within {
        /// What was done.
        what: String,
        /// The error.
        source: Box<Self>,
    },
    /// It ends a command because its scenes are bad: another try changes nothing.
    #[error(transparent)]
    BadScenes(Box<Self>),
    /// It ends a command, and another try may succeed.
    #[error(transparent)]
    Retry(Box<Self>),
    /// A panic of this program.
    #[error(transparent)]
    Defect(Defect),
    /// An output that cannot be claimed.
    #[error(transparent)]
    Lock(LockError),
    /// A scene, a part, an attack, or a file.
    #[error(transparent)]
    Facade(advsage::Error),
}

impl<E: Into<advsage::Error>> From<E> for Error {
    fn from(error: E) -> Self {
        Self::Facade(error.into())
    }
}

impl AsRef<AnyError> for Error {
    fn as_ref(&self) -> &AnyError {
        self
    }
}

impl Error {
    /// The same within what was done.
    #[must_use]
    pub fn within(self, what: impl Into<String>) -> Self {
        Self::Within { what: what.into(), source: Box::new(self) }
    }
}

/// An error of the work on a scene: an [`Error`], or an error of the caller that can hold one.
pub trait WorkError: From<Error> + AsRef<AnyError> + Send {}

impl<E: From<Error> + AsRef<AnyError> + Send> WorkError for E {}

/// An error and its causes, also those that an [`Error`] holds without words of its own.
pub fn causes(error: &AnyError) -> impl Iterator<Item = &AnyError> {
    iter::successors(Some(error), |&cause| match cause.downcast_ref::<Error>() {
        Some(Error::Within { source, .. } | Error::BadScenes(source) | Error::Retry(source)) => {
            Some(&**source)
        }
        Some(Error::Defect(error)) => Some(error),
        Some(Error::Lock(error)) => Some(error),
        Some(Error::Facade(error)) => Some(error),
        Some(Error::Refused(_)) | None => cause.source(),
    })
}

/// The errors of files and streams among an error and its causes.
pub fn io_causes(error: &AnyError) -> impl Iterator<Item = &io::Error> {
    causes(error).filter_map(as_cause)
}

#[cfg(test)]
mod tests {
    use advsage::{WithContext as _, in_one_line};

    use super::*;

    #[test]
    fn causes_are_found_and_said_once() {
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        let error =
            Err::<(), _>(full()).with_context(|| "cannot write `a`").map_err(Error::from).unwrap_err();
        let error = Error::BadScenes(Box::new(error.within("scene 7")));
        assert_eq!(io_causes(&error).count(), 1);
        assert_eq!(in_one_line(&error), format!("scene 7: cannot write `a`: {}", full()));
    }
}
