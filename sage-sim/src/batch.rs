//! Many environments at once, over flat slices: one call a step.
//!
//! Environment *k* of a batch of seed *s* does what a batch of one environment of seed *s + k* does, bit for bit, at any number of
//! threads, unless the environments share what the adversary knows ([`BatchOptions::share_experience`]).
//!
//! So a single environment is a batch of one (tested). Scenes come from a source that may read files, since a data set does not
//! fit into memory. What an adversary learns of the driver (drives, success) is either of one environment or of all. If it is
//! of all, it changes between the steps of all and the beginnings of episodes, in the order of the environments, so results do
//! not depend on threads.

mod experience;
mod recent;
mod row;
mod setting;
mod slot;

use rayon::prelude::*;

use self::{experience::Experience, slot::Slot};
use crate::{Error, environment::Environment};

pub use recent::Recent;
pub use row::{Last, Note, Row};
pub use setting::{Adversary, SceneOrder, SceneSource, Setting};

/// What happens after the last step of an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AutoReset {
    /// Nothing: a step of an episode that is over is an error.
    #[default]
    Off,
    /// The same step begins the next episode. Its first observation is returned, and the end of the episode before is in
    /// [`BatchOutput::last`].
    SameStep,
    /// The next step begins the next episode, whatever its action.
    NextStep,
}

/// Options of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchOptions {
    /// Number of environments.
    pub count: usize,
    /// What happens after the last step of an episode.
    pub auto_reset: AutoReset,
    /// Whether all environments share what the adversary knows: the newest drive in each scene, rates of success, and progress.
    /// Otherwise each has its own.
    pub share_experience: bool,
    /// Whether the environments step in the caller's thread pool, or one after another.
    pub parallel: bool,
}

/// An environment to reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// Its number.
    pub number: usize,
    /// A seed from which it starts anew, so that nothing of what was before matters; `None` to go on.
    pub seed: Option<u64>,
    /// Number of the scene; `None` for the next one.
    pub scene: Option<usize>,
}

/// Environments that step together.
///
/// Three cars in one [`SimScene`](crate::SimScene), each with its own action:
///
/// ```
/// # use sage_core::scene::SceneIndex;
/// # use sage_data::procedural::{Kind, generate};
/// # use sage_sim::{SimScene, environment::EnvironmentOptions};
/// use std::sync::Arc;
///
/// use sage_sim::batch::{AutoReset, Batch, BatchOptions, BatchOutput, SceneOrder, Setting};
///
/// # let scene = Arc::new(generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?);
/// # let scene = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let setting = Setting {
///     scenes: Arc::new(vec![scene]),
///     order: SceneOrder::Random,
///     rules: Arc::new(EnvironmentOptions::training()),
///     adversary: None,
/// };
/// let auto_reset = AutoReset::Off;
/// let options = BatchOptions { count: 3, auto_reset, share_experience: false, parallel: false };
/// let (mut batch, mut out) = (Batch::new(setting, options)?, BatchOutput::default());
///
/// // One call a step for all; 101 numbers are observed in each environment.
/// batch.reset_all(0, &mut out)?;
/// batch.step(&[[0.0, 0.5], [0.0, 0.0], [0.0, -1.0]], &mut out)?;
/// assert_eq!((out.observations.len(), out.rewards.len()), (3 * 101, 3));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Batch {
    setting: Setting,
    options: BatchOptions,
    slots: Vec<Slot>,
    shared: Option<Experience>,
}

/// Columns of a step or a reset: one row for each environment. Reuse it, so that its memory is allocated once.
#[derive(Default)]
pub struct BatchOutput {
    /// Observations, n × 101.
    pub observations: Vec<f32>,
    /// Rewards of the steps.
    pub rewards: Vec<f64>,
    /// Terminations.
    pub terminated: Vec<bool>,
    /// Truncations.
    pub truncated: Vec<bool>,
    /// Everything else that is known. An environment that the same step has reset has a row of its new episode.
    pub rows: Vec<Row>,
    /// How the episodes ended that the same step has reset; `None` for the other environments. Empty if there is none.
    pub last: Vec<Option<Last>>,
}

impl BatchOutput {
    fn clear(&mut self) {
        let Self { observations, rewards, terminated, truncated, rows, last } = self;
        observations.clear();
        rewards.clear();
        terminated.clear();
        truncated.clear();
        rows.clear();
        last.clear();
    }
}

