//! All inputs of a run except the scenes.

use advsage::{
    Registries,
    ego::{self, Ego},
    named_generator::{GeneratorIdentity, NamedGenerator},
    operating_point::OperatingPointSpec,
    rows::GeneratedBy,
};
use sage_data::{Format, ReadOptions, openscenario::Options};
use sage_sim::avoidable::AvoidanceOptions;
use serde::Serialize;
use serde_json::Value;

use super::options::GenerateOptions;
use crate::{
    Result, networks,
    output::{self, Producer},
};

/// What identifies a run.
#[derive(Serialize)]
struct Identity<'a> {
    #[serde(flatten)]
    generator: GeneratorIdentity<'a>,
    command: String,
    #[serde(flatten)]
    by: Producer,
    /// Version of OpenSCENARIO, and what its ego does.
    #[serde(skip_serializing_if = "Option::is_none")]
    scenario: Option<[&'static str; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reading: Option<ReadOptions>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ego: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    latest_start: Option<LatestStart>,
}

/// A latest start that is asked for, and how it is searched.
#[derive(Serialize)]
struct LatestStart {
    target: Option<f64>,
    search: Option<AvoidanceOptions>,
}

/// What attacks, what drives the ego before, and what is written.
pub(super) struct Job<'a> {
    pub(super) options: &'a GenerateOptions,
    pub(super) generator: NamedGenerator,
    /// Drives the ego before the attack.
    pub(super) ego: Ego,
}

impl<'a> Job<'a> {
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
        let GenerateOptions { latest_start, avoidable, .. } = *self.options;
        let scenario = self.options.format.has(Format::OpenScenario).then(|| self.scenario_options());
        let is_driven = !self.ego.policy.is_recording();
        let identity = Identity {
            generator: self.generator.identity()?,
            command: output::command(),
            by: Producer::own(),
            scenario: scenario.map(|options| [options.standard.name(), options.ego.name()]),
            reading: output::reading_identity(self.options.reading.clone()),
            ego: is_driven.then(|| ego::identity(&self.options.ego)).transpose()?,
            latest_start: (latest_start.is_some() || avoidable.is_some())
                .then_some(LatestStart { target: latest_start, search: avoidable }),
        };
        Ok(serde_json::to_value(identity)?)
    }

    /// How a variant is generated, for its row and for the metadata of its scene files.
    pub(super) fn generated_by(&self, point: &OperatingPointSpec) -> GeneratedBy {
        GeneratedBy {
            ego: (!self.ego.policy.is_recording()).then(|| self.ego.label.clone()),
            wanted_latest_start: self.options.latest_start,
            placed: self.options.adversary.placed(),
            ..self.generator.generated_by(point)
        }
    }
}
