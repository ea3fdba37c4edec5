//! A generator that the user names, at its operating points: options, objective and weights.

use anyhow::{Context as _, Result, ensure};
use sage_core::objective::FurtherMeasures;
use sage_generators::{Aggression, Facts};
use sage_merging::ExpertSet;
use serde_json::{Map, Value, json};

use crate::{
    Registries,
    cli::AttackArgs,
    generators::{BuiltGenerator, Generators, weight_hashes},
    networks,
    operating_point::OperatingPointSpec,
    output,
    part::Part,
    progress,
    selection::Selection,
};

/// Loaded weights with their name.
pub(crate) struct Weights {
    pub(crate) name: String,
    pub(crate) experts: ExpertSet,
}

impl Weights {
    /// Loads named weights, or the default ones, and says which; with their experts, or the prior alone.
    ///
    /// *Errors*: weights that cannot be used.
    pub(crate) fn load(named: Option<&str>, with_experts: bool, registries: &Registries) -> Result<Self> {
        let name = named.unwrap_or(networks::DEFAULT).to_owned();
        let find = if with_experts { networks::find_experts } else { networks::find_prior };
        let (experts, header) = find(&registries.backbones, &name)?;
        networks::announce_experts(&name, &experts, &header);
        Ok(Self { name, experts })
    }
}

/// The generator of a run, at all its operating points.
pub(crate) struct RunGenerator<'a> {
    pub(crate) args: &'a AttackArgs,
    pub(crate) method: Part,
    pub(crate) selection: Selection,
    pub(crate) further: FurtherMeasures,
    /// Name of each operating point, as part of file names.
    pub(crate) variants: Vec<String>,
    /// `None` for a generator without experts.
    pub(crate) weights: Option<Weights>,
    pub(crate) built: BuiltGenerator,
    /// Operating points as files and rows record them, even if the generator does not depend on λ or μ.
    pub(crate) points: Vec<OperatingPointSpec>,
}

impl<'a> RunGenerator<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used, or have no dial.
    pub(crate) fn new(method: &Part, args: &'a AttackArgs, registries: &'a Registries) -> Result<Self> {
        let mut method = method.clone();
        if let Some(options) = &args.options {
            let options: Map<String, Value> =
                serde_json::from_str(options).context("--options is not a JSON object")?;
            method.options.extend(options);
        }
        let selection = Selection::of(registries, &args.selection, args.rule.feasibility.as_ref())?;
        let mut generators = Generators::new(registries, &args.points.merging.merger, &selection, args.seed)?;
        let facts = generators.facts(&method)?;
        let range = generators.merger().range();
        let variants = args.points.listed().variants(range)?;
        warn_of_unused(&method, args, &facts);
        let variants = if facts.uses_operating_point() { variants } else { vec![method.name.clone()] };
        let twice = (1..variants.len()).find(|k| variants[..*k].contains(&variants[*k]));
        if let Some(k) = twice {
            anyhow::bail!("the operating point `{}` is given twice", variants[k]);
        }
        let spec = Some(selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, spec)?;
        let load = || Weights::load(args.weights.as_deref(), facts.depends_on_lambda, registries);
        let weights = facts.needs_experts.then(load).transpose()?;
        if let Some(weights) = &weights {
            generators = generators.with_experts(&weights.experts);
        }
        let dial = || dial(weights.as_ref(), args, &selection);
        let points = if facts.uses_operating_point() {
            args.points.listed().specs(range, dial)?
        } else {
            vec![OperatingPointSpec::at(1.0, None, range)?]
        };
        ensure!(points.len() == variants.len(), "every operating point has a name");
        let built = generators.build(&method, &points)?;
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
        if let Some(Weights { name, experts }) = &self.weights {
            weights.insert(name.clone(), weight_hashes(experts)?.into());
            if self.args.points.aggression.is_some() && self.built.facts.uses_operating_point() {
                let dial = networks::find_dial(name, experts, &self.selection).ok();
                dials.insert(name.clone(), json!(dial.map(|dial| dial.mu)));
            }
        }
        Ok(json!({
            "command": output::command(), "method": self.method.to_string(), "weights": weights,
            "dials": dials, "selection": self.selection.objective.spec(), "variants": self.variants, "seed": self.args.seed,
            "merger": self.args.points.merging.merger.to_string(),
            "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
        }))
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

/// The dial of some weights for the operating points that are given.
///
/// *Errors*: there are no weights, or no dial was fitted for them.
pub(crate) fn dial(
    weights: Option<&Weights>,
    args: &AttackArgs,
    selection: &Selection,
) -> Result<Aggression> {
    let weights = weights.context("a dial needs experts; name their folder with --weights")?;
    let merger = args.points.merging.merger.to_string();
    networks::load_dial(&weights.name, &weights.experts, selection, &merger)
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
