//! A run of `sage generate` in this process, for `advsage.jobs`.

use std::path::PathBuf;

use experiments::generate_job;
use pyo3::prelude::*;

use crate::{errors::detached, parts::registries};

/// Runs `sage generate` with these words and returns its exit code. Messages go to the standard error, results to the standard output.
#[pyfunction]
pub(crate) fn run_generate(py: Python<'_>, words: Vec<String>) -> PyResult<u8> {
    // The module is the program: a run is resumed by the same one.
    let module: PathBuf = py.import("advsage._advsage")?.getattr("__file__")?.extract()?;
    detached(py, || Ok(generate_job::run(&words, &module, registries()?)))
}
