//! Closed-loop training of a driving policy against an adversary (SAGE, algorithm 2).
//!
//! An episode: the sampler draws a scene, the curriculum decides whether and how strongly the adversary attacks, the
//! attacker plans against the newest drive in that scene, and the learner drives with exploration noise. After every
//! step follow as many updates as the ratio says. Drives of 21 steps and more enter the scene's store.
//!
//! All random numbers depend on (seed, number of the step, update or episode, purpose) alone, so a run that resumes
//! from a checkpoint needs no state of generators, and its bits are those of an uninterrupted run.

use std::sync::Arc;

use sage_core::{generator::OperatingPoint, seed::Rng};

use super::{
    ActorPolicy, Attacker, Curriculum, Evaluation, Progress, SceneSampler, SingleRow, TrainingOptions,
    TrainingState, Transition, TransitionBatch, attack_episode, drive_episode, drive_scene,
    evaluation::SHORTEST_DRIVE,
    evaluation_rules,
    success::success,
    training_state::{SIZES, StoredDrive},
};
use crate::{
    Error,
    drive::Drive,
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    scene::SimScene,
    traffic::Plan,
    vehicle::{Action, Motion},
};

/// Mean |Q| that no sound critic reaches: twice the bound 2.25/(1 − 0.99) + 10 of the return.
const DIVERGED: f64 = 470.0;
/// Updates in a row above it after which the run stops.
const DIVERGED_UPDATES: u32 = 100;
/// Mean |Q| at which it stops at once: after learning rates that large, all units may be dead, and |Q| small again.
const FAR_DIVERGED: f64 = 100.0 * DIVERGED;
/// Scenes that fail in a row after which the run stops.
const MOST_FAILURES: u32 = 1000;

/// What a training run works with.
pub struct Setting<'a> {
    /// Scenes of training.
    pub scenes: &'a [Arc<SimScene>],
    /// Scenes of evaluation.
    pub evaluation: &'a [Arc<SimScene>],
    /// What attacks in training; `None` for a training on unchanged scenes.
    pub attacker: Option<&'a dyn Attacker>,
    /// What attacks in evaluation.
    pub examiner: Option<&'a dyn Attacker>,
    /// When the adversary attacks.
    pub curriculum: &'a dyn Curriculum,
    /// Which scene is next.
    pub sampler: &'a dyn SceneSampler,
}

/// An episode in progress.
struct Slot {
    environment: Environment,
    scene: usize,
    episode: u64,
    intensity: Option<f64>,
    plan: Option<Arc<Plan>>,
    /// Row of the newest observation in the buffer.
    row: u64,
    observation: [f32; LENGTH],
    motions: Vec<Motion>,
    touched_adversary: Option<usize>,
}

/// Why a run stops before its end.
#[derive(Debug)]
pub enum Stop {
    /// A number that is not finite, or values that grow beyond all bounds: what and where.
    Broken(String),
    /// Too many scenes failed.
    Scenes(String),
}

impl std::fmt::Display for Stop {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Broken(what) | Self::Scenes(what) => f.write_str(what),
        }
    }
}

impl std::error::Error for Stop {}

/// Newest evaluations whose actors are kept.
pub const KEPT_ACTORS: usize = 5;

/// A run: options, setting, state, and the episodes in progress.
pub struct Training<'a> {
    options: TrainingOptions,
    setting: Setting<'a>,
    state: TrainingState,
    rules: Arc<EnvironmentOptions>,
    observe: fn(&Environment, &mut [f32; LENGTH]),
    slots: Vec<Option<Slot>>,
    batch: TransitionBatch<f32>,
    memory: SingleRow<f32>,
}

impl<'a> Training<'a> {
    /// A run from a state without episodes in progress: a new one, or that of a checkpoint.
    pub fn new(options: TrainingOptions, setting: Setting<'a>, state: TrainingState) -> Self {
        let slots = (0..options.environments).map(|_| None).collect();
        let batch = TransitionBatch::new(options.td3.batch, SIZES[0], SIZES[1]);
        let rules = Arc::new(options.rules());
        let (observe, memory) = (Environment::observe as _, SingleRow::default());
        Self { options, setting, state, rules, observe, slots, batch, memory }
    }

    /// With other rules of the environment than [`TrainingOptions::rules`].
    pub fn with_rules(mut self, rules: EnvironmentOptions) -> Self {
        self.rules = Arc::new(rules);
        self
    }

