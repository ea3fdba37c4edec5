//! The training of GOOSE: TD3 with goals in hindsight, on one trial at a time in random scenes.
//!
//! A decision changes the curve of a scene, lets the driver drive against it, and stores what happened. Scenes keep their curve
//! until the goal is reached or their trials are used up. All random numbers depend on (seed, number of the decision, purpose)
//! alone, so a run resumes from its weights and its actions: the drives are driven again, in seconds, in place of a stored
//! replay buffer.

use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use sage_baselines::goose::{
    Trial, TrialScene,
    networks::{ACTION, HIDDEN, STATE, training::EncoderTraining},
};
use sage_core::{objective::Context, seed::Rng};
use sage_learn::{Td3Learner, TransitionBatch};
use sage_sim::{actor::SingleRow, attack_test::AttackTest, queried::QueriedDriver};
use serde::{Deserialize, Serialize};

use super::{
    memory::{Memory, Moment},
    options::TrainingOptions,
};

/// A scene of training with its driver.
pub(super) struct Seat<'a> {
    scene: TrialScene<'a>,
    driver: QueriedDriver<'a, 'a>,
    /// The curve through the recording, tried once for all.
    first: Trial,
    moment: Arc<Moment>,
}

impl<'a> Seat<'a> {
    /// Tries the first curve of a scene.
    ///
    /// *Errors*: those of the driver.
    pub(super) fn new(test: &'a AttackTest<'a>, ctx: &'a Context, options: &TrainingOptions) -> Result<Self> {
        let scene = TrialScene::new(ctx, &options.networks)?;
        let driver = QueriedDriver::new(test);
        let first = scene.trial(scene.first_curve().clone(), &driver)?;
        Ok(Self { moment: Moment::of(&first), scene, driver, first })
    }

    /// Whether something can be learnt in it.
    pub(super) fn is_useful(&self, options: &TrainingOptions) -> bool {
        !self.first.outcome.is_done && (options.keep_unmet || self.first.is_met())
    }
}

/// A scene between its first and its last trial.
struct InProgress {
    trial: Trial,
    moment: Arc<Moment>,
    began: u64,
    /// Number of trials so far.
    trials: usize,
    reward: f64,
}

/// How the trials in a scene ended.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Ended {
    /// Decision of its first change of the curve, from 1. Parts of a training are told apart by it: by the last one, the first part
    /// would hold those that end soon.
    pub began: u64,
    /// Scene.
    pub scene: usize,
    /// Whether the goal was reached.
    pub is_done: bool,
    /// Whether the ego had a contact with the adversary in the last trial.
    pub is_hit: bool,
    /// Least distance in the last trial, metres.
    pub distance: f64,
    /// Sum of the rewards.
    pub reward: f64,
}

/// Means over the updates of a part of the training.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Losses {
    pub decision: u64,
    pub critic: f64,
    pub mean_abs_q: f64,
    pub updates: u64,
}

/// A training.
pub(super) struct Training<'a> {
    options: TrainingOptions,
    seed: u64,
    seats: &'a [Seat<'a>],
    scenes: Vec<Option<InProgress>>,
    memory: Memory,
    learner: Td3Learner<f32>,
    encoder: EncoderTraining,
    batch: TransitionBatch<f32>,
    single: SingleRow<f32>,
    /// Actions so far.
    actions: Vec<[f64; ACTION]>,
    ended: Vec<Ended>,
    losses: Vec<Losses>,
    /// Drives that failed in a row.
    failures: u32,
}

/// Decisions of a row of the losses.
const ROW: u64 = 250;
/// Drives that fail in a row after which the training ends.
const MOST_FAILURES: u32 = 50;

