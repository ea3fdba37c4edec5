//! Conditions and missing values as errors, with the words of what was done.

use std::fmt::Display;

pub(crate) use advsage::WithContext as Context;

use crate::{Error, Result};

/// The error of another library, as text.
pub(crate) fn foreign(error: impl Display) -> Error {
    Error::Value(error.to_string())
}

/// *Errors*: [`Error::Value`] with the problem, unless the condition holds.
pub(crate) fn require<W: Into<String>>(holds: bool, problem: impl FnOnce() -> W) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Value(problem().into())) }
}
