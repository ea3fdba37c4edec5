//! What the learner remembers: decisions with what was seen before and after, each with copies in hindsight.

use std::{borrow::Cow, collections::VecDeque, sync::Arc};

use sage_baselines::goose::{
    DESIRED, Goal, HINDSIGHT, HINDSIGHT_GOALS, Outcome, Trial, mirrored_action, mirrored_rest, mirrored_rows,
    networks::{ACTION, Features, HIDDEN, REST, STATE},
    outcome_in_hindsight,
};
use sage_core::seed::Rng;
use sage_learn::TransitionBatch;

use super::options::TrainingOptions;

/// What a policy sees of a trial, for any goal.
pub(super) struct Moment {
    pub(super) rows: Vec<Features>,
    /// The rest of the state, with the goal of attacks.
    pub(super) rest: [f32; REST],
}

impl Moment {
    pub(super) fn of(trial: &Trial) -> Arc<Self> {
        Arc::new(Self { rows: trial.rows.clone(), rest: trial.rest(&DESIRED) })
    }

    fn rows(&self, is_mirrored: bool) -> Cow<'_, [Features]> {
        if is_mirrored { mirrored_rows(&self.rows).into() } else { Cow::Borrowed(&self.rows) }
    }

    /// The state, from the encoded rows.
    pub(super) fn state(&self, encoded: &[f32]) -> [f32; STATE] {
        let mut state = [0.0; STATE];
        state[..HIDDEN].copy_from_slice(encoded);
        state[HIDDEN..].copy_from_slice(&self.rest);
        state
    }
}

/// One decision with a goal.
struct Copy {
    /// The goal, as a state holds it.
    goal: [f32; 3],
    outcome: Outcome,
}

/// One decision.
struct Step {
    before: Arc<Moment>,
    after: Arc<Moment>,
    action: [f64; ACTION],
    /// With the goal of attacks, and with goals in hindsight.
    copies: Vec<Copy>,
}

/// The newest decisions.
pub(super) struct Memory {
    steps: VecDeque<Step>,
    capacity: usize,
    shares_curve: bool,
    mirrors: bool,
}

/// A batch of transitions, whose observations are still to be encoded.
pub(super) struct Drawn<'m> {
    pub(super) before: Vec<Cow<'m, [Features]>>,
    pub(super) after: Vec<Cow<'m, [Features]>>,
}

impl Memory {
    /// A memory as the options say.
    pub(super) fn new(options: &TrainingOptions) -> Self {
        let TrainingOptions { buffer, shared_curve, mirror, .. } = *options;
        let capacity = buffer / (1 + HINDSIGHT);
        Self { steps: VecDeque::new(), capacity, shares_curve: shared_curve, mirrors: mirror }
    }

    /// Adds a decision, and copies of it with goals that are drawn without replacement.
    pub(super) fn add(
        &mut self,
        moments: [Arc<Moment>; 2],
        action: [f64; ACTION],
        after: &Trial,
        goals: &mut Rng,
    ) {
        let copy = |goal: &Goal, outcome: Outcome| {
            let rest = after.rest(goal);
            Copy { goal: [REST - 3, REST - 2, REST - 1].map(|k| rest[k]), outcome }
        };
        let mut left = HINDSIGHT_GOALS.to_vec();
        let mut copies = vec![copy(&DESIRED, after.outcome)];
        for _ in 0..HINDSIGHT {
            let goal = left.swap_remove(goals.below(left.len()));
            copies.push(copy(&goal, outcome_in_hindsight(&after.achieved, &goal)));
        }
        let [before, after] = moments;
        self.steps.push_back(Step { before, after, action, copies });
        if self.steps.len() > self.capacity {
            self.steps.pop_front();
        }
    }

    /// Whether there is something to draw.
    pub(super) fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Draws transitions uniformly with replacement into a batch: everything but the encoded drives, which are the first numbers
    /// of observations.
    pub(super) fn draw(&self, rng: &mut Rng, batch: &mut TransitionBatch<f32>) -> Drawn<'_> {
        let mut drawn = Drawn { before: Vec::new(), after: Vec::new() };
        for k in 0..batch.rewards.len() {
            let step = &self.steps[rng.below(self.steps.len())];
            let copy = &step.copies[rng.below(step.copies.len())];
            let is_mirrored = self.mirrors && rng.below(2) == 1;
            drawn.before.push(step.before.rows(is_mirrored));
            drawn.after.push(step.after.rows(is_mirrored));
            let rest = if self.shares_curve { &step.after.rest } else { &step.before.rest };
            for (to, rest) in
                [(&mut batch.observations, rest), (&mut batch.next_observations, &step.after.rest)]
            {
                let to = &mut to[k * STATE + HIDDEN..(k + 1) * STATE];
                let rest = if is_mirrored { mirrored_rest(rest) } else { *rest };
                to.copy_from_slice(&rest);
                to[REST - 3..].copy_from_slice(&copy.goal);
            }
            let action = if is_mirrored { mirrored_action(&step.action) } else { step.action };
            batch.actions[k * ACTION..(k + 1) * ACTION].copy_from_slice(&action.map(|x| x as f32));
            batch.rewards[k] = copy.outcome.reward as f32;
            batch.not_terminal[k] = if copy.outcome.is_done { 0.0 } else { 1.0 };
        }
        drawn
    }
}
