//! The types and errors of the module `advsage._advsage` of Python, which `module` builds. All work is done by the libraries.
//!
//! - What a user works with: `scene`, `loading` and `folder`; `generator`, `attack` and `attacks`; `scoring`; `driven`, `episode` and
//!   `episodes`; `searching` and `evaluating`; `inspecting`.
//! - Planners: `planner` is asked, `observation` is what it sees, `planner_drive` its policy, `together` several drives at once.
//! - `environments`: environments of reinforcement learning, their scenes and adversaries, and what is known and shown of them.
//! - `built`: a generator without Python. `items`: scenes of a list. `ahead`: the only place with threads. `parts`: registries and drivers by
//!   name. `job`: one run of the command. `values`, `made_once`, `seed`, `errors`: values, arrays, numbers and exceptions of Python.

mod ahead;
mod attack;
mod attacks;
mod built;
mod driven;
mod environments;
mod episode;
mod episodes;
mod errors;
mod evaluating;
mod folder;
mod generator;
mod inspecting;
mod items;
mod job;
mod loading;
mod made_once;
mod observation;
mod parts;
mod planner;
mod planner_drive;
mod rating;
mod results;
mod scene;
mod scoring;
mod searching;
mod seed;
mod together;
mod values;

use pyo3::prelude::*;

/// Fills the module with its types and functions.
///
/// *Errors*: those of Python.
pub fn fill(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // One thread works on one scene: products are never split, whatever the environment says.
    gemm::set_threading_threshold(usize::MAX);
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<scene::PyScene>()?;
    module.add_class::<generator::PyGenerator>()?;
    module.add_class::<attack::PyAttack>()?;
    module.add_class::<observation::PyToldScene>()?;
    module.add_class::<observation::PyStep>()?;
    module.add_class::<episode::PyEpisode>()?;
    module.add_class::<episodes::PyEpisodes>()?;
    module.add_class::<environments::PyEnvironments>()?;
    module.add_class::<folder::PyScenes>()?;
    module.add_class::<folder::PyScenesInTurn>()?;
    module.add_class::<attacks::PyAttacks>()?;
    module.add_class::<searching::PySearched>()?;
    module.add_class::<inspecting::PyPicture>()?;
    module.add_function(wrap_pyfunction!(errors::panicking, module)?)?;
    module.add_function(wrap_pyfunction!(errors::seconds, module)?)?;
    module.add_function(wrap_pyfunction!(job::run_generate, module)?)?;
    module.add_function(wrap_pyfunction!(evaluating::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(inspecting::inspect, module)?)?;
    module.add_function(wrap_pyfunction!(inspecting::convert, module)?)?;
    module.add_function(wrap_pyfunction!(inspecting::draw, module)?)?;
    module.add_function(wrap_pyfunction!(episode::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(episodes::simulate_many, module)?)?;
    module.add_function(wrap_pyfunction!(folder::load_folder, module)?)?;
    module.add_function(wrap_pyfunction!(attacks::generate_many, module)?)?;
    module.add_function(wrap_pyfunction!(searching::search_each, module)?)?;
    module.add_function(wrap_pyfunction!(rating::rate_each, module)?)?;
    module.add_function(wrap_pyfunction!(parts::names, module)?)?;
    module.add_function(wrap_pyfunction!(loading::load, module)?)?;
    module.add_function(wrap_pyfunction!(loading::make, module)?)?;
    module.add_function(wrap_pyfunction!(scoring::score, module)?)?;
    module.add_function(wrap_pyfunction!(scoring::score_columns, module)?)?;
    Ok(())
}
