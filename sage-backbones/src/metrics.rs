//! Metrics of policies without selection and of predictions.

use std::collections::BTreeMap;

use sage_core::{
    Error,
    metric::{Metric, Metrics},
};

use crate::{prediction::Distances, training::Expectation};

/// Expectations under a policy in one scene.
#[derive(Clone, Debug, Default)]
pub struct PolicyMeasures {
    /// The built-in ones.
    pub expectation: Expectation,
    /// Expected values of further rewards, by name.
    pub rewards: BTreeMap<String, f64>,
}

/// Metrics of a policy without selection. Probabilities are shares that need not be 0 or 1.
///
/// *Errors*: two have the same name.
pub fn policy_metrics() -> Result<Metrics<PolicyMeasures>, Error> {
    type P = PolicyMeasures;
    Metrics::default().with_all([
        Metric::mean("feasible", |p: &P| Some(p.expectation.feasible))
            .about("probability of a feasible candidate")
            .more_is_better(),
        Metric::mean("attack", |p: &P| Some(p.expectation.attack))
            .about("probability of a feasible hit")
            .more_is_better(),
        Metric::mean("believable", |p: &P| Some(p.expectation.believable))
            .about("probability of a believable attack")
            .more_is_better(),
        Metric::mean("R_adv", |p: &P| Some(p.expectation.reward)).about("expected R_adv").more_is_better(),
        Metric::mean("P_real", |p: &P| Some(p.expectation.penalty)).about("expected P_real").less_is_better(),
        Metric::mean("KL", |p: &P| Some(p.expectation.kl)).unit("nats").about("divergence from the prior"),
    ])
}

/// The metrics, and the expected values of registered rewards.
///
/// *Errors*: a reward has the name of another metric.
pub fn with_rewards<'n>(
    metrics: Metrics<PolicyMeasures>,
    rewards: impl Iterator<Item = &'n str>,
) -> Result<Metrics<PolicyMeasures>, Error> {
    let reward = |name: &str| {
        let of = name.to_owned();
        Metric::mean(of.clone(), move |p: &PolicyMeasures| p.rewards.get(&of).copied())
            .about("expected value of a registered reward")
    };
    metrics.with_all(rewards.map(reward).collect::<Vec<_>>())
}

/// Metrics of the best of K predictions of a vehicle.
///
/// *Errors*: two have the same name.
pub fn prediction_metrics() -> Result<Metrics<Distances>, Error> {
    type D = Distances;
    Metrics::default().with_all([
        Metric::mean("minADE", |d: &D| Some(d.min_ade))
            .unit("m")
            .about("smallest mean distance")
            .less_is_better(),
        Metric::mean("minFDE", |d: &D| Some(d.min_fde))
            .unit("m")
            .about("smallest distance at the end")
            .less_is_better(),
        Metric::share("miss 2 m", |d: &D| Some(d.misses))
            .about("every candidate ends more than 2 m away")
            .less_is_better(),
        Metric::share("miss WOMD", |d: &D| Some(d.misses_womd))
            .about("the same by WOMD's threshold")
            .less_is_better(),
    ])
}
