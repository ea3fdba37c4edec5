//! All inputs of `sage search` except the scenes.

use anyhow::{Context as _, Result, bail, ensure};
use sage_data::openscenario::Options;
use sage_generators::Facts;
use sage_sim::search::SearchOptions;
use serde_json::{Map, Value, json};

use crate::{
    Registries,
    attacked_files::Formats,
    cli::{SearchArgs, SearchFormat},
    ego::{self, Ego},
    generators::{Generators, weight_hashes},
    operating_point::OperatingPointSpec,
    output,
    part::Part,
    progress,
    run_generator::{Weights, dial},
    search::{self, POOL, PlanSources},
    selection::Selection,
};

/// What searches all scenes.
pub(super) struct Searcher<'a> {
    pub(super) args: &'a SearchArgs,
    /// The driver under test.
    pub(super) ego: Ego,
    /// Its rule decides which plans are feasible.
    pub(super) rule: Selection,
    pub(super) options: SearchOptions,
    /// The generator that the user names, with its options.
    method: Option<(Part, Facts)>,
    selection: Selection,
    /// `None` if no plan needs experts.
    weights: Option<Weights>,
    /// Operating points that the user gives; none for the default ones.
    points: Vec<OperatingPointSpec>,
    pub(super) plans: PlanSources,
}

impl<'a> Searcher<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used.
    pub(super) fn new(args: &'a SearchArgs, registries: &'a Registries) -> Result<Self> {
        let is_scenario = args.format == SearchFormat::Openscenario;
        if !is_scenario && (args.standard.is_some() || args.scenario_ego.is_some()) {
            bail!("--standard and --scenario-ego need --format openscenario");
        }
        let ego = Ego::new(&args.planner.applied(&args.ego), registries)?;
        progress::say_notes(std::slice::from_ref(&ego));
        let rule = search::rule(registries, args.attack.rule.feasibility.as_ref())?;
        let merger = &args.attack.points.merging.merger;
        let of_rule = Generators::new(registries, merger, &rule, args.attack.seed)?;
        let method = args.method.as_ref().map(|method| -> Result<(Part, Facts)> {
            let mut method = method.clone();
            if let Some(options) = &args.attack.options {
                let options: Map<String, Value> =
                    serde_json::from_str(options).context("--options is not a JSON object")?;
                method.options.extend(options);
            }
            let facts = of_rule.facts(&method)?;
            Ok((method, facts))
        });
        let method = method.transpose()?;
        ensure!(
            method.is_some() || args.attack.options.is_none(),
            "--options needs a generator; name it with --method, such as --method sage"
        );
        let selection =
            Selection::of(registries, &args.attack.selection, args.attack.rule.feasibility.as_ref())?;
        // Of a generator that plans against the ego the selection is the plan; of the others every candidate is one.
        let plans_against_ego = method.as_ref().is_some_and(|(_, facts)| facts.plans_against_ego);
        if !plans_against_ego && args.attack.selection != "natural" {
            progress::say("note: --selection has no effect: every candidate is a plan of the search");
        }
        let mut generators = if plans_against_ego {
            Generators::new(registries, merger, &selection, args.attack.seed)?
        } else {
            of_rule
        };
        let needs_experts = method.as_ref().is_none_or(|(_, facts)| facts.needs_experts);
        let with_experts = method.as_ref().is_none_or(|(_, facts)| facts.depends_on_lambda);
        let load = || Weights::load(args.attack.weights.as_deref(), with_experts, registries);
        let weights = needs_experts.then(load).transpose()?;
        if let Some(weights) = &weights {
            generators = generators.with_experts(&weights.experts);
        }
        let given = &args.attack.points;
        let points = if given.lambda.is_none() && given.aggression.is_none() && given.mix.is_none() {
            Vec::new()
        } else {
            let dial = || dial(weights.as_ref(), &args.attack, &selection);
            given.listed().specs(generators.merger().range(), dial)?
        };
        let plans = match &method {
            Some((method, _)) => PlanSources::of_generator(&generators, method, &points, args.plans)?,
            None => PlanSources::pool(&generators, &points, args.plans)?,
        };
        let options = SearchOptions {
            budget: args.budget,
            require: args.require,
            first: args.first,
            order: args.order.0,
            avoidable: args.avoidable.options().unwrap_or_default(),
        };
        Ok(Self { args, ego, rule, options, method, selection, weights, points, plans })
    }

    /// Name of the weights; `None` if no plan needs experts.
    pub(super) fn weights_name(&self) -> Option<&str> {
        self.weights.as_ref().map(|weights| &*weights.name)
    }

    /// Name of the plans in rows and tables.
    pub(super) fn method(&self) -> String {
        self.method.as_ref().map_or(POOL.to_owned(), |(method, _)| method.to_string())
    }

    /// The files of each failure.
    pub(super) fn formats(&self) -> Formats {
        let SearchArgs { format, standard, scenario_ego, .. } = self.args;
        Formats {
            pickle: self.writes_pickles(),
            native: matches!(format, SearchFormat::Native | SearchFormat::Both),
            scenario: (*format == SearchFormat::Openscenario).then(|| Options {
                standard: standard.unwrap_or_default(),
                ego: scenario_ego.unwrap_or_default(),
                license: None,
            }),
        }
    }

    /// True if pickles are written.
    pub(super) fn writes_pickles(&self) -> bool {
        matches!(self.args.format, SearchFormat::Pickle | SearchFormat::Both)
    }

    /// Identity of this run. The folder of another run is refused.
    ///
    /// *Errors*: a file of the driver cannot be read; a dial cannot be used.
    pub(super) fn identity(&self) -> Result<Value> {
        let mut weights = Map::new();
        if let Some(loaded) = &self.weights {
            weights.insert(loaded.name.clone(), weight_hashes(&loaded.experts)?.into());
        }
        let mut identity = json!({
            "command": output::command(), "method": self.method(), "weights": weights, "points": self.points,
            "selection": self.selection.objective.spec(), "feasibility": self.rule.objective.spec().feasibility,
            "merger": self.args.attack.points.merging.merger.to_string(), "search": self.options,
            "plans": self.args.plans, "adversary": self.args.attack.adversary, "seed": self.args.attack.seed,
            "format": format!("{:?}", self.args.format), "ego": ego::identity(&self.args.ego)?,
            "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
        });
        let reading = self.args.reading.identity();
        if !reading.is_null() {
            identity["reading"] = reading;
        }
        Ok(identity)
    }
}
