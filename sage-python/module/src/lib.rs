//! The library that Python loads. It is a crate of its own, because the last crate decides how all are optimised together: for speed,
//! while what stands between Python and the libraries is built to be small.

use pyo3::prelude::*;

#[pymodule(gil_used = true)]
fn _advsage(module: &Bound<'_, PyModule>) -> PyResult<()> {
    sage_python::fill(module)
}
