//! Pairs of modes of which one is preferred, and by how much more than the prior a network prefers it.

use candle_core::Tensor;
use sage_core::{
    preference_pairs::{Pair, ScoredCandidate, preference_pairs},
    seed::Rng,
};

use super::{
    FinetuneOptions, PreparedScene, goal_table::ExpertObjective, prepared_scene::numbers, step::trainable,
};
use crate::{
    Error,
    backbone::{Backbone, Shared, TrajectoryLikelihood, of_modes},
    candidates::select,
    encoding::Encoding,
};

/// Pairs of modes of one scene.
pub(super) struct ModePairs {
    pub better: Vec<usize>,
    pub worse: Vec<usize>,
}

impl ModePairs {
    /// Pairs of candidates, which are some of the modes.
    pub fn of(candidates: &[usize], pairs: &[Pair]) -> Self {
        let modes = |pick: fn(&Pair) -> usize| pairs.iter().map(|pair| candidates[pick(pair)]).collect();
        Self { better: modes(|pair| pair.winner), worse: modes(|pair| pair.loser) }
    }

    /// Margins by log-probabilities of all modes, less those of the prior.
    ///
    /// *Shapes*: `log_probs` (modes); result (pairs).
    pub fn by_log_probs(&self, log_probs: &Tensor, prior: &[f64]) -> Result<Tensor, Error> {
        let of = |modes: &[usize]| of_modes(log_probs, modes);
        let difference = (of(&self.better)? - of(&self.worse)?)?;
        let pairs = self.better.iter().zip(&self.worse);
        let reference: Vec<f64> = pairs.map(|(&better, &worse)| prior[better] - prior[worse]).collect();
        let count = reference.len();
        let reference =
            Tensor::from_vec(reference, count, log_probs.device())?.to_dtype(difference.dtype())?;
        Ok((difference - reference)?)
    }

    /// Margins by likelihoods of the trajectories that the prior drew, less those of the prior.
    ///
    /// *Shapes*: result (pairs).
    pub fn by_trajectories(
        &self,
        network: &dyn TrajectoryLikelihood,
        encoding: &Encoding,
        prior: &dyn Backbone,
        scene: &PreparedScene,
        rng: &Rng,
    ) -> Result<Tensor, Error> {
        let trajectories = |modes: &[usize]| prior.trajectories(&scene.encoding, modes);
        let (better, worse) = (trajectories(&self.better)?, trajectories(&self.worse)?);
        // All begin alike, so that all get the same noise.
        let difference = |network: &dyn TrajectoryLikelihood, encoding: &Encoding| -> Result<Tensor, Error> {
            let of =
                |trajectories: &Tensor| network.log_likelihoods(encoding, trajectories, &mut rng.clone());
            Ok((of(&better)? - of(&worse)?)?)
        };
        let reference = trainable(prior)?.trajectory_likelihood();
        let reference = reference.ok_or_else(|| Error::Mismatch("a prior of another network".to_owned()))?;
        Ok((difference(network, encoding)? - difference(reference, &scene.encoding)?.detach())?)
    }
}

/// By how much more than the prior a network prefers the better of two candidates of a scene, over pairs of the prior's candidates
/// under an expert's objective: above 0 on scenes that it was not tuned on, it has learnt the preference. `None` without pairs.
///
/// *Errors*: those of the networks.
pub fn preference_margin(
    network: &dyn Backbone,
    prior: &dyn Backbone,
    scene: &PreparedScene,
    expert: &ExpertObjective,
    options: &FinetuneOptions,
) -> Result<Option<f64>, Error> {
    let rng = scene.rng(options.seed, "preference margin");
    let reference: Vec<f32> = scene.reference.iter().map(|log_prob| *log_prob as f32).collect();
    let (candidates, pairs) = scene.pairs(&reference, expert, options, &mut rng.clone());
    if pairs.is_empty() {
        return Ok(None);
    }
    let pairs = ModePairs::of(&candidates, &pairs);
    let own = match network.shared() {
        Shared::Nothing => Some(network.encode(scene.encoding.shared_features())?),
        Shared::Encodings | Shared::Trajectories => None,
    };
    let encoding = own.as_ref().unwrap_or(&scene.encoding);
    let margins = match trainable(network)?.trajectory_likelihood() {
        None => pairs.by_log_probs(&network.log_probs(encoding)?, &scene.reference)?,
        Some(likelihood) => pairs.by_trajectories(likelihood, encoding, prior, scene, &rng)?,
    };
    let margins = numbers(&margins)?;
    Ok(Some(margins.iter().sum::<f64>() / margins.len() as f64))
}

impl PreparedScene {
    /// The scene's random numbers for a purpose. The folder of its file does not matter.
    pub(super) fn rng(&self, seed: u64, purpose: &str) -> Rng {
        let own = self.name.rsplit(['/', '\\']).next().unwrap_or(&self.name);
        Rng::new(seed, own, purpose)
    }

    /// Candidates of a policy, by its log-probabilities, and their pairs under an expert's objective.
    pub(super) fn pairs(
        &self,
        policy: &[f32],
        expert: &ExpertObjective,
        options: &FinetuneOptions,
        rng: &mut Rng,
    ) -> (Vec<usize>, Vec<Pair>) {
        let selected = select(policy, &self.ends, options.candidates, options.selection, rng);
        let candidates: Vec<ScoredCandidate> = selected
            .iter()
            .map(|&goal| ScoredCandidate {
                reward: self.table.value(goal, expert),
                is_feasible: self.table.is_feasible(goal),
            })
            .collect();
        let pairs = preference_pairs(&candidates, options.pairing, options.max_pairs, options.margin, rng);
        (selected, pairs)
    }
}
