//! The interface of what learns to drive from its own steps.

use std::{collections::BTreeMap, io, path::Path};

use sage_sim::{Error, actor::Network, observation::LENGTH};
use serde_json::Value;

use super::NamedTensor;

/// A step that was driven.
#[derive(Clone, Copy, Debug)]
pub struct DrivenStep<'a> {
    /// Number of the episode's place among those that take turns.
    pub slot: usize,
    /// Steps of the whole training, this one included.
    pub steps: u64,
    /// Action: steering and throttle.
    pub action: [f32; 2],
    /// What the teacher would have done in its place.
    pub taught: Option<[f32; 2]>,
    /// Reward.
    pub reward: f32,
    /// Observation after the step.
    pub next: &'a [f32; LENGTH],
    /// Whether the episode ended by arrival or failure.
    pub is_terminal: bool,
    /// Whether the episode is over, for this reason or because it was cut off.
    pub is_over: bool,
}

/// Learns to drive from its own steps. Its random numbers depend on the seed and on numbers of steps and updates only, so
/// that a training that resumes from a checkpoint needs no state of generators.
pub trait Learner: Send {
    /// Steps that an episode drives in a row before the next one has its turn.
    fn turn(&self) -> u64;

    /// Whether first episodes are cut off at different ages, so that later ones do not begin and end together.
    fn staggers(&self) -> bool {
        false
    }

    /// Whether a checkpoint may be written now.
    fn may_be_saved(&self) -> bool {
        true
    }

    /// Whether it learns from a teacher's actions after so many steps of the whole training.
    fn is_taught(&self, _steps: u64) -> bool {
        false
    }

    /// An episode begins with an observation.
    fn begin(&mut self, slot: usize, observation: &[f32; LENGTH]);

    /// The action for the observation of an episode, after so many steps of the whole training. What it explores is its
    /// own matter.
    fn act(&mut self, slot: usize, steps: u64, observation: &[f32; LENGTH]) -> [f32; 2];

    /// Learns from the step that its last action led to.
    ///
    /// *Errors*: why the training cannot go on: a loss that is not finite, or values beyond all bounds.
    fn learn(&mut self, step: &DrivenStep) -> Result<(), Error>;

    /// The policy as it is now, for observations as they are, without exploration.
    fn actor(&self) -> Network<f32>;

    /// Whether the actor has learnt anything after so many steps.
    fn has_learnt(&self, steps: u64) -> bool;

    /// Updates so far.
    fn updates(&self) -> u64;

    /// Mean loss of the critic and mean size of its values since the last call.
    fn take_losses(&mut self) -> [f64; 2];

    /// Name of the first tensor with a number that is not finite.
    fn not_finite(&self) -> Option<String>;

    /// All tensors that change.
    fn tensors(&self) -> Vec<NamedTensor<'_, f32>>;

    /// Everything else that changes, as JSON. Called after [`Learner::save_rows`].
    fn record(&self) -> Value;

    /// Takes over the tensors and the record of a checkpoint in a folder, after so many steps of the whole training.
    ///
    /// *Errors*: what is missing or does not fit.
    fn restore(
        &mut self,
        tensors: &BTreeMap<String, Vec<f32>>,
        record: Value,
        steps: u64,
        folder: &Path,
    ) -> Result<(), Error>;

    /// Writes what is too large for a checkpoint into a folder beside it.
    ///
    /// *Errors*: as the system.
    fn save_rows(&mut self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }

    /// Removes from that folder what the checkpoint that was just written does not need.
    ///
    /// *Errors*: as the system.
    fn remove_old_rows(&self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }

    /// Whether all numbers that it has stored are finite.
    fn is_finite(&self) -> bool;

    /// Sets a weight to NaN, for tests of what stops a run.
    #[doc(hidden)]
    fn break_weight(&mut self, tensor: &str);
}