    /// With another observation in training, for tests of what stops a run.
    #[doc(hidden)]
    pub fn with_observation(mut self, observe: fn(&Environment, &mut [f32; LENGTH])) -> Self {
        self.observe = observe;
        self
    }

    /// The state.
    pub fn state(&self) -> &TrainingState {
        &self.state
    }

    /// The state, to save it.
    pub fn state_mut(&mut self) -> &mut TrainingState {
        &mut self.state
    }

    /// Whether all steps are done.
    pub fn is_done(&self) -> bool {
        self.state.counters.steps >= self.options.steps()
    }

    /// Runs until `until` steps are done, then ends the episodes in progress without new ones, so that the state can
    /// be saved; at the end of the training episodes are cut. Calls `progress` after every step with the number done.
    ///
    /// *Errors*: [`Stop`]; nothing broken has entered the buffer.
    pub fn advance(&mut self, until: u64, mut progress: impl FnMut(u64)) -> Result<(), Stop> {
        let total = self.options.steps();
        loop {
            let done = self.state.counters.steps;
            if done >= total {
                return Ok(());
            }
            let begins = done < until;
            let turn = (done % self.slots.len() as u64) as usize;
            let order = (turn..self.slots.len()).chain(0..turn);
            let found = order.into_iter().find(|k| begins || self.slots[*k].is_some());
            let Some(k) = found else { return Ok(()) };
            let mut slot = match self.slots[k].take() {
                Some(slot) => slot,
                None => self.begin()?,
            };
            if self.step(&mut slot)? {
                self.store(slot.scene, slot.motions);
            } else {
                self.slots[k] = Some(slot);
            }
            self.updates()?;
            self.evaluate_if_due();
            progress(self.state.counters.steps);
        }
    }

    /// Begins an episode.
    fn begin(&mut self) -> Result<Slot, Stop> {
        for _ in 0..MOST_FAILURES {
            let episode = self.state.counters.episodes;
            self.state.counters.episodes += 1;
            let rng = |purpose| Rng::new(self.options.seed, &episode.to_string(), purpose);
            let scene = self.setting.sampler.draw(&self.state.records, episode, &mut rng("scene"));
            match self.begin_in(scene, episode, &mut rng("coin"), rng("world").bits()) {
                Ok(slot) if slot.observation.iter().all(|x| x.is_finite()) => return Ok(slot),
                Ok(slot) => return Err(self.not_a_number(&slot, "observation at the start")),
                Err(error @ Error::Core(sage_core::Error::NotFinite { .. })) => {
                    return Err(self.broken(scene, &error.to_string()));
                }
                Err(error) => {
                    self.state.records[scene].count(episode, None);
                    let counters = &mut self.state.counters;
                    counters.skipped += 1;
                    if counters.skipped_because.len() < 10 {
                        counters.skipped_because.push(error.to_string());
                    }
                }
            }
        }
        let last = self.state.counters.skipped_because.last().cloned().unwrap_or_default();
        Err(Stop::Scenes(format!("{MOST_FAILURES} episodes in a row could not start; one of them: {last}")))
    }

    fn begin_in(&mut self, scene: usize, episode: u64, coin: &mut Rng, world: u64) -> Result<Slot, Error> {
        let sim = self.setting.scenes[scene].clone();
        let share = self.state.counters.steps as f64 / self.options.steps() as f64;
        let at = Progress { share, success: &self.state.success };
        let drawn = self.setting.curriculum.draw(&at, coin);
        let intensity = drawn.filter(|_| self.setting.attacker.is_some());
        let mut plan = None;
        if let (Some(lambda), Some(attacker)) = (intensity, self.setting.attacker) {
            self.refresh(scene, world)?;
            plan = Some(self.plan(scene, attacker, lambda, coin)?);
        }
        let environment = Environment::reset(sim, self.rules.clone(), plan.clone(), world)?;
        let mut observation = [0.0; LENGTH];
        (self.observe)(&environment, &mut observation);
        let buffer = &mut self.state.buffer;
        let row = if observation.iter().all(|x| x.is_finite()) { buffer.start(&observation) } else { 0 };
        let motions = vec![*environment.world().motion()];
        Ok(Slot {
            environment,
            scene,
            episode,
            intensity,
            plan,
            row,
            observation,
            motions,
            touched_adversary: None,
        })
    }

