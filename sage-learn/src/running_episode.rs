//! An episode of a training in progress, and what a checkpoint keeps of it: how it began, and the actions since.
//!
//! A teacher is asked in the learner's own states. It drives nothing, so imitation meets the states that the learner gets into
//! (Ross et al. 2011, arXiv 1011.0686), and costs one decision of the teacher a step. It gives actions only; whether they were
//! good, PPO finds out.

use std::sync::Arc;

use sage_core::{generator::OperatingPoint, motion::Trajectory};
use sage_sim::{
    Error, SimScene,
    attacker::Attacker,
    drive::{Drive, InformedDriver},
    environment::{Environment, EnvironmentOptions, Outcome},
    evaluation::SHORTEST_DRIVE,
    observation::{LENGTH, mirror},
    policy::EgoPolicy,
    traffic::Plan,
    vehicle::{Action, Motion},
    world::Control,
};
use serde::{Deserialize, Serialize};

/// How the adversary of an episode attacks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Attack {
    /// Intensity λ.
    pub(super) lambda: f64,
    /// Seed of the generator.
    pub(super) seed: u64,
    /// The drive that it is planned against; none for the recording.
    pub(super) drive: Option<Vec<Motion>>,
    /// Step of the training at which that drive was stored.
    pub(super) driven_at: Option<u64>,
    /// The plan, if a search with the policy of that moment found it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) found: Option<Trajectory>,
}

impl Attack {
    /// Its operating point: μ = λ.
    pub(super) fn point(&self) -> OperatingPoint {
        OperatingPoint::at(self.lambda, self.lambda)
    }

    /// Whether its numbers are in range.
    pub(super) fn is_sound(&self) -> bool {
        let is_long = |drive: &Vec<Motion>| drive.len() > SHORTEST_DRIVE;
        (0.0..=1.0).contains(&self.lambda)
            && self.drive.iter().all(is_long)
            && self.drive.iter().flatten().all(Motion::is_finite)
    }

    /// The plan of the adversary.
    ///
    /// *Errors*: as [`Attacker::plan`].
    pub(super) fn plan(&self, scene: &SimScene, attacker: &dyn Attacker) -> Result<Arc<Plan>, Error> {
        if let Some(found) = &self.found {
            return Ok(Arc::new(Plan::of_adversary(scene.scene(), found)?));
        }
        let drive = self.drive.clone().map(Drive::of_motions);
        attacker.plan(scene, drive.as_ref(), &self.point(), self.seed)
    }
}

/// How an episode begins, and what was done in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EpisodeRecord {
    pub(super) scene: usize,
    /// Number of the episode.
    pub(super) number: u64,
    /// Seed of the world.
    pub(super) world: u64,
    /// Whether the car drives the mirror image of the scene.
    pub(super) is_mirrored: bool,
    /// Steps after which it is cut off, besides the rules.
    pub(super) limit: Option<usize>,
    pub(super) attack: Option<Attack>,
    /// Actions of the driver so far.
    pub(super) actions: Vec<[f32; 2]>,
}

impl EpisodeRecord {
    /// Whether it fits a training.
    pub(super) fn is_sound(&self, scenes: usize, max_steps: usize) -> bool {
        self.scene < scenes
            && self.actions.len() < max_steps
            && self.actions.iter().flatten().all(|x| x.is_finite())
            && self.attack.iter().all(Attack::is_sound)
    }
}

/// What observes an environment.
pub(super) type Observe = fn(&Environment, &mut [f32; LENGTH]);

/// An episode in progress.
pub(super) struct RunningEpisode {
    pub(super) record: EpisodeRecord,
    pub(super) environment: Environment,
    pub(super) plan: Option<Arc<Plan>>,
    pub(super) observation: [f32; LENGTH],
    pub(super) motions: Vec<Motion>,
    /// Step of the first contact with the adversary.
    pub(super) touched_adversary: Option<usize>,
    /// Whether the car has left the road.
    pub(super) left_road: bool,
    /// The teacher in this episode.
    teacher: Option<InformedDriver>,
    /// What the teacher would have done in the last step, in the coordinates of the driver.
    pub(super) taught: Option<[f32; 2]>,
}

