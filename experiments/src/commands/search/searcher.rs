//! All inputs of `sage search` except the scenes.

use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result, bail, ensure};
use sage_data::openscenario::Options;
use sage_generators::Facts;
use sage_sim::search::SearchOptions;
use serde_json::{Map, Value, json};

use crate::{
    Registries,
    attacked_files::Formats,
    attackers::WeightsByOrigin,
    cli::{SearchArgs, SearchFormat},
    ego::{self, Ego},
    generators::{Generators, weight_hashes},
    networks,
    operating_point::OperatingPointSpec,
    output,
    part::Part,
    progress,
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
    generators: Generators<'a>,
    weights: WeightsByOrigin,
    /// Sources built so far, by number of the weights.
    built: Mutex<Vec<Option<Arc<Sources>>>>,
}

/// Sources of plans with the weights that they use.
pub(super) struct Sources {
    pub(super) plans: PlanSources,
    pub(super) weights: Option<String>,
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
        let generators = if plans_against_ego {
            Generators::new(registries, merger, &selection, args.attack.seed)?
        } else {
            of_rule
        };
        let needs_experts = method.as_ref().is_none_or(|(_, facts)| facts.needs_experts);
        let with_experts = method.as_ref().is_none_or(|(_, facts)| facts.depends_on_lambda);
        let weights = if needs_experts {
            WeightsByOrigin::load(args.attack.weights.as_deref(), with_experts, registries)?
        } else {
            WeightsByOrigin(Vec::new())
        };
        let options = SearchOptions {
            budget: args.budget,
            require: args.require,
            first: args.first,
            order: args.order.0,
            avoidable: args.avoidable.options().unwrap_or_default(),
        };
        let built = Mutex::new((0..weights.0.len().max(1)).map(|_| None).collect());
        let all = Self { args, ego, rule, options, method, selection, generators, weights, built };
        if args.attack.weights.is_some() || all.weights.0.is_empty() {
            all.sources(true)?;
        }
        Ok(all)
    }

    /// True if the weights depend on whether the scene is procedural or recorded.
    pub(super) fn needs_origin(&self) -> bool {
        self.weights.needs_origin()
    }

    /// The sources of plans for a scene, by its origin.
    ///
    /// *Errors*: a generator cannot be built with the weights, or the weights have no dial.
    pub(super) fn sources(&self, is_procedural: bool) -> Result<Arc<Sources>> {
        let number = self.weights.number(is_procedural)?;
        let mut built = self.built.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sources) = &built[number] {
            return Ok(sources.clone());
        }
        let sources = Arc::new(self.build(number)?);
        built[number] = Some(sources.clone());
        Ok(sources)
    }

    fn build(&self, number: usize) -> Result<Sources> {
        let weights = self.weights.0.get(number);
        weights.iter().for_each(|weights| weights.announce());
        let generators = match weights {
            Some(weights) => self.generators.with_experts(&weights.experts),
            None => self.generators.clone(),
        };
        let points = self.points(number)?;
        let most = self.args.plans;
        let plans = match &self.method {
            Some((method, _)) => PlanSources::of_generator(&generators, method, &points, most)?,
            None => PlanSources::pool(&generators, &points, most)?,
        };
        Ok(Sources { plans, weights: weights.map(|weights| weights.name.clone()) })
    }

    /// The operating points that the user gives; none for the default ones.
    fn points(&self, number: usize) -> Result<Vec<OperatingPointSpec>> {
        let points = &self.args.attack.points;
        if points.lambda.is_none() && points.aggression.is_none() && points.mix.is_none() {
            return Ok(Vec::new());
        }
        let dial = || {
            let weights =
                self.weights.0.get(number).context("a dial needs experts; name them with --weights")?;
            networks::load_dial(
                &weights.name,
                &weights.experts,
                &self.selection,
                &points.merging.merger.to_string(),
            )
        };
        points.listed().specs(self.generators.merger().range(), dial)
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
        let (mut weights, mut points) = (Map::new(), Vec::new());
        for (number, loaded) in self.weights.0.iter().enumerate() {
            weights.insert(loaded.name.clone(), weight_hashes(&loaded.experts)?.into());
            // Weights without a dial fail only if a scene needs them.
            points.push(self.points(number).ok());
        }
        let mut identity = json!({
            "command": output::command(), "method": self.method(), "weights": weights, "points": points,
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