impl Batch {
    /// Environments before their first reset.
    ///
    /// *Errors*: [`Error::Batch`] without scenes or environments.
    pub fn new(setting: Setting, options: BatchOptions) -> Result<Self, Error> {
        if setting.scenes.count() == 0 {
            return Err(refused("there are no scenes; give at least one".to_owned()));
        }
        if options.count == 0 {
            return Err(refused("there are 0 environments; expected at least 1".to_owned()));
        }
        let steps = setting.adversary.as_ref().map_or(0, |adversary| adversary.total_steps) as f64;
        let shares = options.share_experience && setting.adversary.is_some();
        let steps = if shares { steps } else { steps / options.count as f64 };
        let slots = (0..options.count).map(|number| Slot::new(number, steps)).collect();
        Ok(Self { setting, options, slots, shared: shares.then(Experience::default) })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Whether there is no environment.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// What the environments share.
    pub fn setting(&self) -> &Setting {
        &self.setting
    }

    /// An environment in its episode; `None` for a number out of range and before its first reset.
    pub fn environment(&self, number: usize) -> Option<&Environment> {
        self.slots.get(number)?.environment()
    }

    /// Numbers of the environments that must be reset before their next step.
    pub fn need_reset(&self) -> Vec<usize> {
        (0..self.len()).filter(|k| self.slots[*k].needs_reset()).collect()
    }

    /// Takes what was noted since it was last called: scenes that could not be used and attacks that could not be planned.
    pub fn take_notes(&mut self) -> Vec<Note> {
        self.slots.iter_mut().flat_map(|slot| std::mem::take(&mut slot.notes)).collect()
    }

    /// Resets all environments, the first one with a seed, the others with the numbers after it.
    ///
    /// *Errors*: as [`Batch::reset`].
    pub fn reset_all(&mut self, seed: u64, out: &mut BatchOutput) -> Result<(), Error> {
        let of = |number| Reset { number, seed: Some(seed.wrapping_add(number as u64)), scene: None };
        self.reset(&(0..self.len()).map(of).collect::<Vec<_>>(), out)
    }

    /// Resets some environments, and writes the rows of all. If all are seeded, what they share is forgotten too.
    ///
    /// *Errors*: [`Error::Batch`] for a number out of range; a scene that cannot be used.
    pub fn reset(&mut self, resets: &[Reset], out: &mut BatchOutput) -> Result<(), Error> {
        let (count, scenes) = (self.len(), self.setting.scenes.count());
        let is_wrong =
            |reset: &&Reset| reset.number >= count || reset.scene.is_some_and(|scene| scene >= scenes);
        if let Some(Reset { number, scene, .. }) = resets.iter().find(is_wrong) {
            let scene = scene.map_or(String::new(), |scene| format!(" in scene {scene}"));
            return Err(refused(format!(
                "environment {number}{scene} cannot be reset; there are {count} environments and {scenes} scenes, numbered from 0"
            )));
        }
        for slot in &mut self.slots {
            slot.give(resets.iter().find(|reset| reset.number == slot.number()).copied(), &[]);
        }
        let is_seeded = |slot: &Slot| slot.reset.is_some_and(|reset| reset.seed.is_some());
        if let Some(shared) = self.shared.as_mut().filter(|_| self.slots.iter().all(is_seeded)) {
            *shared = Experience::default();
        }
        self.each(&|slot, setting, shared| {
            slot.last = None;
            if let Some(reset) = slot.reset.take() {
                slot.begin_anew(&reset, setting, shared)?;
            }
            slot.write();
            Ok(())
        })?;
        self.collect(out);
        Ok(())
    }

    /// Steps every environment: one (steering, throttle) each.
    ///
    /// *Errors*: before any step [`Error::Batch`] for another number of actions, an action that is not finite, and an
    /// environment that must be reset; the first environment that fails, as [`Environment::step`]; no further scene can be used.
    pub fn step(&mut self, actions: &[[f32; 2]], out: &mut BatchOutput) -> Result<(), Error> {
        self.give(actions, 1)?;
        let auto = self.options.auto_reset;
        if self.shared.is_none() {
            return self.step_alone(out);
        }
        // What is shared changes between the steps of all and the beginnings of all, in the order of the environments.
        self.each(&|slot, setting, _| slot.drive(slot.actions[0], setting, auto))?;
        if let Some(shared) = &mut self.shared {
            self.slots.iter_mut().for_each(|slot| slot.teach(Some(shared)));
        }
        self.each(&|slot, setting, shared| {
            slot.turn(setting, shared, auto)?;
            slot.write();
            Ok(())
        })?;
        self.collect(out);
        Ok(())
    }

    /// Steps every environment several times with actions that are known before: `actions` and the rows of `out` are those of
    /// environment 0, then those of environment 1. The results are those of as many calls of [`Batch::step`], but one environment
    /// after another is faster, because its scene stays in the processor's caches.
    ///
    /// *Errors*: as [`Batch::step`]; [`Error::Batch`] if environments share what the adversary knows, or if episodes do not
    /// follow each other by themselves.
    pub fn roll_out(
        &mut self,
        steps: usize,
        actions: &[[f32; 2]],
        out: &mut BatchOutput,
    ) -> Result<(), Error> {
        if self.shared.is_some() || self.options.auto_reset == AutoReset::Off {
            return Err(refused(
                "a roll-out needs an automatic reset, and an adversary that knows each environment alone"
                    .to_owned(),
            ));
        }
        self.give(actions, steps)?;
        self.step_alone(out)
    }

    /// Steps every environment through its actions, without anything shared.
    fn step_alone(&mut self, out: &mut BatchOutput) -> Result<(), Error> {
        let auto = self.options.auto_reset;
        self.each(&|slot, setting, _| {
            for k in 0..slot.actions.len() {
                slot.drive(slot.actions[k], setting, auto)?;
                slot.teach(None);
                slot.turn(setting, None, auto)?;
                slot.write();
            }
            Ok(())
        })?;
        self.collect(out);
        Ok(())
    }

    /// Works on each environment, in the caller's thread pool or one after another.
    ///
    /// *Errors*: the first one, after all environments were worked on.
    fn each(&mut self, work: &Work) -> Result<(), Error> {
        let Self { setting, options, slots, shared } = self;
        let work = |slot: &mut Slot| work(slot, setting, shared.as_ref());
        let results: Vec<Result<(), Error>> = if options.parallel {
            // Steps differ in cost by a factor of ten; whole halves of the batch would be uneven.
            slots.par_iter_mut().with_max_len(1).map(work).collect()
        } else {
            slots.iter_mut().map(work).collect()
        };
        results.into_iter().collect()
    }

    /// Moves what the environments wrote to the output.
    fn collect(&mut self, out: &mut BatchOutput) {
        out.clear();
        let count = self.slots.iter().map(|slot| slot.written.rows.len()).sum();
        for slot in &mut self.slots {
            out.observations.extend_from_slice(&slot.written.observations);
            slot.written.observations.clear();
            for (row, last) in slot.written.rows.drain(..) {
                let outcome = last.as_ref().map_or(row.outcome, |last| last.row.outcome);
                if let Some(last) = last {
                    out.last.resize_with(count, || None);
                    out.last[out.rows.len()] = Some(last);
                }
                out.rewards.push(outcome.reward);
                out.terminated.push(outcome.terminated);
                out.truncated.push(outcome.truncated);
                out.rows.push(row);
            }
        }
    }

    /// Gives the environments their actions, unless something is wrong with one of them.
    fn give(&mut self, actions: &[[f32; 2]], steps: usize) -> Result<(), Error> {
        self.check(actions, steps)?;
        for (slot, actions) in self.slots.iter_mut().zip(actions.chunks(steps.max(1))) {
            slot.give(None, actions);
        }
        Ok(())
    }

    /// Refuses actions before any environment steps.
    fn check(&self, actions: &[[f32; 2]], steps: usize) -> Result<(), Error> {
        let (found, expected) = (actions.len(), self.len() * steps);
        if found != expected {
            return Err(refused(format!(
                "there are {found} actions; expected {expected}, a pair of numbers each"
            )));
        }
        let is_wrong = |action: &[f32; 2]| !action.iter().all(|x| x.is_finite());
        let nan_is_zero = self.setting.rules.nan_is_zero;
        if let Some(k) = actions.iter().position(is_wrong).filter(|_| !nan_is_zero) {
            return Err(refused(format!(
                "the action of environment {} is {:?}; expected finite numbers",
                k / steps,
                actions[k]
            )));
        }
        if let Some(slot) = self.slots.iter().find(|slot| slot.environment().is_none()) {
            return Err(slot::never_reset(slot.number()));
        }
        match &self.need_reset()[..] {
            [first, ..] if self.options.auto_reset == AutoReset::Off => Err(refused(format!(
                "the episode of environment {first} is over; reset it before its next step"
            ))),
            _ => Ok(()),
        }
    }
}

/// Work on an environment, with what it shares with the others.
type Work<'w> = dyn Fn(&mut Slot, &Setting, Option<&Experience>) -> Result<(), Error> + Sync + 'w;

fn refused(problem: String) -> Error {
    Error::Batch { problem }
}
