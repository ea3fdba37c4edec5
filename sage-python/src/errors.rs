//! Errors of the libraries as exceptions of Python, and the guard around every call.

use std::{
    cell::{Cell, RefCell},
    io,
    path::Path,
    time::Instant,
};

use advsage::in_one_line;
use pyo3::{exceptions::PyException, import_exception, prelude::*};
use sage_run::{
    Error, Result, causes,
    outcome::{caught, is_defect},
};

import_exception!(advsage.errors, FormatError);
import_exception!(advsage.errors, SceneError);
import_exception!(advsage.errors, OptionError);
import_exception!(advsage.errors, UnknownName);
import_exception!(advsage.errors, FileError);
import_exception!(advsage.errors, MissingFile);
import_exception!(advsage.errors, PlannerError);
import_exception!(advsage.errors, InternalError);

/// What an error is for a caller.
enum Kind<'e> {
    Format,
    Scene,
    Option,
    Unknown,
    Planner,
    File(Option<&'e Path>, &'e io::Error),
    /// None of the above.
    Other,
}

thread_local! {
    /// What a planner raised last on this thread.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
    /// Seconds in the libraries.
    static SECONDS: Cell<f64> = const { Cell::new(0.0) };
}

/// Keeps what a planner raised for the error that it becomes.
pub(crate) fn keep_raised(raised: Option<PyErr>) {
    RAISED.set(raised);
}

/// Takes what a planner raised last on this thread.
pub(crate) fn take_raised() -> Option<PyErr> {
    RAISED.take()
}

/// Panics, so that a test can see what becomes of it.
///
/// *Errors*: always.
#[pyfunction]
#[pyo3(name = "_panic")]
pub(crate) fn panicking(py: Python<'_>) -> PyResult<()> {
    // Panics of the libraries are defects, so no input of a test can be relied on to cause one.
    detached(py, || panic!("on purpose"))
}

/// Works without Python's lock, so that other threads run meanwhile. A panic within is an exception, which `except Exception` catches.
///
/// *Errors*: those of `work`, as exceptions.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    let clock = Instant::now();
    let outcome = py.detach(|| caught(work));
    SECONDS.set(SECONDS.get() + clock.elapsed().as_secs_f64());
    outcome.map_err(|error| to_python(py, &error))
}

/// Seconds that calls of this thread spent in the libraries, so that what is spent beside them can be measured.
#[pyfunction]
#[pyo3(name = "_seconds")]
pub(crate) fn seconds() -> f64 {
    SECONDS.get()
}

/// The exception of an error.
pub(crate) fn to_python(py: Python<'_>, error: &Error) -> PyErr {
    let text = in_one_line(error);
    if is_defect(error) {
        return InternalError::new_err(text);
    }
    let kind = causes(error).map(kind).find(|kind| !matches!(kind, Kind::Other)).unwrap_or(Kind::Other);
    match kind {
        Kind::Format => FormatError::new_err(text),
        Kind::Scene => SceneError::new_err(text),
        Kind::Unknown => UnknownName::new_err(text),
        Kind::Planner => match take_raised() {
            Some(raised) if !raised.is_instance_of::<PyException>(py) => raised,
            raised => {
                let error = PlannerError::new_err(text);
                error.set_cause(py, raised);
                error
            }
        },
        Kind::File(path, cause) => {
            let path = path.map(|path| path.display().to_string());
            // Temporary files wrap the error of the system, and the exception names the file itself.
            let code = cause.raw_os_error().or((cause.kind() == io::ErrorKind::NotFound).then_some(2));
            let said = code.map(|code| io::Error::from_raw_os_error(code).to_string());
            let said =
                said.as_deref().and_then(|said| said.split(" (os error").next()).unwrap_or(&text).to_owned();
            if cause.kind() == io::ErrorKind::NotFound {
                MissingFile::new_err((code, said, path))
            } else {
                FileError::new_err((code, said, path))
            }
        }
        // The other errors of the libraries are about arguments.
        Kind::Option | Kind::Other => OptionError::new_err(text),
    }
}

fn kind<'e>(cause: &'e (dyn std::error::Error + 'static)) -> Kind<'e> {
    if let Some(error) = cause.downcast_ref() {
        return of_data(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_core(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_network(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_merging(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_generator(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_simulation(error);
    }
    if let Some(error) = advsage::as_cause(cause) {
        return of_facade(error);
    }
    cause.downcast_ref().map_or(Kind::Other, |error| Kind::File(None, error))
}

fn of_facade(error: &advsage::Error) -> Kind<'_> {
    use advsage::Error;
    match error {
        Error::Unknown(_) => Kind::Unknown,
        Error::Core(error) => of_core(error),
        Error::Data(error) => of_data(error),
        Error::Network(error) => of_network(error),
        Error::Merging(error) => of_merging(error),
        Error::Generator(error) => of_generator(error),
        Error::Simulation(error) => of_simulation(error),
        Error::Io(error) => Kind::File(None, error),
        // Its cause says more.
        Error::Within { .. } => Kind::Other,
        _ => Kind::Option,
    }
}

fn of_data(error: &sage_data::Error) -> Kind<'_> {
    match error {
        sage_data::Error::Read { path, source } | sage_data::Error::Write { path, source } => {
            Kind::File(Some(path), source)
        }
        _ => Kind::Format,
    }
}

fn of_core(error: &sage_core::Error) -> Kind<'_> {
    use sage_core::Error;
    match error {
        Error::Scene { .. } | Error::ContactNow { .. } | Error::NoPlace { .. } => Kind::Scene,
        Error::Unknown { .. } => Kind::Unknown,
        _ => Kind::Option,
    }
}

fn of_network(error: &sage_backbones::Error) -> Kind<'_> {
    use sage_backbones::Error;
    match error {
        Error::Core(error) => of_core(error),
        Error::Agent { source, .. } => of_network(source),
        Error::Io { path, source, .. } => Kind::File(Some(path), source),
        Error::Weights { .. } | Error::Format { .. } | Error::NoNetwork { .. } => Kind::Format,
        _ => Kind::Option,
    }
}

fn of_merging(error: &sage_merging::Error) -> Kind<'_> {
    match error {
        sage_merging::Error::Network(error) => of_network(error),
        sage_merging::Error::Expert { .. } => Kind::Unknown,
        _ => Kind::Option,
    }
}

fn of_generator(error: &sage_generators::Error) -> Kind<'_> {
    use sage_generators::Error;
    match error {
        Error::Core(error) => of_core(error),
        Error::Network(error) => of_network(error),
        Error::Merging(error) => of_merging(error),
        _ => Kind::Option,
    }
}

fn of_simulation(error: &sage_sim::Error) -> Kind<'_> {
    use sage_sim::Error;
    match error {
        Error::Core(error) => of_core(error),
        Error::Planner { .. } => Kind::Planner,
        Error::Batch { .. } => Kind::Option,
        _ => Kind::Scene,
    }
}
