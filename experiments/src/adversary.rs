//! A generator as the attacker of training and evaluation in closed loop.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    Error,
    generator::{Generator, OperatingPoint},
};
use sage_generators::Facts;
use sage_merging::{ExpertSet, Merger};
use sage_sim::{
    SimScene,
    drive::Drive,
    rl::{Attacker, plan_of_generator},
    traffic::Plan,
};
use serde_json::{Value, json};

use crate::{
    Registries, generators, networks, operating_point::OperatingPointSpec, part::Part, selection::Selection,
};

/// A generator with its weights.
pub(crate) struct Adversary {
    generator: Box<dyn Generator>,
    facts: Facts,
    experts: Option<ExpertSet>,
    merger: Arc<dyn Merger>,
    /// Name and hashes of its weights, for the record of a run.
    pub(crate) weights: Value,
}

impl Adversary {
    /// Builds a generator, with weights if it needs them.
    ///
    /// *Errors*: the name is not registered, or the weights cannot be used.
    pub(crate) fn new(
        part: &Part,
        weights: &str,
        merger: &Part,
        selection: &Selection,
        registries: &Registries,
    ) -> Result<Self> {
        let kind = part.build(&registries.generators)?;
        let facts = kind.facts();
        let experts = facts
            .needs_experts
            .then(|| networks::load_experts(&registries.backbones, weights))
            .transpose()?;
        let merger: Arc<dyn Merger> = merger.build(&registries.mergers)?.into();
        let inputs = generators::inputs(experts.as_ref(), &merger, selection, 0);
        let hashes = match &experts {
            None => Vec::new(),
            Some(set) => {
                let tensors = set.experts().iter().map(|(_, weights)| weights);
                std::iter::once(set.prior().parameters())
                    .chain(tensors)
                    .map(|weights| weights.hash())
                    .collect::<Result<Vec<_>, _>>()?
            }
        };
        let weights = json!({"name": experts.as_ref().map(|_| weights), "hashes": hashes});
        Ok(Self { generator: kind.build(&inputs)?, facts, experts, merger, weights })
    }

    fn point(&self, lambda: f64) -> Result<OperatingPoint, Error> {
        if !self.facts.uses_operating_point() {
            return Ok(OperatingPoint::at(1.0, 1.0));
        }
        let experts = self.experts.as_ref().filter(|_| self.facts.depends_on_lambda);
        let spec =
            OperatingPointSpec::at(lambda, None, self.merger.range()).and_then(|spec| spec.point(experts));
        spec.map_err(|error| Error::Options {
            kind: "generator",
            name: "lambda",
            problem: format!("{error:#}"),
        })
    }
}

impl Attacker for Adversary {
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        lambda: f64,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        plan_of_generator(&*self.generator, &self.point(lambda)?, scene, drive, seed)
    }
}
