//! One environment of a batch: its episode, and what it remembers from one to the next.

use std::{collections::HashMap, sync::Arc};

use sage_core::seed::Rng;

use super::{AutoReset, Experience, Last, Note, Reset, Row, SceneOrder, Setting, experience::Lesson};
use crate::{
    Error,
    environment::{BACKWARDS, Environment, Outcome},
    observation::LENGTH,
    success::success,
    traffic::Plan,
    vehicle::{Action, Motion},
};

/// Scenes in a row that cannot be used, after which no further one is tried.
const MOST_FAILURES: usize = 100;
/// Notes that wait to be taken at most.
const MOST_NOTES: usize = 100;

/// An episode.
struct Episode {
    environment: Environment,
    scene: usize,
    plan: Option<Arc<Plan>>,
    intensity: Option<f64>,
    motions: Vec<Motion>,
    /// Step of the first contact with the adversary.
    touched: Option<usize>,
    episode_return: f64,
    outcome: Outcome,
}

/// One environment.
pub(super) struct Slot {
    number: usize,
    /// Steps of this environment in the whole training, or of all that share the adversary's experience.
    training_steps: f64,
    seed: u64,
    /// Episodes begun since it was seeded.
    episodes: u64,
    /// Place in the sequence of scenes.
    place: u64,
    episode: Option<Episode>,
    /// Whether the last episode in each scene has arrived, and its completion.
    results: HashMap<usize, (bool, f64)>,
    arrivals: usize,
    completions: f64,
    /// What the adversary knows of this environment alone.
    experience: Experience,
    /// What the episode that ended in this step teaches.
    lesson: Option<Lesson>,
    /// How the episode ended that this step replaced.
    pub(super) last: Option<Last>,
    pub(super) notes: Vec<Note>,
    /// Whether this step begins an episode, and whether it drove.
    begins: bool,
    drove: bool,
    /// What it is to do.
    pub(super) reset: Option<Reset>,
    pub(super) actions: Vec<[f32; 2]>,
    /// What came of it.
    pub(super) written: Written,
}

/// Observations and rows, one for each step.
#[derive(Default)]
pub(super) struct Written {
    pub(super) observations: Vec<f32>,
    pub(super) rows: Vec<(Row, Option<Last>)>,
}

impl Slot {
    pub(super) fn new(number: usize, training_steps: f64) -> Self {
        Self {
            number,
            training_steps,
            seed: 0,
            episodes: 0,
            place: 0,
            episode: None,
            results: HashMap::new(),
            arrivals: 0,
            completions: 0.0,
            experience: Experience::default(),
            lesson: None,
            last: None,
            notes: Vec::new(),
            begins: false,
            drove: false,
            reset: None,
            actions: Vec::new(),
            written: Written::default(),
        }
    }

    pub(super) fn environment(&self) -> Option<&Environment> {
        self.episode.as_ref().map(|episode| &episode.environment)
    }

    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// Whether it must be reset before its next step.
    pub(super) fn needs_reset(&self) -> bool {
        self.environment().is_none_or(Environment::is_over)
    }

    /// Gives it what it is to do.
    pub(super) fn give(&mut self, reset: Option<Reset>, actions: &[[f32; 2]]) {
        self.reset = reset;
        self.actions.clear();
        self.actions.extend_from_slice(actions);
        // Of work that failed something may be left.
        self.written.observations.clear();
        self.written.rows.clear();
    }

    /// Writes observation and row after what was done.
    pub(super) fn write(&mut self) {
        let mut observation = [0.0; LENGTH];
        self.observe(&mut observation);
        self.written.observations.extend_from_slice(&observation);
        let row = self.row();
        self.written.rows.push((row, self.last.take()));
    }

    /// Lets the adversary learn from the last step: the one of all environments, or that of this one alone.
    pub(super) fn teach(&mut self, shared: Option<&mut Experience>) {
        let experience = shared.unwrap_or(&mut self.experience);
        if self.drove {
            experience.count_step();
        }
        if let Some(lesson) = self.lesson.take() {
            experience.learn(lesson);
        }
    }

