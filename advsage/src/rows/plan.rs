//! Where the plan of a drive comes from, as rows say it.

use sage_core::objective::kinematic_penalty;
use sage_sim::search::Pool;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::operating_point::RowKey;

/// Goals that are drawn at random, whatever λ is.
const RANDOM: &str = "random";

/// Where a plan comes from.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PlanRow {
    /// Its number in the pool.
    number: usize,
    /// Generator.
    method: String,
    lambda: Option<f64>,
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    mix: Map<String, Value>,
    /// Negative log-likelihood under the prior, nats, up to a constant of the scene.
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
            method: source.map(|key| key.part().to_string()).unwrap_or_default(),
            lambda: point.and_then(|point| point.lambda),
            mix: mix.map(|(name, weight)| (name.clone(), json!(weight))).collect(),
            nll: plan.proposal.nll,
            kinematic_penalty: kinematic_penalty(plan.candidate.profile()),
        }
    }

    /// The plan in words.
    pub fn words(&self) -> String {
        let name = self.method.split('{').next().unwrap_or_default();
        match self.lambda {
            Some(lambda) if name != RANDOM => format!("{name} lambda {lambda}"),
            None if !self.mix.is_empty() => {
                let mix = self.mix.iter().map(|(expert, weight)| format!("{expert}={weight}"));
                format!("{name} {}", mix.collect::<Vec<_>>().join(","))
            }
            _ => name.to_owned(),
        }
    }
}
