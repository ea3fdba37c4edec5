//! Closed-loop training of a driving policy against an adversary (SAGE, algorithm 2).
//!
//! An episode: the sampler draws a scene, the curriculum decides whether and how strongly the adversary attacks, the
//! attacker plans against the newest drive in that scene, and the learner drives with exploration noise. After every
//! step the learner may update itself. Drives of 21 steps and more enter the scene's store.
//!
//! All random numbers depend on (seed, number of the step, update or episode, purpose) alone, so a run that resumes
//! from a checkpoint needs no state of generators, and its bits are those of an uninterrupted run.

mod attacking;

use std::{io, path::Path, sync::Arc};

use sage_core::{
    defect::{self, Defect},
    seed::Rng,
};
use sage_sim::{
    Error, SimScene,
    actor::ActorPolicy,
    attacker::Attacker,
    curriculum::{Curriculum, Progress},
    environment::{Environment, EnvironmentOptions},
    evaluation::{SHORTEST_DRIVE, attack_episode, drive_scene, evaluation_rules},
    observation::LENGTH,
    policy::EgoPolicy,
    success::success,
    traffic::Plan,
    vehicle::Motion,
};

use super::{
    DrivenStep, Evaluation, SceneSampler, TrainingOptions, TrainingState,
    running_episode::{EpisodeRecord, Observe, RunningEpisode},
    training_state::StoredDrive,
};

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
    /// Whose actions PPO imitates first ([`super::PpoOptions::taught`]); other learners have no use for it.
    pub teacher: Option<&'a dyn EgoPolicy>,
    /// Where the scenes of a second kind begin, and the share of the episodes that is in them.
    pub second_kind: Option<(usize, f64)>,
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
    observe: Observe,
    slots: Vec<Option<RunningEpisode>>,
    /// Whether the episodes of the checkpoint are in the slots again.
    is_resumed: bool,
}

