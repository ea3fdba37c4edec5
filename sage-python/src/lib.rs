//! The module `advsage._advsage` of Python: types and errors. All work is done by the libraries.
//!
//! - [`scene`], [`generator`], [`attack`], [`scoring`]: what a user works with.
//! - [`parts`]: registries and drivers by name. [`values`]: JSON and arrays. [`made_once`]: values that are made when they are asked for. [`errors`]: exceptions, and the guard of every call.

mod attack;
mod errors;
mod generator;
mod made_once;
mod observation;
mod parts;
mod planner;
mod scene;
mod scoring;
mod values;

use pyo3::prelude::*;

#[pymodule(gil_used = true)]
fn _advsage(module: &Bound<'_, PyModule>) -> PyResult<()> {
    errors::silence_guarded_panics();
    // One thread works on one scene: products are never split, whatever the environment says.
    gemm::set_threading_threshold(usize::MAX);
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<scene::PyScene>()?;
    module.add_class::<generator::PyGenerator>()?;
    module.add_class::<attack::PyAttack>()?;
    module.add_class::<observation::PyToldScene>()?;
    module.add_class::<observation::PyStep>()?;
    module.add_function(wrap_pyfunction!(scene::load, module)?)?;
    module.add_function(wrap_pyfunction!(scene::make, module)?)?;
    module.add_function(wrap_pyfunction!(scoring::score, module)?)?;
    module.add_function(wrap_pyfunction!(scoring::score_columns, module)?)?;
    Ok(())
}