    /// The adversary's plan against one of the stored drives of a scene.
    fn plan(
        &mut self,
        scene: usize,
        attacker: &dyn Attacker,
        lambda: f64,
        coin: &mut Rng,
    ) -> Result<Arc<Plan>, Error> {
        let (stored, counters) = (&self.state.drives[scene], &mut self.state.counters);
        let chosen = stored.get(coin.below(stored.len()));
        let drive = chosen.map(|stored| Drive { motions: stored.motions.clone(), ..Drive::default() });
        let plan = {
            let at = OperatingPoint::at(lambda, lambda);
            attacker.plan(&self.setting.scenes[scene], drive.as_ref(), &at, coin.bits())?
        };
        counters.attacked += 1;
        match chosen {
            Some(stored) => counters.drive_age += counters.steps - stored.step,
            None => counters.without_drive += 1,
        }
        Ok(plan)
    }

    /// Lets the present policy drive a scene whose newest drive is too old, and stores its drive.
    fn refresh(&mut self, scene: usize, world: u64) -> Result<(), Error> {
        let Some(limit) = self.options.refresh_after else { return Ok(()) };
        let steps = self.state.counters.steps;
        let is_fresh = self.state.drives[scene].front().is_some_and(|drive| steps - drive.step <= limit);
        if is_fresh || steps < self.options.td3.random_steps {
            return Ok(());
        }
        let policy = ActorPolicy::new(self.state.learner.actor().clone());
        let (_, drive) = drive_episode(&policy, &self.setting.scenes[scene], None, &self.rules, world)?;
        self.store(scene, drive.motions);
        Ok(())
    }

    /// Stores a drive that is long enough to be attacked.
    fn store(&mut self, scene: usize, motions: Vec<Motion>) {
        if motions.len() > SHORTEST_DRIVE {
            let store = &mut self.state.drives[scene];
            store.push_front(StoredDrive { step: self.state.counters.steps, motions });
            store.truncate(self.options.drives);
        }
    }

    /// One step of an episode. Returns whether it is over.
    fn step(&mut self, slot: &mut Slot) -> Result<bool, Stop> {
        let action = self.action(slot)?;
        let outcome = match slot.environment.step(action) {
            Ok(outcome) => outcome,
            Err(error) => return Err(self.broken(slot.scene, &error.to_string())),
        };
        let mut observation = [0.0; LENGTH];
        (self.observe)(&slot.environment, &mut observation);
        self.state.counters.steps += 1;
        if let Some(column) = observation.iter().position(|x| !x.is_finite()) {
            return Err(self.not_a_number(slot, &format!("number {column} of the observation")));
        }
        let reward = outcome.reward as f32;
        if !reward.is_finite() {
            return Err(self.not_a_number(slot, "reward"));
        }
        slot.row = self.state.buffer.step(&Transition {
            from: slot.row,
            action: &[action.steer as f32, action.throttle as f32],
            reward,
            is_terminal: outcome.terminated,
            next: &observation,
        });
        slot.observation = observation;
        let world = slot.environment.world();
        slot.motions.push(*world.motion());
        let adversary = slot.plan.as_ref().map(|plan| plan.track);
        if slot.touched_adversary.is_none()
            && world.facts().contacts.iter().any(|contact| Some(contact.track) == adversary)
        {
            slot.touched_adversary = Some(world.step_count());
        }
        if slot.environment.is_over() {
            self.count_success(slot, outcome.completion);
        }
        Ok(slot.environment.is_over())
    }

    /// The action of a step: random at the start, then the actor's with noise.
    fn action(&mut self, slot: &Slot) -> Result<Action, Stop> {
        let td3 = &self.options.td3;
        let step = self.state.counters.steps;
        let mut rng = Rng::new(self.options.seed, &step.to_string(), "exploration");
        let mut numbers = [0.0_f32; 2];
        if step < td3.random_steps {
            numbers.fill_with(|| rng.uniform(-td3.max_action, td3.max_action) as f32);
        } else {
            self.state.learner.act(&slot.observation, &mut self.memory, &mut numbers);
            let deviation = td3.exploration_noise * td3.max_action;
            for x in &mut numbers {
                let noisy = f64::from(*x) + deviation * rng.normal();
                *x = noisy.clamp(-td3.max_action, td3.max_action) as f32;
            }
        }
        if numbers.iter().any(|x| !x.is_finite()) {
            let tensor = self.state.learner.not_finite().unwrap_or_else(|| "action".to_owned());
            return Err(self.not_a_number(slot, &format!("tensor `{tensor}`")));
        }
        let [steer, throttle] = numbers.map(f64::from);
        Ok(Action { steer, throttle })
    }

