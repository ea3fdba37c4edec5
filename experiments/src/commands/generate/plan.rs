//! All inputs of `sage generate` except the scenes.

use advsage::{
    Registries,
    ego::{self, Ego},
    operating_point::OperatingPointSpec,
};
use anyhow::{Result, bail};
use sage_data::openscenario::Options;
use sage_run::progress;
use serde_json::{Map, Value, json};

use crate::{
    attacked_files::Formats,
    cli::{DatasetFormat, GenerateArgs},
    run_generator::RunGenerator,
};

/// What attacks, what drives the ego before, and what is written.
pub(super) struct Plan<'a> {
    pub(super) args: &'a GenerateArgs,
    pub(super) generator: RunGenerator<'a>,
    /// Drives the ego before the attack.
    pub(super) ego: Ego,
}

impl<'a> Plan<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used.
    pub(super) fn new(args: &'a GenerateArgs, registries: &'a Registries) -> Result<Self> {
        let is_scenario = args.format == DatasetFormat::Openscenario;
        if !is_scenario && (args.standard.is_some() || args.scenario_ego.is_some()) {
            bail!("--standard and --scenario-ego need --format openscenario");
        }
        let ego = Ego::new(&args.planner.applied(&args.ego), registries)?
            .with_references(&["r157".to_owned()], registries)?;
        progress::say_notes(std::slice::from_ref(&ego));
        let generator = RunGenerator::new(&args.method, &args.attack, registries)?;
        Ok(Self { args, generator, ego })
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

    /// True if pickles are written.
    pub(super) fn writes_pickles(&self) -> bool {
        matches!(self.args.format, DatasetFormat::Both | DatasetFormat::Pickle)
    }

    /// Choices for OpenSCENARIO files, without the licence; `None` if none are written.
    fn scenario_options(&self) -> Option<Options> {
        let GenerateArgs { format, standard, scenario_ego, .. } = self.args;
        (*format == DatasetFormat::Openscenario).then(|| Options {
            standard: standard.unwrap_or_default(),
            ego: scenario_ego.unwrap_or_default(),
            license: None,
        })
    }

    /// The files of each attack.
    pub(super) fn formats(&self) -> Formats {
        Formats {
            pickle: self.writes_pickles(),
            native: matches!(self.args.format, DatasetFormat::Both | DatasetFormat::Native),
            gpudrive: self.args.format == DatasetFormat::Gpudrive,
            scenario: self.scenario_options(),
        }
    }

    /// Identity of this run. The folder of another run is refused.
    ///
    /// *Errors*: the file of a `path` cannot be read.
    pub(super) fn identity(&self) -> Result<Value> {
        let mut identity = self.generator.identity()?;
        if let Some(options) = self.scenario_options() {
            identity["scenario"] = json!([options.standard.name(), options.ego.name()]);
        }
        let reading = self.args.reading.identity();
        if !reading.is_null() {
            identity["reading"] = reading;
        }
        if !self.ego.policy.is_recording() {
            identity["ego"] = ego::identity(&self.args.ego)?;
        }
        if self.args.latest_start.is_some() || self.args.avoidable.options().is_some() {
            identity["latest_start"] =
                json!({"target": self.args.latest_start, "search": self.args.avoidable.options()});
        }
        Ok(identity)
    }

    /// Description of how a variant was generated, for its row and for the metadata of its scene files.
    pub(super) fn describe(&self, point: &OperatingPointSpec) -> Map<String, Value> {
        let mut described = self.generator.describe(point);
        if !self.ego.policy.is_recording() {
            described.insert("ego".to_owned(), json!(self.ego.label));
        }
        if let Some(target) = self.args.latest_start {
            described.insert("wanted_latest_start".to_owned(), json!(target));
        }
        described
    }
}
