//! Where the plan of a drive comes from, as rows say it.

use std::{borrow::Cow, collections::BTreeMap};

use sage_core::objective::kinematic_penalty;
use sage_sim::search::Pool;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::operating_point::RowKey;

/// Goals that are drawn at random, whatever λ is.
const RANDOM: &str = "random";
/// Name of the origin of plans that a search refined, and of their source in summaries.
pub(super) const REFINED: &str = "refined";

/// Where a plan comes from.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PlanRow {
    /// Its number in the pool.
    pub number: usize,
    /// `refined` for a plan that the search made from another one; absent for one that was proposed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    origin: Option<Cow<'static, str>>,
    /// Number of the plan that it was refined from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refined_from: Option<usize>,
    /// Generator, of a refined plan that of the plan before.
    pub method: String,
    /// Interpolation weight λ, if it has one.
    pub lambda: Option<f64>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    mix: BTreeMap<String, f64>,
    /// Negative log-likelihood under the prior, nats, up to a constant of the scene; none of a refined plan.
    nll: Option<f64>,
    /// Kinematic penalty of the paper.
    kinematic_penalty: f64,
}

impl PlanRow {
    /// The row of a plan of the pool; `source` is what generated it.
    pub fn new(pool: &Pool, number: usize, source: Option<&RowKey>) -> Self {
        let plan = &pool.plans[number];
        let point = source.and_then(|key| key.point.as_ref());
        let mix = point.iter().flat_map(|point| &point.mix);
        Self {
            number,
            origin: plan.refined_from.map(|_| REFINED.into()),
            refined_from: plan.refined_from,
            method: source.map(|key| key.part().to_string()).unwrap_or_default(),
            lambda: point.and_then(|point| point.lambda),
            mix: mix.map(|(name, weight)| (name.clone(), *weight)).collect(),
            nll: plan.proposal.nll,
            kinematic_penalty: kinematic_penalty(plan.candidate.profile()),
        }
    }

    /// Its fields.
    pub fn to_map(&self) -> Map<String, Value> {
        match serde_json::to_value(self) {
            Ok(Value::Object(map)) => map,
            // Its keys are texts.
            _ => Map::new(),
        }
    }

    /// The plan in words.
    pub fn words(&self) -> String {
        let name = self.method.split('{').next().unwrap_or_default();
        let source = match self.lambda {
            Some(lambda) if name != RANDOM => format!("{name} lambda {lambda}"),
            None if !self.mix.is_empty() => {
                let mix = self.mix.iter().map(|(expert, weight)| format!("{expert}={weight}"));
                format!("{name} {}", mix.collect::<Vec<_>>().join(","))
            }
            _ => name.to_owned(),
        };
        if self.refined_from.is_some() { format!("{source} refined") } else { source }
    }
}
