//! All inputs of `sage search` except the scenes.

use advsage::{
    PersonKind, Registries,
    ego::{self, Ego},
    generators::weight_hashes,
    named_search::{NamedSearch, SearchSpec},
    operating_point::OperatingPointSpec,
    prepared::DriverInScene,
    rate::DensityIdentity,
    search::PlanSources,
};
use anyhow::{Result, ensure};
use sage_core::objective::{ObjectiveSpec, PartSpec};
use sage_data::{ReadOptions, openscenario::Options};
use sage_generators::Placement;
use sage_run::{
    networks,
    output::{self, Producer},
    progress,
};
use sage_sim::{
    avoidable::AvoidanceOptions,
    fault::FaultRule,
    search::{Explained, Order, Pool, Requirement, SearchOptions, SearchResult},
};
use serde::Serialize;
use serde_json::{Map, Value};

use super::estimate::Estimate;
use crate::cli::SearchArgs;

/// What identifies a search.
#[derive(Serialize)]
struct Identity<'a> {
    command: String,
    method: String,
    /// Hashes of the networks by their names.
    weights: Map<String, Value>,
    /// Density of the failures' probabilities.
    density: Option<DensityIdentity>,
    points: &'a [OperatingPointSpec],
    selection: &'a ObjectiveSpec,
    feasibility: &'a PartSpec,
    merger: String,
    search: SearchIdentity,
    plans: usize,
    adversary: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    adversary_type: Option<PersonKind>,
    #[serde(skip_serializing_if = "Option::is_none")]
    place: Option<Placement>,
    seed: u64,
    format: &'static str,
    ego: Value,
    #[serde(flatten)]
    by: Producer,
    /// Hashes of files that generators were built from.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    files: Vec<&'a Map<String, Value>>,
    references: &'a [String],
    fault: FaultRule,
    #[serde(skip_serializing_if = "Option::is_none")]
    reading: Option<ReadOptions>,
}

/// The options of a search but its budget: a run may be continued with another one.
#[derive(Serialize)]
struct SearchIdentity {
    require: Requirement,
    first: bool,
    order: Order,
    refine: f64,
    explain: Explained,
    avoidable: AvoidanceOptions,
}

impl SearchIdentity {
    fn of(
        SearchOptions { budget: _, require, first, order, refine, explain, avoidable }: SearchOptions,
    ) -> Self {
        Self { require, first, order, refine, explain, avoidable }
    }
}

/// What searches all scenes.
pub(super) struct Searcher<'a> {
    pub(super) args: &'a SearchArgs,
    /// The driver under test.
    pub(super) ego: Ego,
    pub(super) options: SearchOptions,
    /// How long it takes.
    pub(super) estimate: Estimate,
    named: NamedSearch,
}

impl<'a> Searcher<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used.
    pub(super) fn new(args: &'a SearchArgs, registries: &'a Registries) -> Result<Self> {
        args.format.check_scenario(args.scenario.standard, args.scenario.scenario_ego)?;
        let ego = Ego::new(&args.planner.applied(&args.ego), registries)?
            .with_references(&args.reference, registries)?;
        let ego = Ego { fault: args.fault, ..ego };
        let adversary = args.attack.adversary();
        ensure!(
            args.method.is_some() || adversary.kind.is_some() || args.attack.generator.options.is_none(),
            "--options needs a generator; name it with --method, such as --method sage"
        );
        let require = args.require.unwrap_or_else(|| adversary.requirement());
        let generator = args.attack.spec(args.method.as_ref(), Some(require))?;
        let spec = SearchSpec { generator, plans: args.plans };
        let named = spec.build_with(registries, networks::announce_experts)?;
        named.notes.iter().for_each(|note| progress::say(&format!("warning: {note}")));
        let plans_against_ego = named.method.as_ref().is_some_and(|(_, facts)| facts.plans_against_ego);
        if !plans_against_ego && args.attack.generator.selection != "natural" {
            progress::say("note: --selection has no effect: every candidate is a plan of the search");
        }
        let options = SearchOptions {
            budget: args.budget,
            require,
            first: args.first,
            order: args.order.0,
            refine: args.refine,
            explain: args.explain_failures.0,
            avoidable: args.avoidable.options().unwrap_or_default(),
        };
        Ok(Self { args, ego, options, estimate: Estimate::default(), named })
    }

    /// Searches a scene.
    ///
    /// *Errors*: as [`NamedSearch::search`].
    pub(super) fn search(&self, driver: &DriverInScene, seed: u64) -> Result<(Pool, SearchResult)> {
        Ok(self.named.search(driver, &self.options, seed)?)
    }

    /// Where plans come from.
    pub(super) fn plans(&self) -> &PlanSources {
        &self.named.plans
    }

    /// Name of the weights; `None` if no plan needs experts.
    pub(super) fn weights_name(&self) -> Option<&str> {
        self.named.weights.as_ref().map(|weights| &*weights.name)
    }

    /// Choices for OpenSCENARIO files, without the licence.
    pub(super) fn scenario_options(&self) -> Options {
        let scenario = self.args.scenario;
        Options {
            standard: scenario.standard.unwrap_or_default(),
            ego: scenario.scenario_ego.unwrap_or_default(),
            license: None,
        }
    }

    /// Identity of this run. The folder of another run is refused.
    ///
    /// *Errors*: a file of the driver cannot be read; a dial cannot be used.
    pub(super) fn identity(&self) -> Result<Value> {
        let mut weights = Map::new();
        if let Some(loaded) = &self.named.weights {
            weights.insert(loaded.name.clone(), weight_hashes(&loaded.experts)?.into());
        }
        let (args, generator) = (self.args, &self.args.attack.generator);
        let identity = Identity {
            command: output::command_without("--budget"),
            method: self.named.method(),
            weights,
            density: self.named.density(),
            points: &self.named.points,
            selection: self.named.selection.objective.spec(),
            feasibility: &self.named.rule.objective.spec().feasibility,
            merger: generator.merger.to_string(),
            search: SearchIdentity::of(self.options),
            plans: args.plans,
            adversary: args.attack.adversary.as_deref(),
            adversary_type: args.attack.adversary_type,
            place: args.attack.place,
            seed: generator.seed,
            format: args.format.name(),
            ego: ego::identity(&args.ego)?,
            by: Producer::own(),
            files: self.plans().files(),
            references: &args.reference,
            fault: args.fault,
            reading: output::reading_identity(args.reading.options()),
        };
        Ok(serde_json::to_value(identity)?)
    }
}