impl<'a> Training<'a> {
    /// A training before its first decision.
    ///
    /// *Errors*: options that the learner refuses.
    pub(super) fn new(options: &TrainingOptions, seats: &'a [Seat<'a>], seed: u64) -> Result<Self> {
        let td3 = options.td3();
        let batch = TransitionBatch::new(td3.batch, STATE, ACTION);
        let learner = Td3Learner::new(td3, [STATE, ACTION], seed).and_then(|l| l.with_input_gradient(HIDDEN));
        Ok(Self {
            options: options.clone(),
            seed,
            seats,
            scenes: seats.iter().map(|_| None).collect(),
            memory: Memory::new(options),
            learner: learner.map_err(anyhow::Error::msg)?,
            encoder: EncoderTraining::new(seed, options.rate)?,
            batch,
            single: SingleRow::default(),
            actions: Vec::new(),
            ended: Vec::new(),
            losses: Vec::new(),
            failures: 0,
        })
    }

    /// Number of decisions so far.
    pub(super) fn decisions(&self) -> u64 {
        self.actions.len() as u64
    }

    /// Whether all decisions are made.
    pub(super) fn is_done(&self) -> bool {
        self.decisions() >= self.options.decisions
    }

    /// Scenes whose trials ended, in the order of their ends.
    pub(super) fn ended(&self) -> &[Ended] {
        &self.ended
    }

    pub(super) fn losses(&self) -> &[Losses] {
        &self.losses
    }

    pub(super) fn learner(&self) -> &Td3Learner<f32> {
        &self.learner
    }

    pub(super) fn encoder(&self) -> &EncoderTraining {
        &self.encoder
    }

    pub(super) fn actions(&self) -> &[[f64; ACTION]] {
        &self.actions
    }

    /// Makes the next decision and learns from a batch.
    ///
    /// *Errors*: the driver fails; a number is not finite.
    pub(super) fn decide(&mut self) -> Result<()> {
        let decision = self.decisions();
        let scene = self.scene_of(decision);
        let moment = self.scenes[scene].as_ref().map_or(&self.seats[scene].moment, |at| &at.moment).clone();
        let action = self.action(decision, &moment)?;
        self.apply(scene, action)?;
        if decision >= self.options.random && !self.memory.is_empty() {
            self.update(decision).with_context(|| format!("decision {}", decision + 1))?;
        }
        Ok(())
    }

    /// Makes the decisions of an interrupted training again, without learning, and takes over what it had learnt.
    ///
    /// *Errors*: the driver fails, or state and networks do not fit.
    pub(super) fn resume(
        &mut self,
        actions: &[[f64; ACTION]],
        losses: Vec<Losses>,
        restore: impl FnOnce(&mut Td3Learner<f32>, &mut EncoderTraining) -> Result<()>,
    ) -> Result<()> {
        for action in actions {
            self.apply(self.scene_of(self.decisions()), *action)?;
        }
        self.losses = losses;
        restore(&mut self.learner, &mut self.encoder)
    }

    /// Ends the scenes in progress by the policy without noise, so that the last part of the training is whole.
    ///
    /// *Errors*: as [`Training::decide`].
    pub(super) fn end_scenes(&mut self) -> Result<()> {
        for scene in 0..self.seats.len() {
            while let Some(at) = &self.scenes[scene] {
                let moment = at.moment.clone();
                let action = self.policy(&moment)?.map(f64::from);
                self.apply(scene, action)?;
            }
        }
        Ok(())
    }

    fn rng(&self, decision: u64, purpose: &str) -> Rng {
        Rng::new(self.seed, &decision.to_string(), purpose)
    }

    fn scene_of(&self, decision: u64) -> usize {
        self.rng(decision, "scene").below(self.seats.len())
    }

    /// A random action at the start, then the actor's with noise.
    fn action(&mut self, decision: u64, moment: &Moment) -> Result<[f64; ACTION]> {
        let mut rng = self.rng(decision, "exploration");
        if decision < self.options.random {
            return Ok(std::array::from_fn(|_| rng.uniform(-1.0, 1.0)));
        }
        let action = self.policy(moment).with_context(|| format!("decision {}", decision + 1))?;
        let noise = self.options.exploration_noise;
        Ok(action.map(|x| (f64::from(x) + noise * rng.normal()).clamp(-1.0, 1.0)))
    }

    /// The actor's action.
    fn policy(&mut self, moment: &Moment) -> Result<[f32; ACTION]> {
        let encoded = self.encoder.encode_fixed(&[&moment.rows])?;
        let mut action = [0.0_f32; ACTION];
        self.learner.act(&moment.state(&encoded), &mut self.single, &mut action);
        if action.iter().any(|x| !x.is_finite()) {
            let name = self.learner.not_finite().unwrap_or_else(|| "action".to_owned());
            bail!("tensor `{name}` holds a number that is not finite");
        }
        Ok(action)
    }

    /// Changes the curve of a scene by an action, lets the driver drive, and remembers it.
    fn apply(&mut self, scene: usize, action: [f64; ACTION]) -> Result<()> {
        let (decision, seat) = (self.decisions(), &self.seats[scene]);
        self.actions.push(action);
        let at = self.scenes[scene].take().unwrap_or_else(|| InProgress {
            trial: seat.first.clone(),
            moment: seat.moment.clone(),
            began: decision + 1,
            trials: 1,
            reward: seat.first.outcome.reward,
        });
        let trial = match seat.scene.trial(at.trial.curve.changed(&action), &seat.driver) {
            Ok(trial) => trial,
            // The scene begins anew: one drive that fails does not end a training of hours.
            Err(error) => {
                self.failures += 1;
                if self.failures < MOST_FAILURES {
                    return Ok(());
                }
                return Err(error).context(format!("{MOST_FAILURES} drives in a row failed; the last one"));
            }
        };
        self.failures = 0;
        let moment = Moment::of(&trial);
        if self.options.keep_unmet || trial.is_met() {
            let mut goals = self.rng(decision, "hindsight");
            self.memory.add([at.moment, moment.clone()], action, &trial, &mut goals);
        }
        let (trials, reward) = (at.trials + 1, at.reward + trial.outcome.reward);
        if trial.outcome.is_done || trials >= self.options.trials {
            let distance = trial.achieved[0];
            let (is_done, is_hit) = (trial.outcome.is_done, trial.is_hit);
            self.ended.push(Ended { began: at.began, scene, is_done, is_hit, distance, reward });
        } else {
            self.scenes[scene] = Some(InProgress { trial, moment, began: at.began, trials, reward });
        }
        Ok(())
    }

    /// One update of critics, and at every second one of actor and encoder.
    fn update(&mut self, decision: u64) -> Result<()> {
        let [mut draws, mut noise] = ["batch", "smoothing"].map(|purpose| self.rng(decision, purpose));
        let drawn = self.memory.draw(&mut draws, &mut self.batch);
        self.batch.noise.fill_with(|| noise.normal() as f32);
        // Two threads at most: the bits do not depend on them.
        let encoder = &self.encoder;
        let [before, after] =
            [&drawn.before, &drawn.after].map(|drives| drives.iter().map(|rows| &**rows).collect::<Vec<_>>());
        let (encoded, after) = rayon::join(|| encoder.encode(&before), || encoder.encode_fixed(&after));
        let (encoded, after) = (encoded?, after?);
        for (to, from) in [
            (&mut self.batch.observations, encoded.hidden()),
            (&mut self.batch.next_observations, &after[..]),
        ] {
            for (state, encoded) in to.chunks_exact_mut(STATE).zip(from.chunks_exact(HIDDEN)) {
                state[..HIDDEN].copy_from_slice(encoded);
            }
        }
        let report = self.learner.update(&self.batch);
        if !report.critic_loss.is_finite() || report.actor_loss.is_some_and(|loss| !loss.is_finite()) {
            let name = self.learner.not_finite().unwrap_or_else(|| "loss".to_owned());
            bail!("`{name}` is not finite; lower `rate`");
        }
        if let Some(gradient) = self.learner.input_gradient() {
            self.encoder.step(&encoded, gradient)?;
        }
        let end = ((decision / ROW + 1) * ROW).min(self.options.decisions);
        if self.losses.last().is_none_or(|last| last.decision != end) {
            self.losses.push(Losses { decision: end, ..Losses::default() });
        }
        if let Some(losses) = self.losses.last_mut() {
            losses.updates += 1;
            let share = 1.0 / losses.updates as f64;
            losses.critic += share * (report.critic_loss - losses.critic);
            losses.mean_abs_q += share * (report.mean_abs_q - losses.mean_abs_q);
        }
        Ok(())
    }
}
