//! Everything of a training run that changes and that a checkpoint holds.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use sage_sim::{
    Error, actor::Network, curriculum::SuccessRates, evaluation::EpisodeRow, traffic::Plan, vehicle::Motion,
};
use serde::{Deserialize, Serialize};

use super::{
    Algorithm, Learner, Ppo, SceneRecord, Td3, TrainingOptions,
    running_episode::{Attack, EpisodeRecord},
};

/// One evaluation of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Steps of the environments before it.
    pub step: u64,
    /// Updates before it.
    pub updates: u64,
    /// Unchanged scenes.
    pub unchanged: Vec<EpisodeRow>,
    /// The same scenes under attack; empty without an attacker.
    pub attacked: Vec<EpisodeRow>,
    /// The actor, for the newest evaluations.
    #[serde(skip)]
    pub actor: Option<Network<f32>>,
}

/// Counters of a run, for progress and its record.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    /// Steps of the environments.
    pub steps: u64,
    /// Episodes begun.
    pub episodes: u64,
    /// Episodes with an attack.
    pub attacked: u64,
    /// Sum over attacked episodes of the steps since the attacked drive was recorded.
    pub drive_age: u64,
    /// Attacked episodes whose scene had no drive yet.
    pub without_drive: u64,
    /// Failures against attacks that are not shown avoidable.
    pub unavoidable: u64,
    /// Episodes that could not start or be attacked, or met a defect.
    pub skipped: u64,
    /// Messages of the first of them.
    pub skipped_because: Vec<String>,
}

/// A drive in a scene's store, with the step at which it ended.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StoredDrive {
    pub(super) step: u64,
    pub(super) motions: Vec<Motion>,
}

/// The newest attack of a scene, if later episodes meet it again ([`TrainingOptions::renew_attack_after`]).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct KeptAttack {
    pub(super) attack: Attack,
    /// Episodes that have met it.
    pub(super) episodes: u64,
    /// Its plan; a checkpoint does not hold it, since the attack gives it.
    #[serde(skip)]
    pub(super) plan: Option<Arc<Plan>>,
}

/// Everything of a run that changes and that a checkpoint holds.
pub struct TrainingState {
    pub(super) learner: Box<dyn Learner>,
    /// The episodes in progress when it was saved, by their place.
    pub(super) episodes: Vec<Option<EpisodeRecord>>,
    pub(super) drives: Vec<VecDeque<StoredDrive>>,
    /// By scene.
    pub(super) attacks: BTreeMap<usize, KeptAttack>,
    pub(super) records: Vec<SceneRecord>,
    pub(super) success: SuccessRates,
    pub(super) counters: Counters,
    /// Steps, mean loss of the critic and mean size of its values at each evaluation.
    pub(super) loss_curve: Vec<[f64; 3]>,
    pub(super) evaluations: Vec<Evaluation>,
}

impl TrainingState {
    /// The state before the first step.
    ///
    /// *Errors*: as [`TrainingOptions::check`].
    pub fn new(options: &TrainingOptions, scenes: usize) -> Result<Self, Error> {
        Ok(Self {
            learner: learner(options)?,
            episodes: Vec::new(),
            drives: vec![VecDeque::new(); scenes],
            attacks: BTreeMap::new(),
            records: vec![SceneRecord::default(); scenes],
            success: SuccessRates::default(),
            counters: Counters::default(),
            loss_curve: Vec::new(),
            evaluations: Vec::new(),
        })
    }

    /// The learner.
    pub fn learner(&self) -> &dyn Learner {
        &*self.learner
    }

    /// Sets a weight to NaN, for tests of what stops a run.
    #[doc(hidden)]
    pub fn break_weight(&mut self, tensor: &str) {
        self.learner.break_weight(tensor);
    }

    /// Counters.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// All evaluations so far.
    pub fn evaluations(&self) -> &[Evaluation] {
        &self.evaluations
    }

    /// Steps, mean loss of the critic and mean size of its values at each evaluation.
    pub fn loss_curve(&self) -> &[[f64; 3]] {
        &self.loss_curve
    }
}

/// The learner before the first step.
///
/// *Errors*: as [`TrainingOptions::check`].
fn learner(options: &TrainingOptions) -> Result<Box<dyn Learner>, Error> {
    options.check()?;
    Ok(match options.algorithm {
        Algorithm::Td3 => Box::new(Td3::new(options)?),
        Algorithm::Ppo => {
            let batches = options.steps() / options.ppo.batch() as u64;
            Box::new(Ppo::new(options.ppo.clone(), batches, options.seed)?)
        }
    })
}
