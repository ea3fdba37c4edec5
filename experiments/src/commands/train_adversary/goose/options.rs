//! Options of GOOSE's training.

use anyhow::{Context as _, Result, ensure};
use sage_baselines::goose::{HINDSIGHT, TRIALS, networks::GooseOptions};
use sage_learn::Td3Options;
use serde::{Deserialize, Serialize};

use crate::cli::TrainGooseArgs;

/// Most decisions of a training: their drives are held in memory, about 3 kB each.
const MOST_DECISIONS: u64 = 200_000;
/// Most role assignments of a scene.
const MOST_ROLES: usize = 32;

/// Options of the training. Published are 12 000 decisions, a discount of 0.99, a buffer of 100 000, no other roles and no mirror
/// images (docs/results/baselines.md).
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct TrainingOptions {
    /// Decisions, each with one drive and one update.
    pub decisions: u64,
    /// Decisions with random actions at the start.
    pub random: u64,
    /// Most trials in a scene.
    pub trials: usize,
    /// Transitions of a batch.
    pub batch: usize,
    /// Newest transitions that are drawn, hindsight copies included.
    pub buffer: usize,
    /// Learning rate of actor, encoder and critics.
    pub rate: f64,
    /// Discount of a decision.
    pub gamma: f64,
    /// Standard deviation of the noise of actions.
    pub exploration_noise: f64,
    /// Most further role assignments of each scene: other vehicles as adversary.
    pub roles: usize,
    /// Whether transitions are also drawn as mirror images.
    pub mirror: bool,
    /// What the networks see, and where the curve begins.
    pub networks: GooseOptions,
    /// As published by mistake: both observations of a transition have the later curve and achieved goal.
    pub shared_curve: bool,
    /// As published by mistake: scenes whose drives never meet the adversary are learnt from.
    pub keep_unmet: bool,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            decisions: 36_000,
            random: 250,
            trials: TRIALS,
            batch: 128,
            buffer: 300_000,
            rate: 3e-4,
            gamma: 0.8,
            exploration_noise: 0.01,
            roles: 6,
            mirror: true,
            networks: GooseOptions::default(),
            shared_curve: false,
            keep_unmet: false,
        }
    }
}

impl TrainingOptions {
    /// The options of a command.
    ///
    /// *Errors*: JSON that does not fit; a number out of its range.
    pub(super) fn of(args: &TrainGooseArgs) -> Result<Self> {
        let given = &args.options;
        let options: Self =
            serde_json::from_str(given).with_context(|| format!("--options: `{given}` is not usable"))?;
        let Self { decisions, random, trials, buffer, batch, roles, .. } = options;
        ensure!(
            (1..=MOST_DECISIONS).contains(&decisions),
            "--options: `decisions` is {decisions}; expected 1 to {MOST_DECISIONS}"
        );
        ensure!((2..=100).contains(&trials), "--options: `trials` is {trials}; expected 2 to 100");
        ensure!(
            (1..decisions).contains(&random),
            "--options: `random` is {random}; expected at least 1, and less than the {decisions} `decisions`: the others learn"
        );
        ensure!(roles <= MOST_ROLES, "--options: `roles` is {roles}; expected at most {MOST_ROLES}");
        let least = batch.max(1 + HINDSIGHT);
        ensure!(buffer >= least, "--options: `buffer` is {buffer}; expected at least {least}");
        options.td3().check().map_err(|problem| anyhow::anyhow!("--options: {problem}"))?;
        Ok(options)
    }

    /// The options of the learner.
    pub(super) fn td3(&self) -> Td3Options {
        Td3Options {
            batch: self.batch,
            gamma: self.gamma,
            actor_rate: self.rate,
            critic_rate: self.rate,
            exploration_noise: self.exploration_noise,
            random_steps: self.random,
            buffer: self.buffer,
            ..Td3Options::default()
        }
    }
}
