//! How likely drivers fail, if the adversary moves as a nominal density says.

use std::{path::Path, sync::Arc};

use advsage::{
    ego::Ego,
    part::Part,
    rate::{DensitySpec, NamedRate, RateSpec},
};
use sage_core::{
    metric::{Metric, MetricInfo},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    rate::{MeasuredRate, Nominal},
};
use serde_json::{Value, json};

use super::{Measurement, SceneResult, cell, driver_in_scene, infos, leaves_out};
use crate::{
    Error, Registries, Result,
    context::{Context as _, require},
    in_one_line,
    rows::{Cell, Key, Subject},
    study::Study,
};

/// Name of the method whose options are those of a density.
const NOMINAL: &str = "nominal";

/// A density of a study.
struct Rated {
    /// What distinguishes the weights; empty if there is only one set.
    arm: String,
    training_seed: Option<u64>,
    label: String,
    rate: NamedRate,
}

/// Rates of a study: every driver under every density.
pub struct Rates {
    egos: Vec<Ego>,
    rated: Vec<Rated>,
    keys: Vec<Key>,
    metrics: Vec<Metric<MeasuredRate>>,
    seed: u64,
}

impl Rates {
    /// Loads the priors.
    ///
    /// *Errors*: a method other than `nominal`, options that a density does not have, weights without a prior.
    pub fn new(study: &Study, registries: &Registries, egos: Vec<Ego>) -> Result<Self> {
        require(
            !study.weights.is_empty(),
            || "`weights` of the study is empty; expected a name, such as `weights: procedural`",
        )?;
        let named: Vec<(Option<&str>, &str)> = study
            .weights
            .iter()
            .map(|entry| entry.split_once('=').map_or((None, &**entry), |(arm, folder)| (Some(arm), folder)))
            .collect();
        let arms: Vec<&str> = named.iter().map(|(arm, folder)| arm.unwrap_or(folder)).collect();
        let is_alone = arms.iter().all(|arm| *arm == arms[0]);
        let mut rated = Vec::new();
        for (k, (arm, weights)) in named.iter().enumerate() {
            let earlier = arms[..k].iter().filter(|known| **known == arms[k]).count();
            let training_seed = arm.map(|_| earlier as u64);
            for text in &study.method {
                let part: Part = text.parse().map_err(Error::Value)?;
                require(part.name == NOMINAL, || {
                    format!("`method` of a rate is `{text}`; expected `{NOMINAL}` with options of a density")
                })?;
                let density: DensitySpec = serde_json::from_value(Value::Object(part.options))
                    .with_context(|| format!("`{text}`"))?;
                let spec = RateSpec {
                    weights: Some((*weights).to_owned()),
                    density,
                    feasibility: study
                        .feasibility
                        .as_deref()
                        .map(str::parse)
                        .transpose()
                        .map_err(Error::Value)?,
                    budget: Some(study.search.budget),
                    require: study.search.require,
                    seed: study.seed,
                    ..RateSpec::default()
                };
                let arm = if is_alone { String::new() } else { arms[k].to_owned() };
                let rate = spec.build(&registries.parts)?;
                rated.push(Rated { arm, training_seed, label: text.clone(), rate });
            }
        }
        require(!rated.is_empty(), || format!("`method` is empty; expected `{NOMINAL}`"))?;
        let listed = study.metrics.get(&Subject::Rate).cloned().unwrap_or_default();
        let metrics = registries.metrics.rate.by_names(&listed)?;
        let mut all = Self { egos, rated, keys: Vec::new(), metrics, seed: study.seed };
        all.keys = all.make_keys();
        Ok(all)
    }

    /// Keys ego by ego.
    fn make_keys(&self) -> Vec<Key> {
        let key = |ego: &Ego, rated: &Rated| {
            let arm = match rated.arm.is_empty() {
                true => ego.label.clone(),
                false => format!("{}, {}", ego.label, rated.arm),
            };
            Key {
                training_seed: rated.training_seed,
                attack: rated.label.clone(),
                knows: ego.policy.knows().to_string(),
                ..Key::new(Subject::Rate, arm, self.seed)
            }
        };
        self.egos.iter().flat_map(|ego| self.rated.iter().map(move |rated| key(ego, rated))).collect()
    }

    /// What identifies the densities.
    ///
    /// *Errors*: none on a CPU.
    pub fn identity(&self) -> Result<Value> {
        let of = |rated: &Rated| -> Result<Value> {
            let density = &rated.rate.density;
            Ok(json!({ "prior": advsage::rate::hash(&*density.prior)?, "density": density.identity() }))
        };
        self.rated.iter().map(of).collect()
    }

    /// What the user should know.
    pub fn notes(&self) -> Vec<String> {
        self.rated.iter().flat_map(|rated| rated.rate.density.notes.iter().cloned()).collect()
    }
}

impl Measurement for Rates {
    fn write_logs_to(&self, folder: &Path) {
        self.egos.iter().for_each(|ego| ego.policy.write_logs_to(folder));
    }

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        vec![(Subject::Rate, infos(&self.metrics))]
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let mut result = SceneResult::default();
        // The densities of a scene are the same for all drivers.
        let nominal = |rated: &Rated| rated.rate.nominal(&data.scene, &data.index);
        let densities: Vec<advsage::Result<Nominal>> = self.rated.iter().map(nominal).collect();
        let simulated: Result<Arc<SimScene>, _> = SimScene::new(data.scene.clone(), data.index.clone());
        for (k, ego) in self.egos.iter().enumerate() {
            let first = k * self.rated.len();
            let driver = match driver_in_scene(ego, &simulated, self.seed) {
                Ok(driver) => driver,
                Err(error) if leaves_out(&error) => {
                    result.left_out.push(format!("{}: {}", ego.label, in_one_line(&error)));
                    continue;
                }
                Err(error) => {
                    let all = first..first + self.rated.len();
                    result.cells.extend(all.map(|key| Cell::failed(key, in_one_line(&error))));
                    continue;
                }
            };
            for (key, (rated, nominal)) in (first..).zip(self.rated.iter().zip(&densities)) {
                let measured = nominal.as_ref().map_err(|error| in_one_line(error)).and_then(|nominal| {
                    let (_, driven) =
                        rated.rate.drive(&driver, nominal).map_err(|error| in_one_line(&error))?;
                    Ok(MeasuredRate::new(nominal, &driven, rated.rate.spec.require, &driver.test))
                });
                result.cells.push(match measured {
                    Ok(measured) => cell(key, &self.metrics, &measured),
                    Err(problem) => Cell::failed(key, problem),
                });
            }
        }
        result
    }
}
