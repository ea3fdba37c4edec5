//! The generators of a training: one that attacks while it learns, one that attacks its evaluation.

use advsage::{
    Registries as Parts,
    driver_search::DriverSearch,
    generators::{BuiltGenerator, Generators, weight_hashes},
    part::Part,
    search::rule,
    selection::Selection,
};
use anyhow::{Result, bail};
use sage_core::objective::ObjectiveSpec;
use sage_run::networks;
use sage_sim::attacker::Attacker;
use serde_json::{Value, json};

use crate::cli::TrainEgoArgs;

/// Name for no generator.
pub(super) const NONE: &str = "none";

pub(super) struct Attacks {
    pub(super) attacker: Option<Box<dyn Attacker>>,
    pub(super) examiner: Option<BuiltGenerator>,
    /// Name and hashes of the networks and files that both use.
    pub(super) weights: Value,
    /// True if the attacker is one of those that use the networks.
    attacker_has_experts: bool,
    /// Specification of the objective that plans are selected by.
    pub(super) selection: ObjectiveSpec,
}

impl Attacks {
    /// *Errors*: a generator that cannot be built, or cannot be searched with the policy; experts that do not load.
    pub(super) fn of(args: &TrainEgoArgs, parts: &Parts) -> Result<Self> {
        let selection = Selection::of(parts, &args.selection, None)?;
        let mut generators = Generators::new(parts, &args.merging.merger, &selection, 0)?;
        let named = [&args.method, &args.eval_method].map(|part| Some(part).filter(|p| p.name != NONE));
        let needs_experts = |part: Option<&Part>| -> Result<bool> {
            Ok(part.map(|part| generators.facts(part)).transpose()?.is_some_and(|facts| facts.needs_experts))
        };
        let [of_attacker, of_examiner] = [needs_experts(named[0])?, needs_experts(named[1])?];
        let mut weights = Value::Null;
        if of_attacker || of_examiner {
            let experts = networks::load_experts(&parts.backbones, &args.weights)?;
            weights = json!({"name": args.weights, "hashes": weight_hashes(&experts)?});
            generators = generators.with_experts(&experts);
        }
        let build = |part: Option<&Part>| -> Result<_> {
            let built = part.map(|part| generators.build(part, &[])).transpose()?;
            built.as_ref().map_or(Ok(()), BuiltGenerator::check_lambda)?;
            Ok(built)
        };
        let (attacker, examiner) = (build(named[0])?, build(named[1])?);
        for (file, hash) in [&attacker, &examiner].into_iter().flatten().flat_map(|built| &built.files) {
            weights["files"][file] = hash.clone();
        }
        let attacker = match (attacker, args.search) {
            (Some(built), Some(drives)) => Some(searching(built, drives as usize, parts)?),
            (Some(built), None) => Some(Box::new(built) as Box<dyn Attacker>),
            (None, Some(_)) => bail!("--search needs plans: name a generator by --method"),
            (None, None) => None,
        };
        let selection = selection.objective.spec().clone();
        Ok(Self { attacker, examiner, weights, attacker_has_experts: of_attacker, selection })
    }

    /// Name and hashes of what the attacker uses; null without networks.
    pub(super) fn weights_of_attacker(&self) -> &Value {
        if self.attacker_has_experts { &self.weights } else { &Value::Null }
    }

    pub(super) fn need_adversary(&self) -> bool {
        self.attacker.is_some() || self.examiner.is_some()
    }
}

/// A generator whose plans are searched with the policy in training.
fn searching(generator: BuiltGenerator, drives: usize, parts: &Parts) -> Result<Box<dyn Attacker>> {
    if generator.facts.knows.driver || generator.facts.is_upper_bound {
        bail!(
            "--search drives against plans that --method proposes, and `{}` asks the driver itself or is an upper bound; leave --search out, or name a generator such as sage",
            generator.label()
        );
    }
    Ok(Box::new(DriverSearch::new(generator, rule(parts, None)?, drives)))
}
