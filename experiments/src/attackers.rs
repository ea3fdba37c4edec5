//! A generator that the user names, at its operating points, for scenes of any origin: options, objective and
//! weights.

use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result, ensure};
use sage_backbones::parameters::Header;
use sage_core::objective::FurtherMeasures;
use sage_generators::Facts;
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

/// The generator at all its operating points.
pub(crate) struct GeneratorAtPoints {
    /// Name of the weights; `None` for a generator without experts.
    pub(crate) weights: Option<String>,
    pub(crate) built: BuiltGenerator,
    /// Operating points as files and rows record them, even if the generator does not depend on λ or μ.
    pub(crate) points: Vec<OperatingPointSpec>,
}

/// Loaded weights with their name.
pub(crate) struct Weights {
    pub(crate) name: String,
    pub(crate) experts: ExpertSet,
    header: Header,
}

impl Weights {
    /// Says which experts are used.
    pub(crate) fn announce(&self) {
        networks::announce_experts(&self.name, &self.experts, &self.header);
    }
}

/// Weights that scenes may need: those that the user names, or the defaults for procedural and for recorded scenes. The
/// weights for a scene do not depend on other scenes.
pub(crate) struct WeightsByOrigin(pub(crate) Vec<Weights>);

impl WeightsByOrigin {
    /// Loads named weights, or the defaults; with their experts, or the prior alone.
    ///
    /// *Errors*: weights that cannot be used.
    pub(crate) fn load(named: Option<&str>, with_experts: bool, registries: &Registries) -> Result<Self> {
        let names = match named {
            Some(weights) => vec![weights.to_owned()],
            None => {
                let mut names =
                    [networks::default_for(true)?, networks::default_for(false)?].map(str::to_owned).to_vec();
                names.dedup();
                names
            }
        };
        let load = |name: String| {
            let find = if with_experts { networks::find_experts } else { networks::find_prior };
            let (experts, header) = find(&registries.backbones, &name)?;
            Ok(Weights { name, experts, header })
        };
        Ok(Self(names.into_iter().map(load).collect::<Result<Vec<_>>>()?))
    }

    /// True if the weights depend on whether the scene is procedural or recorded.
    pub(crate) fn needs_origin(&self) -> bool {
        self.0.len() > 1
    }

    /// Number of the weights for a scene, by its origin.
    ///
    /// *Errors*: as [`networks::default_for`].
    pub(crate) fn number(&self, is_procedural: bool) -> Result<usize> {
        if !self.needs_origin() {
            return Ok(0);
        }
        let name = networks::default_for(is_procedural)?;
        Ok(self.0.iter().position(|weights| weights.name == name).unwrap_or(0))
    }
}

/// The attackers of a run: one for each set of weights that its scenes need.
pub(crate) struct Attackers<'a> {
    pub(crate) args: &'a AttackArgs,
    pub(crate) method: Part,
    pub(crate) selection: Selection,
    pub(crate) further: FurtherMeasures,
    /// Name of each operating point, as part of file names.
    pub(crate) variants: Vec<String>,
    facts: Facts,
    generators: Generators<'a>,
    experts: WeightsByOrigin,
    /// Attackers built so far, by index of the weights.
    attackers: Mutex<Vec<Option<Arc<GeneratorAtPoints>>>>,
}

impl<'a> Attackers<'a> {
    /// Checks all arguments except the scenes, and loads weights.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; weights cannot be used.
    pub(crate) fn new(method: &Part, args: &'a AttackArgs, registries: &'a Registries) -> Result<Self> {
        let mut method = method.clone();
        if let Some(options) = &args.options {
            let options: Map<String, Value> =
                serde_json::from_str(options).context("--options is not a JSON object")?;
            method.options.extend(options);
        }
        let selection = Selection::of(registries, &args.selection, args.rule.feasibility.as_ref())?;
        let generators = Generators::new(registries, &args.points.merging.merger, &selection, args.seed)?;
        let facts = generators.facts(&method)?;
        let variants = args.points.listed().variants(generators.merger().range())?;
        warn_of_unused(&method, args, &facts);
        let variants = if facts.uses_operating_point() { variants } else { vec![method.name.clone()] };
        let twice = (1..variants.len()).find(|k| variants[..*k].contains(&variants[*k]));
        if let Some(k) = twice {
            anyhow::bail!("the operating point `{}` is given twice", variants[k]);
        }
        let spec = Some(selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, spec)?;
        let experts = if facts.needs_experts {
            WeightsByOrigin::load(args.weights.as_deref(), facts.depends_on_lambda, registries)?
        } else {
            WeightsByOrigin(Vec::new())
        };
        let attackers = Mutex::new((0..experts.0.len().max(1)).map(|_| None).collect());
        let all = Self { args, method, selection, further, variants, facts, generators, experts, attackers };
        if args.weights.is_some() || all.experts.0.is_empty() {
            all.attacker(true)?;
        }
        Ok(all)
    }

    /// True if the weights depend on whether the scene is procedural or recorded.
    pub(crate) fn needs_origin(&self) -> bool {
        self.experts.needs_origin()
    }

    /// The attacker of a scene, by its origin.
    ///
    /// *Errors*: the generator cannot be built with the weights, or the weights have no dial.
    pub(crate) fn attacker(&self, is_procedural: bool) -> Result<Arc<GeneratorAtPoints>> {
        let number = self.experts.number(is_procedural)?;
        let mut attackers = self.attackers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(attacker) = &attackers[number] {
            return Ok(attacker.clone());
        }
        let attacker = Arc::new(self.build(self.experts.0.get(number))?);
        attackers[number] = Some(attacker.clone());
        Ok(attacker)
    }

    fn build(&self, weights: Option<&Weights>) -> Result<GeneratorAtPoints> {
        if let Some(weights) = weights {
            weights.announce();
        }
        let args = self.args;
        let dial = || {
            let weights = weights.context("a dial needs experts; name their folder with --weights")?;
            let merger = args.points.merging.merger.to_string();
            networks::load_dial(&weights.name, &weights.experts, &self.selection, &merger)
        };
        let range = self.generators.merger().range();
        let points = if self.facts.uses_operating_point() {
            args.points.listed().specs(range, dial)?
        } else {
            vec![OperatingPointSpec::at(1.0, None, range)?]
        };
        ensure!(points.len() == self.variants.len(), "every operating point has a name");
        let experts = weights.map(|weights| &weights.experts);
        let generators =
            experts.map_or(self.generators.clone(), |experts| self.generators.with_experts(experts));
        let built = generators.build(&self.method, &points)?;
        Ok(GeneratorAtPoints { weights: weights.map(|weights| weights.name.clone()), built, points })
    }

    /// What identifies the attacks in the record of a run.
    ///
    /// *Errors*: none on a CPU.
    pub(crate) fn identity(&self) -> Result<Value> {
        let (mut weights, mut dials) = (Map::new(), Map::new());
        for Weights { name, experts, .. } in &self.experts.0 {
            weights.insert(name.clone(), weight_hashes(experts)?.into());
            if self.args.points.aggression.is_some() && self.facts.uses_operating_point() {
                // Weights without a dial fail only if a scene needs them.
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