    /// The updates that belong to the steps so far.
    fn updates(&mut self) -> Result<(), Stop> {
        let steps = self.state.counters.steps.saturating_sub(self.options.td3.random_steps);
        let due = ((steps as f64 * self.options.ratio).floor() as u64).min(self.options.updates);
        while self.state.learner.updates() < due {
            let key = self.state.learner.updates().to_string();
            let rng = |purpose| Rng::new(self.options.seed, &key, purpose);
            if !self.state.buffer.draw(&mut rng("batch"), &mut self.batch) {
                return Ok(());
            }
            let mut smoothing = rng("smoothing");
            self.batch.noise.fill_with(|| smoothing.normal() as f32);
            let report = self.state.learner.update(&self.batch);
            let [loss, count, q] = &mut self.state.losses;
            *loss += report.critic_loss;
            *count += 1.0;
            *q += report.mean_abs_q;
            let at = self.state.learner.updates();
            if !report.critic_loss.is_finite() || report.actor_loss.is_some_and(|loss| !loss.is_finite()) {
                let tensor = self
                    .state
                    .learner
                    .not_finite()
                    .map_or(String::new(), |name| format!("; tensor `{name}` is not finite"));
                return Err(Stop::Broken(format!("update {at}: the loss is not finite{tensor}")));
            }
            let q = report.mean_abs_q;
            self.state.diverging = if q > DIVERGED { self.state.diverging + 1 } else { 0 };
            if self.state.diverging >= DIVERGED_UPDATES || q > FAR_DIVERGED {
                return Err(Stop::Broken(format!(
                    "update {at}: the training diverges; mean |Q| is {q:.3e}, and no return reaches {DIVERGED}; lower the learning rates"
                )));
            }
        }
        Ok(())
    }

    /// Counts success or failure of an episode for curriculum and sampler.
    fn count_success(&mut self, slot: &Slot, completion: f64) {
        let scene = &self.setting.scenes[slot.scene];
        let counted = success(scene, slot.plan.as_deref(), &slot.motions, slot.touched_adversary, completion);
        match counted {
            Some(success) => self.state.success.count(slot.intensity, success),
            None => self.state.counters.unavoidable += 1,
        }
        self.state.records[slot.scene].count(slot.episode, counted);
    }

    /// Evaluates at the fixed steps.
    fn evaluate_if_due(&mut self) {
        let (steps, total) = (self.state.counters.steps, self.options.steps());
        let done = self.state.evaluations.len() as u64;
        if done >= self.options.evaluations || steps < total * (done + 1) / self.options.evaluations {
            return;
        }
        let [loss, count, q] = std::mem::take(&mut self.state.losses);
        self.state.loss_curve.push([steps as f64, loss / count.max(1.0), q / count.max(1.0)]);
        let actor = self.state.learner.actor().clone();
        let policy = ActorPolicy::new(actor.clone());
        let rules = evaluation_rules(&self.rules);
        let (mut unchanged, mut attacked) = (Vec::new(), Vec::new());
        for number in 0..self.setting.evaluation.len() {
            let scene = &self.setting.evaluation[number];
            let (row, drive) = drive_scene(&policy, scene, number, &rules, 0);
            unchanged.push(row);
            let against =
                |examiner| attack_episode(&policy, scene, number, drive.as_ref(), examiner, &rules, 0);
            attacked.extend(self.setting.examiner.map(against));
        }
        let updates = self.state.learner.updates();
        let evaluations = &mut self.state.evaluations;
        evaluations.push(Evaluation { step: steps, updates, unchanged, attacked, actor: Some(actor) });
        if let Some(old) = evaluations.len().checked_sub(KEPT_ACTORS + 1) {
            evaluations[old].actor = None;
        }
    }

    fn not_a_number(&self, slot: &Slot, what: &str) -> Stop {
        self.broken(slot.scene, &format!("{what} is not a number"))
    }

    fn broken(&self, scene: usize, problem: &str) -> Stop {
        Stop::Broken(format!(
            "scene `{}`, step {} of the training: {problem}",
            self.setting.scenes[scene].scene().id,
            self.state.counters.steps
        ))
    }
}
