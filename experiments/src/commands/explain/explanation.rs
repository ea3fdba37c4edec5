//! Why the selected candidate of a generator is an attack, or why it is none.

use sage_core::{
    generator::{Attack, Proposal},
    motion::Trajectory,
    objective::{Context, Evaluation, Objective, Reason, Scorer},
    selection_outcome::{CandidateCounts, CandidateKind, Measured, Nearest, SelectionOutcome},
};
use serde::Serialize;

/// Candidates whose values are shown.
const SHOWN: usize = 5;

/// One candidate with its value.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ValuedCandidate {
    /// Its number in the row of `sage generate`.
    pub(super) number: usize,
    pub(super) is_chosen: bool,
    /// Value of the selection at μ.
    pub(super) value: f64,
    /// Step of the contact with the ego.
    pub(super) contact: Option<usize>,
    pub(super) feasible: bool,
    /// Whether it is a hit that is not believable: `natural` passes it over where there is a believable one.
    pub(super) is_doubted: bool,
    /// Weighted value of each reward of the selection, in its order; terms of one reward are added.
    pub(super) terms: Vec<(String, f64)>,
}

impl ValuedCandidate {
    /// The reward that is most below that of another candidate, and by how much.
    pub(super) fn largest_loss(&self, other: &Self) -> Option<(&str, f64)> {
        let losses = self.terms.iter().zip(&other.terms);
        let losses = losses.map(|((name, own), (_, others))| (&**name, own - others));
        losses.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, loss)| *loss < 0.0)
    }
}

/// A candidate with all that is measured of it.
struct Evaluated {
    trajectory: Trajectory,
    evaluation: Evaluation,
    unbelievable: Vec<Reason>,
    nearest: Option<Nearest>,
}

impl Evaluated {
    fn measured(&self) -> Measured<'_> {
        Measured {
            trajectory: &self.trajectory,
            is_hit: self.evaluation.contact.is_some(),
            violations: &self.evaluation.violations,
            unbelievable: &self.unbelievable,
            nearest: self.nearest,
        }
    }
}

/// What the candidates of an operating point are, and why the selected one is no attack.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Explanation {
    pub(super) scene: String,
    pub(super) adversary: String,
    /// Generator and operating point.
    pub(super) attack: String,
    pub(super) outcome: SelectionOutcome,
    /// What the generator says of the attack.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) note: Option<String>,
    #[serde(flatten)]
    pub(super) counts: CandidateCounts,
    /// Why the selected candidate is not believable, in words.
    pub(super) selected_unbelievable: Vec<String>,
    /// Whether the selected candidate is refined: none of those that were proposed.
    pub(super) is_refined: bool,
    /// The selected candidate, the best that is feasible and touches the ego, and the best of the others.
    pub(super) best: Vec<ValuedCandidate>,
}

impl Explanation {
    /// Explains the selection among the candidates of an attack at μ.
    ///
    /// Also says what each candidate does.
    pub(super) fn of(
        attack: &Attack,
        ctx: &Context,
        objective: &Objective,
        mu: f64,
        label: String,
    ) -> (Self, Vec<CandidateKind>) {
        let evaluate = |proposal: &Proposal| {
            let candidate = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
            let evaluation = objective.evaluate(&candidate, ctx);
            let scores = evaluation.contact.map(|_| Scorer::new(ctx).scores(&candidate));
            let unbelievable = scores.map_or(Vec::new(), |scores| scores.unbelievable);
            Evaluated {
                trajectory: proposal.trajectory.clone(),
                evaluation,
                unbelievable,
                nearest: Nearest::of(&candidate, ctx),
            }
        };
        let all: Vec<Evaluated> = attack.candidates.iter().map(evaluate).collect();
        let counts = CandidateCounts::of(all.iter().map(Evaluated::measured));
        let evaluations: Vec<&Evaluation> = all.iter().map(|one| &one.evaluation).collect();
        let kinds = all.iter().map(|one| one.measured().kind()).collect();
        let explanation = Self {
            scene: ctx.scene().id.clone(),
            adversary: ctx.adversary().id.clone(),
            attack: label,
            note: attack.note.as_ref().map(ToString::to_string),
            outcome: counts.outcome(&all[attack.chosen].measured()),
            counts,
            selected_unbelievable: all[attack.chosen].unbelievable.iter().map(Reason::words).collect(),
            is_refined: is_refined(attack),
            best: best(&evaluations, attack.chosen, objective, mu, |k| !all[k].unbelievable.is_empty()),
        };
        (explanation, kinds)
    }
}

/// A refined plan has no goal, those that it was refined from have.
fn is_refined(attack: &Attack) -> bool {
    let has_goal = |candidate: &Proposal| candidate.goal.is_some();
    !has_goal(&attack.candidates[attack.chosen]) && attack.candidates.iter().any(has_goal)
}

/// The selected candidate, the best feasible hit, or an infeasible one without, then the best others: feasible ones first, as a selection ranks them.
fn best(
    all: &[&Evaluation],
    chosen: usize,
    objective: &Objective,
    mu: f64,
    is_doubted: impl Fn(usize) -> bool,
) -> Vec<ValuedCandidate> {
    let value = |k: usize| objective.value(all[k], mu);
    let mut order: Vec<usize> = (0..all.len()).filter(|k| *k != chosen).collect();
    order.sort_by(|a, b| {
        let infeasible = |k: &usize| !all[*k].is_feasible();
        infeasible(a).cmp(&infeasible(b)).then(value(*b).total_cmp(&value(*a)))
    });
    let is_hit = |k: &usize| all[*k].contact.is_some();
    let hit =
        order.iter().copied().find(|k| all[*k].is_attack()).or_else(|| order.iter().copied().find(is_hit));
    let others = order.iter().copied().filter(|k| Some(*k) != hit);
    let shown = std::iter::once(chosen).chain(hit).chain(others).take(SHOWN);
    let valued = |k: usize| {
        let mut terms: Vec<(String, f64)> = Vec::new();
        for (term, measured) in objective.spec().terms.iter().zip(&all[k].terms) {
            let value = term.weight.at(mu) * measured.unwrap_or(0.0);
            match terms.iter_mut().find(|(name, _)| *name == term.name) {
                Some((_, sum)) => *sum += value,
                None => terms.push((term.name.clone(), value)),
            }
        }
        ValuedCandidate {
            number: k,
            is_chosen: k == chosen,
            value: value(k),
            contact: all[k].contact,
            feasible: all[k].is_feasible(),
            is_doubted: is_doubted(k),
            terms,
        }
    };
    shown.map(valued).collect()
}
