//! Conditions and missing values as errors, with the words of what was done.

use std::fmt::Display;

use crate::{Error, Result};

/// Adds what was done to an error. A missing value becomes one.
pub(crate) trait Context<T> {
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T>;
}

impl<T, E: Into<Error>> Context<T> for Result<T, E> {
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T> {
        self.map_err(|error| error.into().within(what()))
    }
}

impl<T> Context<T> for Option<T> {
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T> {
        self.ok_or_else(|| Error::Value(what().into()))
    }
}

/// The error of another library, as text.
pub(crate) fn foreign(error: impl Display) -> Error {
    Error::Value(error.to_string())
}

/// *Errors*: [`Error::Value`] with the problem, unless the condition holds.
pub(crate) fn require<W: Into<String>>(holds: bool, problem: impl FnOnce() -> W) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Value(problem().into())) }
}