impl<'a> Training<'a> {
    /// A run from a state: a new one, or that of a checkpoint.
    pub fn new(options: TrainingOptions, setting: Setting<'a>, state: TrainingState) -> Self {
        let slots = (0..options.slots()).map(|_| None).collect();
        let rules = Arc::new(options.rules());
        Self { options, setting, state, rules, observe: Environment::observe, slots, is_resumed: false }
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

    /// Saves the state and the episodes in progress into a folder.
    ///
    /// *Errors*: as the system.
    pub fn save(&mut self, folder: &Path, identity: &str) -> io::Result<()> {
        if self.is_resumed {
            let records = self.slots.iter().map(|slot| Some(slot.as_ref()?.record.clone()));
            self.state.episodes = records.collect();
        }
        self.state.save(folder, identity)
    }

    /// Whether all steps are done.
    pub fn is_done(&self) -> bool {
        self.state.counters.steps >= self.options.steps()
    }

    /// Runs until at least `until` steps are done and the state may be saved; at the end of the training episodes are cut.
    /// Calls `progress` after every step with the number done.
    ///
    /// *Errors*: [`Stop`]; the learner has learnt nothing broken.
    pub fn advance(&mut self, until: u64, mut progress: impl FnMut(u64)) -> Result<(), Stop> {
        self.resume()?;
        let total = self.options.steps();
        loop {
            let done = self.state.counters.steps;
            if done >= total || (done >= until && self.state.learner.may_be_saved()) {
                return Ok(());
            }
            let k = (done / self.state.learner.turn() % self.slots.len() as u64) as usize;
            let mut slot = match self.slots[k].take() {
                Some(slot) => slot,
                None => self.begin(k)?,
            };
            let is_over = self.step(k, &mut slot)?;
            if is_over {
                self.store_unless_cut_off(slot);
            } else {
                self.slots[k] = Some(slot);
            }
            self.evaluate_if_due();
            progress(self.state.counters.steps);
        }
    }

    /// Begins the episodes of a checkpoint again and drives them to where they were.
    fn resume(&mut self) -> Result<(), Stop> {
        if std::mem::replace(&mut self.is_resumed, true) {
            return Ok(());
        }
        for (k, record) in std::mem::take(&mut self.state.episodes).into_iter().enumerate() {
            let Some(record) = record else { continue };
            let scene = record.scene;
            let running = self.plan_of(&record).and_then(|plan| self.running(record, plan));
            self.slots[k] = Some(running.map_err(|error| self.broken(scene, &error.to_string()))?);
        }
        Ok(())
    }

    /// Begins an episode.
    fn begin(&mut self, k: usize) -> Result<RunningEpisode, Stop> {
        for _ in 0..MOST_FAILURES {
            let episode = self.state.counters.episodes;
            self.state.counters.episodes += 1;
            let seed = self.options.seed;
            let rng = |purpose| Rng::new(seed, &episode.to_string(), purpose);
            let scene = self.draw_scene(episode, &mut rng("scene"));
            let mut coin = rng("coin");
            let begun = defect::caught(|| self.begin_in(scene, episode, k, &mut coin, rng("world").bits()));
            match begun.unwrap_or_else(|defect| Err(self.setting.scenes[scene].error(defect.to_string()))) {
                Ok(running) if running.observation.iter().all(|x| x.is_finite()) => {
                    self.state.learner.begin(k, &running.observation);
                    return Ok(running);
                }
                Ok(running) => return Err(self.not_a_number(&running, "observation at the start")),
                Err(error @ Error::Core(sage_core::Error::NotFinite { .. })) => {
                    return Err(self.broken(scene, &error.to_string()));
                }
                Err(error) => self.skip(scene, episode, &error),
            }
        }
        let last = self.state.counters.skipped_because.last().cloned().unwrap_or_default();
        Err(Stop::Scenes(format!("{MOST_FAILURES} episodes in a row could not start; one of them: {last}")))
    }

    /// Counts an episode that could not start, or met a defect.
    fn skip(&mut self, scene: usize, episode: u64, reason: &Error) {
        self.state.records[scene].count(episode, None);
        let counters = &mut self.state.counters;
        counters.skipped += 1;
        if counters.skipped_because.len() < 10 {
            counters.skipped_because.push(reason.to_string());
        }
    }

    /// The scene of an episode.
    fn draw_scene(&self, episode: u64, rng: &mut Rng) -> usize {
        let (records, sampler) = (&self.state.records, self.setting.sampler);
        let Some((first, share)) = self.setting.second_kind else {
            return sampler.draw(records, episode, rng);
        };
        let (main, second) = records.split_at(first);
        if second.is_empty() || (rng.unit() >= share && !main.is_empty()) {
            return sampler.draw(main, episode, rng);
        }
        first + sampler.draw(second, episode, rng)
    }

    fn begin_in(
        &mut self,
        scene: usize,
        number: u64,
        k: usize,
        coin: &mut Rng,
        world: u64,
    ) -> Result<RunningEpisode, Error> {
        let share = self.state.counters.steps as f64 / self.options.steps() as f64;
        let at = Progress { share, success: &self.state.success };
        let drawn = self.setting.curriculum.draw(&at, coin);
        let (attack, plan) = match drawn.zip(self.setting.attacker) {
            Some((lambda, attacker)) => {
                let (attack, plan) = self.attack(attacker, scene, lambda, coin, world)?;
                (Some(attack), Some(plan))
            }
            None => (None, None),
        };
        let slots = self.slots.len();
        // Of the first turn of this place.
        let first_step = k as u64 * self.state.learner.turn();
        let is_first = self.state.learner.staggers() && self.state.counters.steps == first_step;
        let limit = is_first.then(|| (k * self.options.max_steps).div_ceil(slots)).filter(|limit| *limit > 0);
        let mirror = self.options.mirrored;
        let draws_mirror = || Rng::new(self.options.seed, &number.to_string(), "mirror").unit() < mirror;
        let is_mirrored = mirror > 0.0 && draws_mirror();
        let record = EpisodeRecord { scene, number, world, is_mirrored, limit, attack, actions: Vec::new() };
        let running = self.running(record, plan)?;
        if let Some(attack) = &running.record.attack {
            self.count_attack(attack);
        }
        Ok(running)
    }

    /// Begins an episode and drives it as its record says.
    fn running(&self, record: EpisodeRecord, plan: Option<Arc<Plan>>) -> Result<RunningEpisode, Error> {
        let scene = &self.setting.scenes[record.scene];
        RunningEpisode::of(record, scene, plan, self.teacher(), &self.rules, self.observe)
    }

    /// The teacher, as long as the learner learns from one.
    fn teacher(&self) -> Option<&'a dyn EgoPolicy> {
        self.setting.teacher.filter(|_| self.state.learner.is_taught(self.state.counters.steps))
    }

    /// The policy as it is now.
    fn policy(&self) -> ActorPolicy {
        self.options.policy(self.state.learner.actor())
    }

