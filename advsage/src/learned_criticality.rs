//! SEAL's learned score as a reward.

use std::sync::Arc;

use sage_baselines::{
    learned_scores,
    seal::networks::{CriticalityNetwork, SEAL_FILE, SealWeights},
};
use sage_core::{
    objective::{Reward, Situation},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use crate::{error::in_one_line, weights};

/// How critical a trajectory is for the ego by SEAL's network, in [0, 1]: the mean of its two outputs, the predicted collision
/// score and the predicted change of the ego's path.
#[derive(Clone)]
pub struct LearnedCriticality {
    network: Arc<CriticalityNetwork>,
    content: String,
}

/// Options of [`LearnedCriticality`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnedCriticalityOptions {
    /// Weights that hold the network: procedural, waymo or a folder.
    pub weights: String,
}

impl Default for LearnedCriticalityOptions {
    fn default() -> Self {
        Self { weights: weights::DEFAULT.to_owned() }
    }
}

impl Entry<dyn Reward> for LearnedCriticality {
    const NAME: &'static str = "learned-criticality";
    const SUMMARY: &'static str =
        "predicted collision and change of the ego's path, 0 to 1; needs learned weights";
    const SOURCE: &'static str = "Stoler et al. 2025 (SEAL)";
    type Options = LearnedCriticalityOptions;

    fn build(options: LearnedCriticalityOptions) -> Result<Box<dyn Reward>, String> {
        let name = &options.weights;
        let found = weights::find(name).map_err(|error| format!("`weights`: {}", in_one_line(&error)))?;
        let loaded = SealWeights::load_file(&found, SEAL_FILE);
        let loaded = loaded.map_err(|error| format!("`weights`: {}", in_one_line(&error)))?;
        let hash = found.tensors(SEAL_FILE).and_then(|(parameters, _)| parameters.hash());
        let content = hash.map_err(|error| format!("`weights`: {error}"))?;
        Ok(Box::new(Self { network: Arc::new(loaded.criticality), content }))
    }
}

impl Reward for LearnedCriticality {
    /// `None` if the network's output is not finite.
    fn score(&self, situation: &Situation) -> Option<f64> {
        let Situation { candidate, ego, ctx, .. } = situation;
        let scores =
            learned_scores(&self.network, &[candidate.trajectory()], ctx, std::slice::from_ref(*ego));
        scores.ok()?.first().copied()
    }

    fn content(&self) -> Option<String> {
        Some(self.content.clone())
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([0.0, 1.0])
    }

    fn is_costly(&self) -> bool {
        true
    }
}