impl RunningEpisode {
    /// Begins an episode and drives it as its record says, against the plan of its attack. A teacher watches, if there is one.
    ///
    /// *Errors*: as [`Environment::reset`], [`EgoPolicy::start`] and [`RunningEpisode::step`].
    pub(super) fn of(
        record: EpisodeRecord,
        scene: &Arc<SimScene>,
        plan: Option<Arc<Plan>>,
        teacher: Option<&dyn EgoPolicy>,
        rules: &Arc<EnvironmentOptions>,
        observe: Observe,
    ) -> Result<Self, Error> {
        let environment = Environment::reset(scene.clone(), rules.clone(), plan.clone(), record.world)?;
        let start =
            |policy: &dyn EgoPolicy| InformedDriver::start(policy, scene, scene.scene().ego, record.world);
        let teacher = teacher.map(start).transpose()?;
        let motions = vec![*environment.world().motion()];
        let actions = record.actions.clone();
        let mut running = Self {
            record: EpisodeRecord { actions: Vec::with_capacity(actions.len()), ..record },
            environment,
            plan,
            observation: [0.0; LENGTH],
            motions,
            touched_adversary: None,
            left_road: false,
            teacher,
            taught: None,
        };
        for action in actions {
            running.step(action)?;
        }
        running.observe(observe);
        Ok(running)
    }

    /// Brings the observation up to date.
    pub(super) fn observe(&mut self, observe: Observe) {
        observe(&self.environment, &mut self.observation);
        if self.record.is_mirrored {
            mirror(&mut self.observation);
        }
    }

    /// One step with an action of the driver.
    ///
    /// *Errors*: as [`Environment::step`]; the teacher cannot go on.
    pub(super) fn step(&mut self, action: [f32; 2]) -> Result<Outcome, Error> {
        self.ask_teacher()?;
        let [steer, throttle] = self.turned(action).map(f64::from);
        let mut outcome = self.environment.step(Action { steer, throttle })?;
        self.record.actions.push(action);
        self.left_road |= outcome.out_of_road;
        let world = self.environment.world();
        self.motions.push(*world.motion());
        let adversary = self.plan.as_ref().map(|plan| plan.track);
        let touches = || world.events().contacts.iter().any(|contact| Some(contact.track) == adversary);
        if self.touched_adversary.is_none() && touches() {
            self.touched_adversary = Some(world.step_count());
        }
        let is_cut = self.record.limit.is_some_and(|limit| world.step_count() >= limit);
        outcome.truncated |= is_cut && !outcome.terminated;
        Ok(outcome)
    }

    /// An action of the driver in the coordinates of the scene, or the other way round.
    fn turned(&self, [steer, throttle]: [f32; 2]) -> [f32; 2] {
        [if self.record.is_mirrored { -steer } else { steer }, throttle]
    }

    /// Learns what the teacher would do now.
    fn ask_teacher(&mut self) -> Result<(), Error> {
        let Some(teacher) = &mut self.teacher else { return Ok(()) };
        let world = self.environment.world();
        // A teacher decides by the scene: the observation is that of the learner.
        let action = match teacher.control_ego(world, None)? {
            Control::Drive(action) if action.steer.is_finite() && action.throttle.is_finite() => {
                action.limited()
            }
            control => {
                let problem = match control {
                    Control::Pose { .. } | Control::Follow { .. } => {
                        "the teacher sets poses; name one that steers and accelerates"
                    }
                    Control::Drive(_) => "the action of the teacher is not a number",
                };
                let scene = world.scene().scene().id.clone();
                return Err(Error::Policy { scene, problem: problem.to_owned() });
            }
        };
        self.taught = Some(self.turned([action.steer as f32, action.throttle as f32]));
        Ok(())
    }

    /// Lets the teacher go.
    pub(super) fn dismiss_teacher(&mut self) {
        (self.teacher, self.taught) = (None, None);
    }

    /// Whether its limit cut it off, not the rules.
    pub(super) fn is_cut_off(&self) -> bool {
        !self.environment.is_over() && self.is_over()
    }

    /// Whether it is over, by the rules or by its limit.
    pub(super) fn is_over(&self) -> bool {
        let limit = self.record.limit;
        self.environment.is_over()
            || limit.is_some_and(|limit| self.environment.world().step_count() >= limit)
    }
}
