//! A scene as fine-tuning sees it: encoded once, every goal decoded and judged.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;
use sage_core::{
    objective::{
        Context, ContextOptions, Encounter, MapFeasibility, Rule, behavior_penalty, kinematic_penalty,
    },
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use super::SceneData;
use crate::{
    Error,
    backbone::{Backbone, Encoding, finite, to_world},
    foresight::{View, foreseeing},
};

/// What every goal of a scene is worth.
pub struct GoalTable {
    /// Adversarial reward.
    pub reward: Vec<f64>,
    /// Penalty for driving unlike a car.
    pub penalty: Vec<f64>,
    /// Touched edge and agent, as 50 and 10.
    pub map_penalty: Vec<f64>,
    /// Whether no rule is broken.
    pub feasible: Vec<bool>,
    /// Whether the path hits the ego.
    pub hits: Vec<bool>,
}

/// A scene ready for fine-tuning: nothing in it depends on what is tuned.
pub struct TunedScene {
    pub(super) name: String,
    pub(super) encoding: Encoding,
    pub(super) ends: Vec<[f32; 2]>,
    /// What each goal is worth.
    pub table: GoalTable,
    pub(super) reference: Vec<f64>,
}

impl TunedScene {
    /// Encodes a scene's adversary with a prior, and decodes and judges all its goals, in one of the
    /// two mirror images; `None` if the scene has no adversary that is valid *now*, or no ego path.
    ///
    /// *Errors*: those of the network.
    pub fn new(prior: &dyn Backbone, data: &SceneData, mirrored: bool) -> Result<Option<Self>, Error> {
        let Ok(adversary) = data.scene.adversary_index() else { return Ok(None) };
        let Ok(ctx) = Context::new(&data.scene, &data.index, &ContextOptions::default()) else {
            return Ok(None);
        };
        if !data.scene.tracks[adversary].is_valid(sage_core::motion::NOW) {
            return Ok(None);
        }
        let features = foreseeing(prior, &data.scene, &data.index, adversary, View::FULL)?;
        let features = match mirrored.then(|| prior.mirrored(&features)) {
            Some(None) => return Ok(None),
            Some(Some(mirrored)) => mirrored,
            None => features,
        };
        let encoding = prior.encode(Arc::new(features))?;
        let ends = prior.mode_ends(&encoding)?;
        let modes: Vec<usize> = (0..ends.len()).collect();
        let mut paths = prior.trajectories(&encoding, &modes)?;
        if mirrored {
            let sides = Tensor::new(&[1.0, -1.0], &Device::Cpu)?.to_dtype(paths.dtype())?;
            paths = paths.broadcast_mul(&sides)?;
        }
        let paths = to_world(&paths, encoding.features()).map_err(|error| error.of(data, adversary))?;
        let rule = MapFeasibility::build(Default::default()).map_err(Error::Training)?;
        let mut table = GoalTable {
            reward: Vec::with_capacity(modes.len()),
            penalty: Vec::with_capacity(modes.len()),
            map_penalty: Vec::with_capacity(modes.len()),
            feasible: Vec::with_capacity(modes.len()),
            hits: Vec::with_capacity(modes.len()),
        };
        for path in paths {
            let candidate = ctx.candidate(path);
            let encounter = Encounter::of(&candidate, &ctx);
            let broken = rule.violations(&candidate, &ctx);
            let costs = broken.iter().map(|reason| if reason.rule == Rule::Agent { 10.0 } else { 50.0 });
            table.reward.push(encounter.reward(ctx.convention()));
            table.hits.push(encounter.contact.is_some());
            table
                .penalty
                .push(kinematic_penalty(candidate.profile()) + behavior_penalty(candidate.profile()));
            table.map_penalty.push(costs.sum());
            table.feasible.push(broken.is_empty());
        }
        let reference = finite(&prior.log_probs(&encoding)?).map_err(|error| error.of(data, adversary))?;
        let name = if mirrored { format!("{} mirrored", data.name) } else { data.name.clone() };
        Ok(Some(Self { name, encoding, ends, table, reference }))
    }

    /// All scenes that can be attacked, in parallel and in their order.
    ///
    /// *Errors*: the first of the network.
    pub fn all(prior: &dyn Backbone, scenes: &[SceneData], mirrored: bool) -> Result<Vec<Self>, Error> {
        let one = |data| Self::new(prior, data, mirrored);
        let found: Vec<_> = scenes.par_iter().with_max_len(1).map(one).collect();
        found.into_iter().filter_map(Result::transpose).collect()
    }

    /// The encoding.
    pub fn encoding(&self) -> &Encoding {
        &self.encoding
    }
}

/// Expectations under a policy over the goals of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Expectation {
    /// Probability of a feasible path.
    pub feasible: f64,
    /// Probability of a feasible path that hits the ego.
    pub attack: f64,
    /// Mean adversarial reward.
    pub reward: f64,
    /// Mean penalty for driving unlike a car.
    pub penalty: f64,
    /// Divergence from the prior, nats.
    pub kl: f64,
}

impl Expectation {
    /// Mean over scenes; `None` of none.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let n = all.len() as f64;
        let mean = |value: fn(&Self) -> f64| all.iter().map(value).sum::<f64>() / n;
        (!all.is_empty()).then(|| Self {
            feasible: mean(|e| e.feasible),
            attack: mean(|e| e.attack),
            reward: mean(|e| e.reward),
            penalty: mean(|e| e.penalty),
            kl: mean(|e| e.kl),
        })
    }
}

impl TunedScene {
    /// Expectations under a policy of the same encoder.
    ///
    /// *Errors*: those of the network.
    pub fn expectation(&self, policy: &dyn Backbone) -> Result<Expectation, Error> {
        Ok(self.weigh(&finite::<f64>(&policy.log_probs(&self.encoding)?)?))
    }

    pub(super) fn weigh(&self, log_probs: &[f64]) -> Expectation {
        let mut sum = Expectation::default();
        for (goal, log_prob) in log_probs.iter().enumerate() {
            let p = log_prob.exp();
            let t = &self.table;
            sum.feasible += p * f64::from(u8::from(t.feasible[goal]));
            sum.attack += p * f64::from(u8::from(t.feasible[goal] && t.hits[goal]));
            sum.reward += p * t.reward[goal];
            sum.penalty += p * t.penalty[goal];
            sum.kl += p * (log_prob - self.reference[goal]);
        }
        sum
    }
}

pub(super) fn numbers(tensor: &Tensor) -> Result<Vec<f64>, Error> {
    Ok(tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1()?)
}
