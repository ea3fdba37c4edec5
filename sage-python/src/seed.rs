//! Seeds of random numbers.

use pyo3::prelude::*;

use crate::errors::OptionError;

/// A seed: a whole number from 0 to 2⁶⁴ − 1.
///
/// *Errors*: anything else.
pub(crate) fn seed(value: &Bound<'_, PyAny>) -> PyResult<u64> {
    value.extract().map_err(|_| {
        let shown = value.repr().map_or("something else".to_owned(), |text| text.to_string());
        OptionError::new_err(format!("{shown} is no seed; expected a whole number from 0 to 2**64 - 1"))
    })
}
