//! Rates: how likely a driver fails if the adversary moves as an untuned prior says.

use advsage::{
    part::Part,
    rate::{DensitySpec, NamedRate, PROFILES, RateSpec},
    rows::rate::{RateOf, RateRow},
};
use pyo3::prelude::*;
use sage_core::scene::SceneData;
use sage_run::Result;
use sage_sim::rate::Event;
use serde_json::Value;

use crate::{
    errors::{OptionError, detached},
    parts::{Driver, registries},
    results::without_run,
    searching::{PySearched, head, in_scene},
};

/// The row of `sage rate` of a scene.
fn rate(
    scene: &SceneData,
    rate: &NamedRate,
    driver: &Driver,
    events: &[Event],
) -> Result<(Value, Vec<Value>)> {
    let in_scene = in_scene(scene, driver, rate.spec.seed)?;
    let nominal = rate.nominal(&scene.scene, &scene.index)?;
    let (inclusions, driven) = rate.drive(&in_scene, &nominal)?;
    let of = RateOf { nominal: &nominal, rate, inclusions: &inclusions, driven: &driven, events };
    let row = RateRow::new(head(scene, driver, &in_scene, rate.spec.seed), &of, &in_scene.test);
    Ok((without_run(serde_json::to_value(row)?), Vec::new()))
}

/// Rates a driver in scenes, one after another; `advsage.rate` gathers what this finds.
#[pyfunction]
#[pyo3(signature = (scenes, ego, *, budget=Some(64), weights=None, temperature=None, profiles=None, aware=false, require=None, given="clear-of-recorded-ego", events=None, feasibility=None,
    references=None, seed=0, threads=None))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn rate_each(
    py: Python<'_>,
    scenes: &Bound<'_, PyAny>,
    ego: &Bound<'_, PyAny>,
    #[pyo3(from_py_with = crate::seed::optional_count)] budget: Option<usize>,
    weights: Option<String>,
    temperature: Option<f64>,
    #[pyo3(from_py_with = crate::seed::optional_count)] profiles: Option<usize>,
    aware: bool,
    require: Option<&str>,
    given: &str,
    events: Option<Vec<String>>,
    feasibility: Option<&str>,
    references: Option<Vec<String>>,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    #[pyo3(from_py_with = crate::seed::optional_count)] threads: Option<usize>,
) -> PyResult<PySearched> {
    let mut driver = Driver::of(py, ego)?;
    if let Some(names) = references {
        driver = detached(py, || driver.with_references(&names))?;
    }
    if budget == Some(0) {
        return Err(OptionError::new_err("budget is 0; expected at least 1, or None for all plans"));
    }
    let require = require.map(str::parse).transpose().map_err(OptionError::new_err)?.unwrap_or_default();
    let events = events
        .map(|names| names.iter().map(|name| name.parse()).collect::<std::result::Result<Vec<Event>, _>>());
    let events = events.transpose().map_err(OptionError::new_err)?.unwrap_or_else(|| Event::DEFAULT.to_vec());
    let feasibility = feasibility.map(str::parse::<Part>).transpose().map_err(OptionError::new_err)?;
    let given = given.parse().map_err(OptionError::new_err)?;
    let density = DensitySpec { temperature, profiles: profiles.unwrap_or(PROFILES), aware };
    let spec = RateSpec { weights, density, feasibility, budget, require, given, seed };
    let named = detached(py, || Ok(spec.build(registries()?)?))?;
    let by = driver.clone();
    let work = move |scene: &SceneData| rate(scene, &named, &by, &events);
    PySearched::new(scenes, driver, None, threads, Box::new(work))
}
