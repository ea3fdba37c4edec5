//! Many environments at once, over flat slices: one call a step.
//!
//! Environment *k* of a batch of seed *s* does what a batch of one environment of seed *s + k* does, bit for bit, at any number of
//! threads, unless the environments share what the adversary knows ([`BatchOptions::share_experience`]).

mod experience;
mod recent;
mod setting;
mod slot;

use rayon::prelude::*;

use self::{experience::Experience, slot::Slot};
use crate::{Error, environment::Environment, observation::LENGTH};

pub use recent::Recent;
pub use setting::{Adversary, SceneOrder, SceneSource, Setting};
pub use slot::{Last, Note, Row};

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
    fn resize(&mut self, rows: usize) {
        self.observations.resize(rows * LENGTH, 0.0);
        self.rewards.resize(rows, 0.0);
        self.terminated.resize(rows, false);
        self.truncated.resize(rows, false);
        self.rows.resize(rows, Row::default());
        self.last.clear();
    }

    fn write(&mut self, rows: impl Iterator<Item = (Row, Option<Last>)>) {
        let count = self.rows.len();
        for (k, (row, last)) in rows.enumerate() {
            let outcome = last.as_ref().map_or(row.outcome, |last| last.row.outcome);
            self.rewards[k] = outcome.reward;
            self.terminated[k] = outcome.terminated;
            self.truncated[k] = outcome.truncated;
            self.rows[k] = row;
            if let Some(last) = last {
                self.last.resize_with(count, || None);
                self.last[k] = Some(last);
            }
        }
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
        let mut wanted: Vec<Option<Reset>> = vec![None; count];
        for reset in resets {
            wanted[reset.number] = Some(*reset);
        }
        if let Some(shared) = &mut self.shared
            && wanted.iter().all(|reset| reset.is_some_and(|reset| reset.seed.is_some()))
        {
            *shared = Experience::default();
        }
        out.resize(count);
        let Self { setting, options, slots, shared } = self;
        let items = slots.iter_mut().zip(wanted).zip(out.observations.as_chunks_mut::<LENGTH>().0);
        let rows = each(options.parallel, items, |((slot, reset), observation)| {
            slot.last = None;
            if let Some(Reset { seed, scene, .. }) = reset {
                if let Some(seed) = seed {
                    slot.seed(seed);
                }
                slot.begin(setting, shared.as_ref(), scene)?;
            }
            slot.observe(observation);
            Ok((slot.row(), None))
        })?;
        out.write(rows.into_iter());
        Ok(())
    }

    /// Steps every environment: one (steering, throttle) each.
    ///
    /// *Errors*: before any step [`Error::Batch`] for another number of actions, an action that is not finite, and an
    /// environment that must be reset; the first environment that fails, as [`Environment::step`]; no further scene can be used.
    pub fn step(&mut self, actions: &[[f32; 2]], out: &mut BatchOutput) -> Result<(), Error> {
        self.check(actions, 1)?;
        out.resize(self.len());
        let Self { setting, options, slots, shared } = self;
        let auto = options.auto_reset;
        let Some(shared) = shared else {
            let items = slots.iter_mut().zip(actions).zip(out.observations.as_chunks_mut::<LENGTH>().0);
            let rows = each(options.parallel, items, |((slot, action), observation)| {
                slot.step_alone(setting, *action, auto, observation)
            })?;
            out.write(rows.into_iter());
            return Ok(());
        };
        // What is shared changes between the steps of all and the beginnings of all, in the order of the environments.
        let drove = each(options.parallel, slots.iter_mut().zip(actions), |(slot, action)| {
            slot.drive(setting, *action, auto)
        })?;
        for (slot, drove) in slots.iter_mut().zip(drove) {
            if drove {
                shared.count_step();
            }
            if let Some(lesson) = slot.lesson.take() {
                shared.learn(lesson);
            }
        }
        let items = slots.iter_mut().zip(out.observations.as_chunks_mut::<LENGTH>().0);
        let rows = each(options.parallel, items, |(slot, observation)| {
            slot.turn(setting, Some(shared), auto)?;
            slot.observe(observation);
            Ok((slot.row(), slot.last.take()))
        })?;
        out.write(rows.into_iter());
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
        self.check(actions, steps)?;
        out.resize(actions.len());
        let Self { setting, options, slots, .. } = self;
        let auto = options.auto_reset;
        let rows = out.observations.chunks_mut((steps * LENGTH).max(1));
        let items = slots.iter_mut().zip(actions.chunks(steps.max(1))).zip(rows);
        let rows = each(options.parallel, items, |((slot, actions), observations)| {
            let steps = actions.iter().zip(observations.as_chunks_mut::<LENGTH>().0);
            let rows = steps.map(|(action, seen)| slot.step_alone(setting, *action, auto, seen));
            rows.collect::<Result<Vec<_>, Error>>()
        })?;
        out.write(rows.into_iter().flatten());
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

/// Works on each item, in the caller's thread pool or one after another. The results are in their order.
///
/// *Errors*: the first one, after all items were worked on.
fn each<T: Send, R: Send>(
    parallel: bool,
    items: impl Iterator<Item = T>,
    work: impl Fn(T) -> Result<R, Error> + Sync + Send,
) -> Result<Vec<R>, Error> {
    let results: Vec<Result<R, Error>> = if parallel {
        // Steps differ in cost by a factor of ten; whole halves of the batch would be uneven.
        items.collect::<Vec<_>>().into_par_iter().with_max_len(1).map(work).collect()
    } else {
        items.map(work).collect()
    };
    results.into_iter().collect()
}

fn refused(problem: String) -> Error {
    Error::Batch { problem }
}