    /// Stores the drive of an episode that came to its end.
    fn store_unless_cut_off(&mut self, episode: RunningEpisode) {
        if !episode.is_cut_off() {
            self.store(episode.record.scene, episode.motions);
        }
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
    fn step(&mut self, k: usize, slot: &mut RunningEpisode) -> Result<bool, Stop> {
        let action = self.state.learner.act(k, self.state.counters.steps, &slot.observation);
        if action.iter().any(|x| !x.is_finite()) {
            let tensor = self.state.learner.not_finite().unwrap_or_else(|| "action".to_owned());
            return Err(self.not_a_number(slot, &format!("tensor `{tensor}`")));
        }
        if self.teacher().is_none() {
            slot.dismiss_teacher();
        }
        let observe = self.observe;
        let stepped = defect::caught(|| slot.step(action).inspect(|_| slot.observe(observe)));
        self.state.counters.steps += 1;
        let outcome = match stepped {
            Ok(outcome) => outcome.map_err(|error| self.broken(slot.record.scene, &error.to_string()))?,
            Err(defect) => return self.give_up(k, slot, action, &defect).map(|()| true),
        };
        if let Some(column) = slot.observation.iter().position(|x| !x.is_finite()) {
            return Err(self.not_a_number(slot, &format!("number {column} of the observation")));
        }
        let reward = outcome.reward as f32;
        if !reward.is_finite() {
            return Err(self.not_a_number(slot, "reward"));
        }
        let is_over = slot.is_over();
        // What was cut off only so that episodes do not end together shows neither success nor failure.
        if is_over && !slot.is_cut_off() {
            // Where leaving the road ends no episode, the route may be completed beside it.
            let is_beside = self.rules.goes_on && slot.left_road;
            self.count_success(slot, if is_beside { 0.0 } else { outcome.completion });
        }
        let step = DrivenStep {
            slot: k,
            steps: self.state.counters.steps,
            action,
            taught: slot.taught,
            reward,
            next: &slot.observation,
            is_terminal: outcome.terminated,
            is_over,
        };
        self.state.learner.learn(&step).map_err(|error| Stop::Broken(error.to_string()))?;
        Ok(is_over)
    }

    /// Ends an episode that met a defect. The learner sees it cut off where it was, and its drive is dropped.
    fn give_up(
        &mut self,
        k: usize,
        slot: &mut RunningEpisode,
        action: [f32; 2],
        defect: &Defect,
    ) -> Result<(), Stop> {
        let scene = slot.record.scene;
        self.skip(scene, slot.record.number, &self.setting.scenes[scene].error(defect.to_string()));
        slot.motions.clear();
        let step = DrivenStep {
            slot: k,
            steps: self.state.counters.steps,
            action,
            taught: None,
            reward: 0.0,
            next: &slot.observation,
            is_terminal: false,
            is_over: true,
        };
        self.state.learner.learn(&step).map_err(|error| Stop::Broken(error.to_string()))
    }

    /// Counts success or failure of an episode for curriculum and sampler.
    fn count_success(&mut self, slot: &RunningEpisode, completion: f64) {
        let record = &slot.record;
        let scene = &self.setting.scenes[record.scene];
        let counted = success(scene, slot.plan.as_deref(), &slot.motions, slot.touched_adversary, completion);
        match counted {
            Some(success) => {
                self.state.success.count(record.attack.as_ref().map(|attack| attack.lambda), success)
            }
            None => self.state.counters.unavoidable += 1,
        }
        self.state.records[record.scene].count(record.number, counted);
    }

    /// Evaluates at the fixed steps.
    fn evaluate_if_due(&mut self) {
        let (steps, total) = (self.state.counters.steps, self.options.steps());
        let done = self.state.evaluations.len() as u64;
        let is_due = self.state.learner.may_be_saved();
        if !is_due
            || done >= self.options.evaluations
            || steps < total * (done + 1) / self.options.evaluations
        {
            return;
        }
        let [loss, value] = self.state.learner.take_losses();
        self.state.loss_curve.push([steps as f64, loss, value]);
        let actor = self.state.learner.actor();
        let policy = self.options.policy(actor.clone());
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

    fn not_a_number(&self, slot: &RunningEpisode, what: &str) -> Stop {
        self.broken(slot.record.scene, &format!("{what} is not a number"))
    }

    fn broken(&self, scene: usize, problem: &str) -> Stop {
        Stop::Broken(format!(
            "scene `{}`, step {} of the training: {problem}",
            self.setting.scenes[scene].scene().id,
            self.state.counters.steps
        ))
    }
}