    /// Begins an episode as a user asks for it.
    ///
    /// *Errors*: as [`Slot::begin`].
    pub(super) fn begin_anew(
        &mut self,
        reset: &Reset,
        setting: &Setting,
        experience: Option<&Experience>,
    ) -> Result<(), Error> {
        if let Some(seed) = reset.seed {
            // Nothing of what was before matters.
            *self = Self { seed, ..Self::new(self.number, self.training_steps) };
        }
        self.begin(setting, experience, reset.scene)
    }

    /// Steps, unless the step is the one that begins the next episode.
    ///
    /// *Errors*: as [`Environment::step`].
    pub(super) fn drive(
        &mut self,
        action: [f32; 2],
        setting: &Setting,
        auto: AutoReset,
    ) -> Result<(), Error> {
        self.begins = auto == AutoReset::NextStep && self.needs_reset();
        self.last = None;
        self.drove = !self.begins;
        if self.begins {
            return Ok(());
        }
        let Some(episode) = &mut self.episode else { return Err(never_reset(self.number)) };
        let [steer, throttle] = action.map(f64::from);
        let outcome = episode.environment.step(Action { steer, throttle })?;
        episode.count(outcome, setting);
        let result = (outcome.arrived, outcome.completion);
        let (arrived, completion) = self.results.insert(episode.scene, result).unwrap_or_default();
        self.arrivals = self.arrivals + usize::from(result.0) - usize::from(arrived);
        self.completions += result.1 - completion;
        if episode.environment.is_over() {
            self.lesson = setting.adversary.as_ref().map(|adversary| {
                let counts = adversary.curriculum.uses_success();
                episode.lesson(if counts { episode.success() } else { None })
            });
            self.begins = auto == AutoReset::SameStep;
        }
        Ok(())
    }

    /// Begins the next episode if this step is to; then the end of the one before is in `last`.
    ///
    /// *Errors*: as [`Slot::begin`].
    pub(super) fn turn(
        &mut self,
        setting: &Setting,
        experience: Option<&Experience>,
        auto: AutoReset,
    ) -> Result<(), Error> {
        if !self.begins {
            return Ok(());
        }
        self.begins = false;
        if auto == AutoReset::SameStep {
            let mut observation = Box::new([0.0; LENGTH]);
            self.observe(&mut observation);
            self.last = Some(Last { row: self.row(), observation });
        }
        self.begin(setting, experience, None)
    }

    /// Begins an episode in a given scene, or in the next one that can be used. `experience` is what the adversary shares, in place of
    /// that of this environment.
    ///
    /// *Errors*: the scene cannot be used; a hundred scenes in a row cannot.
    fn begin(
        &mut self,
        setting: &Setting,
        experience: Option<&Experience>,
        wanted: Option<usize>,
    ) -> Result<(), Error> {
        let number = self.episodes;
        self.episodes += 1;
        let mut rng = Rng::new(self.seed, &number.to_string(), "episodes");
        let count = setting.scenes.count();
        let tries = if wanted.is_some() { 1 } else { MOST_FAILURES };
        let mut failed = None;
        for _ in 0..tries {
            let drawn = rng.below(count);
            let world = rng.bits();
            let scene = wanted.unwrap_or_else(|| match setting.order {
                SceneOrder::Random => drawn,
                SceneOrder::Sequential { first, workers } => {
                    self.place += 1;
                    let first = (first + self.number) % count;
                    let turns = (count - first).div_ceil(workers) as u64;
                    first + workers * ((self.place - 1) % turns) as usize
                }
            });
            match self.begin_in(setting, experience, scene, number, world) {
                Ok(episode) => {
                    self.results.entry(scene).or_default();
                    self.episode = Some(episode);
                    return Ok(());
                }
                Err(error) => {
                    self.note(scene, error.to_string());
                    failed = Some(error);
                }
            }
        }
        Err(failed.unwrap_or_else(|| never_reset(self.number)))
    }

