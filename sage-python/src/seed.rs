//! Whole numbers: seeds and counts.

use pyo3::prelude::*;

use crate::errors::OptionError;

/// A seed: a whole number from 0 to 2⁶⁴ − 1.
///
/// *Errors*: anything else.
pub(crate) fn seed(value: &Bound<'_, PyAny>) -> PyResult<u64> {
    value.extract().map_err(|_| wrong(value, "seed", "0 to 2**64 - 1"))
}

/// A count: of threads, drives, plans, frames.
///
/// *Errors*: anything else.
pub(crate) fn count(value: &Bound<'_, PyAny>) -> PyResult<usize> {
    value.extract().map_err(|_| wrong(value, "count", "0 on"))
}

/// A count, if it is given.
///
/// *Errors*: anything else.
pub(crate) fn optional_count(value: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
    if value.is_none() { Ok(None) } else { count(value).map(Some) }
}

/// Number of a shard and of shards, if they are given.
///
/// *Errors*: anything else.
pub(crate) fn shard(value: &Bound<'_, PyAny>) -> PyResult<Option<(u32, u32)>> {
    value.extract().map_err(|_| wrong(value, "shard", "1 on: two of them, (2, 8) for shard 2 of 8"))
}

fn wrong(value: &Bound<'_, PyAny>, what: &str, range: &str) -> PyErr {
    let shown = value.repr().map_or("something else".to_owned(), |text| text.to_string());
    OptionError::new_err(format!("{shown} is no {what}; expected whole numbers from {range}"))
}
