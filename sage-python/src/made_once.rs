//! A value of Python that is made at its first use and shared from then on.

use pyo3::{prelude::*, sync::PyOnceLock};

/// The value, or none yet.
pub(crate) struct MadeOnce<T = PyAny>(PyOnceLock<Py<T>>);

impl<T> Default for MadeOnce<T> {
    fn default() -> Self {
        Self(PyOnceLock::new())
    }
}

impl<T> MadeOnce<T> {
    /// The value, made by `make` at the first call.
    ///
    /// *Errors*: those of `make`.
    pub(crate) fn get(&self, py: Python<'_>, make: impl FnOnce() -> PyResult<Py<T>>) -> PyResult<Py<T>> {
        Ok(self.0.get_or_try_init(py, make)?.clone_ref(py))
    }
}
