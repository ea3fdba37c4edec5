//! Terms of the experts' objectives, measured for every goal of a scene.

use sage_core::{
    objective::{
        Candidate, Context, Feasibility, Objective, ObjectiveSpec, PartSpec, Reward, Situation, Weight,
        is_believable,
    },
    registry::Registry,
};
use serde::{Deserialize, Serialize};

use crate::Error;

/// Terms that are measured for every goal: those of the experts' objectives, and R_adv and P_real for tables.
pub struct Measures {
    union: Objective,
    /// Indices of R_adv and P_real among its terms.
    reported: [usize; 2],
}

impl Measures {
    /// Measures of some objectives, which must share their feasibility rule. Without objectives, they are
    /// R_adv and P_real under the paper's rule.
    ///
    /// *Errors*: [`Error::Core`] for objectives of two rules.
    pub fn of(
        objectives: &[&Objective],
        rewards: &Registry<dyn Reward>,
        rules: &Registry<dyn Feasibility>,
    ) -> Result<Self, Error> {
        let rule = objectives.first().map_or_else(PartSpec::default, |o| o.spec().feasibility.clone());
        let spec =
            ObjectiveSpec::preset("paper-selection").map(|spec| ObjectiveSpec { feasibility: rule, ..spec });
        let missing = || Error::Mismatch("the paper's objective is missing".to_owned());
        let reported = Objective::new(&spec.ok_or_else(missing)?, rewards, rules)?;
        let all: Vec<&Objective> = objectives.iter().copied().chain([&reported]).collect();
        let union = Objective::union(&all)?.ok_or_else(missing)?;
        let Some(Ok(reported)) = reported.term_indices_in(&union).map(<[usize; 2]>::try_from) else {
            return Err(missing());
        };
        Ok(Self { union, reported })
    }

    /// Refuses an objective that depends on μ, because an expert has no μ.
    ///
    /// *Errors*: [`Error::Option`] for a weight that depends on μ.
    pub fn check(objective: &Objective) -> Result<(), Error> {
        let by_mu = objective.spec().terms.iter().find(|term| matches!(term.weight, Weight::Linear { .. }));
        match by_mu {
            Some(term) => Err(Error::Option(format!(
                "the weight of term `{}` depends on mu; an expert's weights are plain numbers",
                term.name
            ))),
            None => Ok(()),
        }
    }

    /// An expert's objective over the measured terms.
    ///
    /// *Errors*: [`Error::Mismatch`] for an objective that was not among the measured ones, or that
    /// [`Measures::check`] refuses.
    pub fn expert<'o>(&self, objective: &'o Objective) -> Result<ExpertObjective<'o>, Error> {
        Self::check(objective)?;
        let terms = objective.term_indices_in(&self.union);
        let terms = terms.ok_or_else(|| {
            Error::Mismatch("the goals were measured for other objectives than the expert's".to_owned())
        })?;
        Ok(ExpertObjective { objective, terms })
    }
}

/// An expert's objective over the measured terms.
pub struct ExpertObjective<'o> {
    objective: &'o Objective,
    /// Indices of its terms among the measured ones.
    terms: Vec<usize>,
}

/// Measured values of every goal of a scene.
#[derive(Default)]
pub struct GoalTable {
    /// Values of all terms, goal by goal.
    terms: Vec<Vec<Option<f64>>>,
    /// R_adv and P_real.
    reported: Vec<[f64; 2]>,
    /// Cost of the violated rules.
    cost: Vec<f64>,
    /// Whether no rule is violated.
    feasible: Vec<bool>,
    /// Whether the trajectory hits the ego.
    hits: Vec<bool>,
    /// Whether it is a believable attack.
    believable: Vec<bool>,
}

impl GoalTable {
    /// Adds the next goal's candidate.
    pub(super) fn push(&mut self, candidate: &Candidate, ctx: &Context, measures: &Measures) {
        let evaluation = measures.union.evaluate(candidate, ctx);
        let reported = measures.reported.map(|term| evaluation.terms[term].unwrap_or(0.0));
        self.reported.push(reported);
        self.cost.push(evaluation.cost());
        self.feasible.push(evaluation.is_feasible());
        self.hits.push(evaluation.contact.is_some());
        let is_believable =
            evaluation.contact.is_some() && is_believable(&Situation::new(candidate, ctx.ego(), ctx));
        self.believable.push(is_believable);
        self.terms.push(evaluation.terms);
    }

    /// Whether a goal's trajectory violates no rule.
    pub fn is_feasible(&self, goal: usize) -> bool {
        self.feasible[goal]
    }

    /// Adversarial reward of a goal's trajectory.
    pub fn reward(&self, goal: usize) -> f64 {
        self.reported[goal][0]
    }

    /// Value of a goal under an expert's objective.
    pub(super) fn value(&self, goal: usize, expert: &ExpertObjective) -> f64 {
        let terms: Vec<Option<f64>> = expert.terms.iter().map(|term| self.terms[goal][*term]).collect();
        expert.objective.value_of(&terms, self.cost[goal], 0.0)
    }

    /// Expectations under a policy, from the log-probabilities of the policy and of the prior.
    pub(super) fn expectation(&self, log_probs: &[f64], reference: &[f64]) -> Expectation {
        let mut sum = Expectation::default();
        for (goal, log_prob) in log_probs.iter().enumerate() {
            let p = log_prob.exp();
            let [reward, penalty] = self.reported[goal];
            sum.feasible += p * f64::from(u8::from(self.feasible[goal]));
            sum.attack += p * f64::from(u8::from(self.feasible[goal] && self.hits[goal]));
            sum.believable += p * f64::from(u8::from(self.believable[goal]));
            sum.reward += p * reward;
            sum.penalty += p * penalty;
            sum.kl += p * (log_prob - reference[goal]);
        }
        sum
    }
}

impl GoalTable {
    /// Mean value of an objective under a policy, from its log-probabilities.
    pub(super) fn expected_value(&self, log_probs: &[f64], expert: &ExpertObjective) -> f64 {
        let terms = log_probs.iter().enumerate();
        terms.map(|(goal, log_prob)| log_prob.exp() * self.value(goal, expert)).sum()
    }
}

/// Expectations under a policy over the goals of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Expectation {
    /// Probability of a feasible trajectory.
    pub feasible: f64,
    /// Probability of a feasible trajectory that hits the ego.
    pub attack: f64,
    /// Probability of a believable attack.
    pub believable: f64,
    /// Mean adversarial reward (R_adv).
    pub reward: f64,
    /// Mean realism penalty (P_real).
    pub penalty: f64,
    /// Divergence from the prior, nats.
    pub kl: f64,
}

impl Expectation {
    /// Mean over scenes; `None` without scenes.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let n = all.len() as f64;
        let mean = |value: fn(&Self) -> f64| all.iter().map(value).sum::<f64>() / n;
        (!all.is_empty()).then(|| Self {
            feasible: mean(|e| e.feasible),
            attack: mean(|e| e.attack),
            believable: mean(|e| e.believable),
            reward: mean(|e| e.reward),
            penalty: mean(|e| e.penalty),
            kl: mean(|e| e.kl),
        })
    }
}
