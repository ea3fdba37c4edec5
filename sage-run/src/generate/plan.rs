//! All inputs of a run except the scenes.

use advsage::{
    Registries,
    ego::{self, Ego},
    named_generator::NamedGenerator,
    operating_point::OperatingPointSpec,
    rows::GeneratedBy,
};
use anyhow::Result;
use sage_data::{Format, openscenario::Options};
use serde_json::{Value, json};

use super::options::GenerateOptions;
use crate::{networks, output, progress};

/// What attacks, what drives the ego before, and what is written.
pub(super) struct Plan<'a> {
    pub(super) options: &'a GenerateOptions,
    pub(super) generator: NamedGenerator,
    /// Drives the ego before the attack.
    pub(super) ego: Ego,
}

impl<'a> Plan<'a> {
    /// Checks all options except the scenes, and loads weights.
    ///
    /// *Errors*: an option is out of range or names an unknown part; weights cannot be used.
    pub(super) fn new(options: &'a GenerateOptions, registries: &Registries) -> Result<Self> {
        options.format.check_scenario(options.standard, options.scenario_ego)?;
        let driver = options.ego.clone();
        let driver = match options.ego_timeout {
            Some(times) => driver.with_timeouts(times),
            None => driver,
        };
        let ego = Ego::new(&driver, registries)?.with_references(&["r157".to_owned()], registries)?;
        progress::say_notes(std::slice::from_ref(&ego));
        let generator = networks::build_generator(options.generator.clone(), registries)?;
        Ok(Self { options, generator, ego })
    }

    /// Name of each operating point, as part of file names.
    pub(super) fn variants(&self) -> &[String] {
        &self.generator.variants
    }

    /// What attacks, and whom.
    pub(super) fn subtitle(&self) -> String {
        let ego = &self.ego.label;
        let driver = if self.ego.policy.is_recording() { "the recorded ego" } else { ego };
        let weights = self.generator.weights_name().map_or(String::new(), |name| format!(", weights {name}"));
        format!("selection {} against {driver}{weights}", self.generator.selection.name)
    }

    /// Choices for OpenSCENARIO files, without the licence.
    pub(super) fn scenario_options(&self) -> Options {
        let GenerateOptions { standard, scenario_ego, .. } = self.options;
        Options {
            standard: standard.unwrap_or_default(),
            ego: scenario_ego.unwrap_or_default(),
            license: None,
        }
    }

    /// Identity of this run. The folder of another run is refused.
    ///
    /// *Errors*: the file of a `path` cannot be read.
    pub(super) fn identity(&self) -> Result<Value> {
        let mut identity = networks::generator_identity(&self.generator)?;
        if self.options.format.has(Format::OpenScenario) {
            let options = self.scenario_options();
            identity["scenario"] = json!([options.standard.name(), options.ego.name()]);
        }
        let reading = output::reading_identity(&self.options.reading);
        if !reading.is_null() {
            identity["reading"] = reading;
        }
        if !self.ego.policy.is_recording() {
            identity["ego"] = ego::identity(&self.options.ego)?;
        }
        if self.options.latest_start.is_some() || self.options.avoidable.is_some() {
            identity["latest_start"] =
                json!({"target": self.options.latest_start, "search": self.options.avoidable});
        }
        Ok(identity)
    }

    /// How a variant is generated, for its row and for the metadata of its scene files.
    pub(super) fn generated_by(&self, point: &OperatingPointSpec) -> GeneratedBy {
        GeneratedBy {
            ego: (!self.ego.policy.is_recording()).then(|| self.ego.label.clone()),
            wanted_latest_start: self.options.latest_start,
            ..self.generator.generated_by(point)
        }
    }
}
