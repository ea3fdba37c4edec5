//! A generator that the user names on the command line, at its operating points.

use advsage::{
    Registries,
    generators::{BuiltGenerator, weight_hashes},
    operating_point::OperatingPointSpec,
    part::Part,
    selection::Selection,
};
use advsage::{
    named_generator::{GeneratorSpec, NamedGenerator},
    weights::{NamedExperts, find_dial},
};
use anyhow::{Context as _, Result};
use sage_core::objective::FurtherMeasures;
use sage_generators::Facts;
use sage_run::{output, progress};
use serde_json::{Map, Value, json};

use crate::{cli::AttackArgs, networks};

/// The generator of a run, at all its operating points.
pub(crate) struct RunGenerator<'a> {
    pub(crate) args: &'a AttackArgs,
    pub(crate) method: Part,
    pub(crate) selection: Selection,
    pub(crate) further: FurtherMeasures,
    /// Name of each operating point, as part of file names.
    pub(crate) variants: Vec<String>,
    /// `None` for a generator without experts.
    weights: Option<NamedExperts>,
    pub(crate) built: BuiltGenerator,
    /// Operating points as files and rows record them, even if the generator does not depend on λ or μ.
    pub(crate) points: Vec<OperatingPointSpec>,
}

/// The generator that arguments name.
///
/// *Errors*: `--options` is not a JSON object.
pub(crate) fn spec(method: &Part, args: &AttackArgs) -> Result<GeneratorSpec> {
    let mut method = method.clone();
    if let Some(options) = &args.options {
        let options: Map<String, Value> =
            serde_json::from_str(options).context("--options is not a JSON object")?;
        method.options.extend(options);
    }
    Ok(GeneratorSpec {
        method,
        selection: args.selection.clone(),
        feasibility: args.rule.feasibility.clone(),
        merger: args.points.merging.merger.clone(),
        weights: args.weights.clone(),
        points: args.points.listed(),
        seed: args.seed,
    })
}

impl<'a> RunGenerator<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used, or have no dial.
    pub(crate) fn new(method: &Part, args: &'a AttackArgs, registries: &'a Registries) -> Result<Self> {
        let spec = spec(method, args)?;
        let method = spec.method.clone();
        let checked = spec.checked(registries)?;
        warn_of_unused(&method, args, &checked.facts);
        let named = checked.build(networks::announce_experts)?;
        named.notes.iter().for_each(|note| progress::say(&format!("warning: {note}")));
        let NamedGenerator { selection, variants, weights, built, points, .. } = named;
        let objective = Some(selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, objective)?;
        Ok(Self { args, method, selection, further, variants, weights, built, points })
    }

    /// Name of the weights; `None` for a generator without experts.
    pub(crate) fn weights_name(&self) -> Option<&str> {
        self.weights.as_ref().map(|weights| &*weights.name)
    }

    /// What identifies the attacks in the record of a run.
    ///
    /// *Errors*: none on a CPU.
    pub(crate) fn identity(&self) -> Result<Value> {
        let (mut weights, mut dials) = (Map::new(), Map::new());
        if let Some(NamedExperts { name, experts, .. }) = &self.weights {
            let mut hashes = weight_hashes(experts)?;
            hashes.extend(self.built.files.clone());
            weights.insert(name.clone(), hashes.into());
            if self.args.points.aggression.is_some() && self.built.facts.uses_operating_point() {
                let dial = find_dial(name, experts, &self.selection).ok();
                dials.insert(name.clone(), json!(dial.map(|dial| dial.mu)));
            }
        }
        let contents = self.selection.objective.contents();
        let mut identity = json!({
            "command": output::command(), "method": self.method.to_string(), "weights": weights,
            "dials": dials, "selection": self.selection.objective.spec(), "variants": self.variants, "seed": self.args.seed,
            "merger": self.args.points.merging.merger.to_string(),
            "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
        });
        if !contents.is_empty() {
            identity["contents"] = json!(contents);
        }
        Ok(identity)
    }

    /// Description of how a variant was generated, for its row and for the metadata of its scene files.
    pub(crate) fn describe(&self, point: &OperatingPointSpec) -> Map<String, Value> {
        let described = json!({
            "method": self.method.name, "options": self.method.options, "lambda": point.lambda, "mu": point.mu,
            "aggression": point.aggression, "merger": self.args.points.merging.merger.to_string(),
            "selection": self.selection.objective.spec(),
        });
        let Value::Object(mut described) = described else { return Map::new() };
        if !point.mix.is_empty() {
            let mix = point.mix.iter().map(|(name, weight)| (name.clone(), json!(weight)));
            described.insert("mix".to_owned(), mix.collect());
        }
        described
    }
}

/// Prints a note on options that the generator does not depend on.
fn warn_of_unused(method: &Part, args: &AttackArgs, facts: &Facts) {
    let points = &args.points;
    let follows_mixture = facts.depends_on_lambda || facts.depends_on_mu;
    let given = [
        ("--lambda", points.lambda.is_some() && !follows_mixture),
        ("--mix", points.mix.is_some() && !follows_mixture),
        ("--aggression", points.aggression.is_some() && !follows_mixture),
        ("--mu", points.mu.is_some() && !facts.depends_on_mu),
        ("--merger", points.merging.merger.name != "linear" && !facts.depends_on_lambda),
        ("--selection", args.selection != "natural" && !facts.depends_on_mu),
        ("--weights", args.weights.is_some() && !facts.needs_experts),
    ];
    let unused: Vec<&str> = given.into_iter().filter(|(_, is)| *is).map(|(name, _)| name).collect();
    if !unused.is_empty() {
        progress::say(&format!("note: `{}` does not depend on {}", method, unused.join(", ")));
    }
    let is_paper = args.rule.feasibility.as_ref().is_none_or(|rule| *rule == Part::paper());
    let is_fitted = method.name == "sage" && is_paper;
    if points.aggression.is_some() && facts.uses_operating_point() && !is_fitted {
        progress::say(
            "note: the dial was fitted for `sage` under the paper's feasibility rule; here the attack rate may not rise linearly",
        );
    }
}