    fn begin_in(
        &mut self,
        setting: &Setting,
        experience: Option<&Experience>,
        scene: usize,
        episode: u64,
        world: u64,
    ) -> Result<Episode, Error> {
        let sim = setting.scenes.scene(scene)?;
        let (mut plan, mut intensity) = (None, None);
        if let Some(adversary) = &setting.adversary {
            // A seed of its own, so that worlds are the same with and without an adversary.
            let mut rng = Rng::new(self.seed, &episode.to_string(), "adversary");
            let experience = experience.unwrap_or(&self.experience);
            let progress = experience.progress(self.training_steps);
            if let Some(lambda) = adversary.curriculum.draw(&progress, &mut rng) {
                match adversary.plan(scene, &sim, experience, lambda, rng.bits()) {
                    Ok(planned) => (plan, intensity) = (Some(planned), Some(lambda)),
                    Err(error) => self.note(scene, format!("{error}; the episode has no attack")),
                }
            }
        }
        let environment = Environment::reset(sim, setting.rules.clone(), plan.clone(), world)?;
        let motions = vec![*environment.world().motion()];
        let completion = environment.coordinates().along / environment.world().scene().route().length();
        let outcome = Outcome { completion, ..Outcome::default() };
        Ok(Episode {
            environment,
            scene,
            plan,
            intensity,
            motions,
            touched: None,
            episode_return: 0.0,
            outcome,
        })
    }

    fn note(&mut self, scene: usize, problem: String) {
        if self.notes.len() < MOST_NOTES {
            self.notes.push(Note { scene, problem });
        }
    }

    /// Writes the observation; zeros before the first reset.
    fn observe(&self, out: &mut [f32; LENGTH]) {
        match self.environment() {
            Some(environment) => environment.observe(out),
            None => *out = [0.0; LENGTH],
        }
    }

    /// What is known after the last step or reset.
    fn row(&self) -> Row {
        let Some(episode) = &self.episode else { return Row::default() };
        let environment = &episode.environment;
        let world = environment.world();
        let (events, scene) = (world.events(), world.scene());
        let outcome = episode.outcome;
        let is_failed = outcome.terminated && !outcome.arrived && !outcome.out_of_road;
        Row {
            outcome,
            progress_reward: environment.options().rewards.progress * outcome.progress,
            drove_backwards: is_failed && outcome.completion < BACKWARDS,
            scene: episode.scene,
            steps: world.step_count(),
            episode_return: episode.episode_return,
            is_at_limit: environment.is_at_limit(),
            on_edge: events.on_edge,
            on_line: events.on_yellow || events.on_white,
            across: environment.coordinates().across,
            route_length: scene.route().length(),
            size: world.size(),
            intensity: episode.intensity,
            scenes_begun: self.results.len(),
            arrivals: self.arrivals,
            completions: self.completions,
        }
    }
}

impl Episode {
    fn count(&mut self, outcome: Outcome, setting: &Setting) {
        self.outcome = outcome;
        self.episode_return += outcome.reward;
        if setting.adversary.is_none() {
            return;
        }
        let world = self.environment.world();
        // What is driven after the recording is of no use for an attack.
        if self.motions.len() < world.scene().scene().frames {
            self.motions.push(*world.motion());
        }
        let adversary = self.plan.as_ref().map(|plan| plan.track);
        let touches = || world.events().contacts.iter().any(|contact| Some(contact.track) == adversary);
        if self.touched.is_none() && touches() {
            self.touched = Some(world.step_count());
        }
    }

    fn success(&self) -> Option<bool> {
        let scene = self.environment.world().scene();
        success(scene, self.plan.as_deref(), &self.motions, self.touched, self.outcome.completion)
    }

    fn lesson(&mut self, success: Option<bool>) -> Lesson {
        let motions = std::mem::take(&mut self.motions);
        Lesson { scene: self.scene, motions, intensity: self.intensity, success }
    }
}

/// The error of a step before the first reset.
pub(super) fn never_reset(number: usize) -> Error {
    Error::Batch { problem: format!("environment {number} was never reset; reset it before its first step") }
}
