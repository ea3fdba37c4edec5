//! Refinement of a selection: an evolution strategy over deformations of the best candidates, with the exact objective of the
//! selection.
//!
//! Rounds of fewer and fewer plans with more and more tries, as [`Rounds`] says. A try is kept if the selection takes it rather than
//! the plan before it, and only within the limits of the kinematic penalty and the turning limit. In the end the selection
//! chooses among its first choice and the refined plans, so its value never falls. At μ = 0, where no attack is asked for, nothing is
//! refined. A refined plan has no likelihood, because it is none
//! of the network's modes.

use std::sync::Arc;

use sage_core::{
    deformation::{Deformable, Evolution, LEAST_GAIN},
    generator::Proposal,
    motion::Trajectory,
    objective::{
        Context, Evaluation, Objective, is_within_limits,
        turning::{TURN, tight_turn},
    },
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use crate::{
    GeneratorInputs,
    selector::{Choice, best_of},
};

/// Most tries of all rounds together: a second of one core.
const MOST_TRIES: usize = 50_000;

/// Rounds of a refinement: how many plans, and how many tries for each. None without refinement.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rounds(pub Vec<[usize; 2]>);

impl Rounds {
    /// The rounds of `sage`.
    pub fn standard() -> Self {
        Self(vec![[16, 8], [4, 25], [1, 100]])
    }

    /// *Errors*: a round without plans or tries, or too many tries.
    pub fn check(&self) -> Result<(), String> {
        let tries = |round: &[usize; 2]| round[0].saturating_mul(round[1]);
        if let Some([plans, tries]) = self.0.iter().find(|round| tries(round) == 0) {
            return Err(format!(
                "`refine` has a round of {plans} plans with {tries} tries; expected at least one of each"
            ));
        }
        let all = self.0.iter().map(tries).fold(0, usize::saturating_add);
        if all > MOST_TRIES {
            return Err(format!("`refine` has {all} tries; expected at most {MOST_TRIES}"));
        }
        Ok(())
    }
}

/// Refines what a selection by an objective chooses.
pub struct Refinement {
    objective: Arc<Objective>,
    rounds: Rounds,
}

/// A plan on its way.
struct Plan {
    evolution: Evolution,
    evaluation: Evaluation,
    trajectory: Option<Trajectory>,
}

impl Refinement {
    /// A refinement by the selection of a generator; `None` without rounds, and for an objective that asks for likelihoods, which
    /// refined plans do not have.
    pub fn of(inputs: &GeneratorInputs, rounds: Option<&Rounds>) -> Option<Self> {
        let rounds = rounds?.clone();
        let objective = inputs.selection.clone();
        (!rounds.0.is_empty() && !objective.needs_prior()).then_some(Self { objective, rounds })
    }

    /// Evaluates the proposals from which a refinement starts.
    pub fn evaluations(&self, proposals: &[Proposal], ctx: &Context) -> Vec<Evaluation> {
        let candidate = |proposal: &Proposal| ctx.candidate(proposal.trajectory.clone());
        proposals.iter().map(|proposal| self.objective.evaluate(&candidate(proposal), ctx)).collect()
    }

    /// A plan that the selection takes rather than its first choice, at a weight μ; `None` if no try was better.
    pub fn refined(
        &self,
        proposals: &[Proposal],
        evaluations: &[Evaluation],
        choice: &Choice,
        ctx: &Context,
        mu: f64,
        seed: u64,
    ) -> Option<Proposal> {
        if mu == 0.0 {
            return None;
        }
        let mut rng = Rng::new(seed, &ctx.scene().id, "refinement");
        let most = self.rounds.0.first().map_or(0, |round| round[0]);
        let mut order: Vec<usize> = (0..proposals.len()).collect();
        self.sort(&mut order, choice.chosen, evaluations, mu);
        let start = ctx.candidate(proposals[choice.chosen].trajectory.clone());
        let plan = |k: &usize| Plan {
            evolution: Evolution::new(Deformable::new(&proposals[*k].trajectory, start.start())),
            evaluation: evaluations[*k].clone(),
            trajectory: None,
        };
        let mut plans: Vec<Plan> = order.iter().take(most).map(plan).collect();
        for [count, tries] in &self.rounds.0 {
            let all: Vec<&Evaluation> = plans.iter().map(|plan| &plan.evaluation).collect();
            let best = best_of(&all, &self.objective, mu).chosen;
            plans.swap(0, best);
            plans[1..].sort_by(|a, b| self.rank(&b.evaluation, mu).total_cmp(&self.rank(&a.evaluation, mu)));
            plans.truncate(*count);
            for plan in &mut plans {
                self.run(plan, *tries, &mut rng, ctx, mu);
            }
        }
        let mut all = vec![&evaluations[choice.chosen]];
        all.extend(plans.iter().map(|plan| &plan.evaluation));
        let best = best_of(&all, &self.objective, mu).chosen;
        let refined = plans.into_iter().nth(best.checked_sub(1)?)?;
        refined.trajectory.map(Proposal::of)
    }

    /// Sorts proposals: the choice first, then feasible ones by value.
    fn sort(&self, order: &mut [usize], chosen: usize, evaluations: &[Evaluation], mu: f64) {
        let rank: Vec<f64> = evaluations.iter().map(|evaluation| self.rank(evaluation, mu)).collect();
        order.sort_by(|a, b| (*b == chosen).cmp(&(*a == chosen)).then(rank[*b].total_cmp(&rank[*a])));
    }

    /// Value of a feasible plan; −∞ of others.
    fn rank(&self, evaluation: &Evaluation, mu: f64) -> f64 {
        if evaluation.is_feasible() { self.objective.value(evaluation, mu) } else { f64::NEG_INFINITY }
    }

    fn run(&self, plan: &mut Plan, tries: usize, rng: &mut Rng, ctx: &Context, mu: f64) {
        let Plan { evolution, evaluation, trajectory } = plan;
        evolution.run(tries, rng, |deformed| {
            let candidate = ctx.candidate(deformed);
            if !is_within_limits(candidate.profile()) {
                return false;
            }
            // Only a believable hit is preferred to a plan of a larger value, and only to a hit that is none.
            let is_doubted = self.objective.spec().believable_first && evaluation.is_unbelievable_hit();
            let value = self.rank(evaluation, mu);
            let least = if is_doubted { f64::NEG_INFINITY } else { value + LEAST_GAIN };
            let Some(new) = self.objective.evaluate_above(least, &candidate, ctx, mu) else { return false };
            let gains = self.rank(&new, mu) > value + LEAST_GAIN;
            let is_better = (gains || is_doubted && new.is_believable)
                && best_of(&[&*evaluation, &new], &self.objective, mu).chosen == 1
                && tight_turn(&candidate, TURN).is_none();
            if is_better {
                *evaluation = new;
                *trajectory = Some(candidate.into_trajectory());
            }
            is_better
        });
    }
}
