//! Why the selected candidate of a generator is an attack, or why it is none.

use std::collections::BTreeMap;

use sage_core::{
    generator::Attack,
    objective::{Context, Evaluation, Objective, Reason as Unbelievable, Scorer, Violation},
};
use serde::Serialize;

/// Candidates whose values are shown.
const SHOWN: usize = 5;

/// What came of a selection. The names are those of `sage search`, where it has the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Outcome {
    /// A believable attack.
    Attack,
    /// No candidate is feasible.
    NoFeasiblePlan,
    /// No candidate touches the ego.
    NeverHit,
    /// Candidates touch the ego, none of them is feasible.
    NoFeasibleHit,
    /// A feasible one touches the ego, and the selection prefers another.
    NotPreferred,
    /// The selected one touches the ego, and a person would not believe it.
    NotBelievable,
}

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

/// What the candidates of an operating point are, and why the selected one is no attack.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Explanation {
    pub(super) scene: String,
    pub(super) adversary: String,
    /// Generator and operating point.
    pub(super) attack: String,
    pub(super) outcome: Outcome,
    pub(super) candidates: usize,
    /// Feasible by the rule of the selection.
    pub(super) feasible: usize,
    /// Touch the ego.
    pub(super) hits: usize,
    pub(super) feasible_hits: usize,
    pub(super) believable_hits: usize,
    /// What makes hits infeasible: rule and what is touched, with the number of hits.
    pub(super) violations: BTreeMap<String, usize>,
    /// Why feasible hits are not believable, with the number of hits.
    pub(super) unbelievable: BTreeMap<String, usize>,
    /// Why the selected candidate is not believable, in words.
    pub(super) selected_unbelievable: Vec<String>,
    /// The selected candidate, the best that is feasible and touches the ego, and the best of the others.
    pub(super) best: Vec<ValuedCandidate>,
}

impl Explanation {
    /// Explains the selection among the candidates of an attack at μ.
    pub(super) fn of(attack: &Attack, ctx: &Context, objective: &Objective, mu: f64, label: String) -> Self {
        let evaluate = |proposal: &sage_core::generator::Proposal| {
            let candidate = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
            let evaluation = objective.evaluate(&candidate, ctx);
            let unbelievable = evaluation.contact.map(|_| Scorer::new(ctx).scores(&candidate).unbelievable);
            (evaluation, unbelievable)
        };
        let all: Vec<(Evaluation, Option<Vec<Unbelievable>>)> =
            attack.candidates.iter().map(evaluate).collect();
        let hits = || all.iter().filter(|(evaluation, _)| evaluation.contact.is_some());
        let feasible_hits = || hits().filter(|(evaluation, _)| evaluation.is_feasible());
        let (mut violations, mut unbelievable) = (BTreeMap::new(), BTreeMap::new());
        for (evaluation, _) in hits().filter(|(evaluation, _)| !evaluation.is_feasible()) {
            count_each(&mut violations, evaluation.violations.iter().map(violated));
        }
        for reasons in feasible_hits().filter_map(|(_, reasons)| reasons.as_ref()) {
            count_each(&mut unbelievable, reasons.iter().map(|reason| reason.reason.replace('_', " ")));
        }
        let is_believed =
            |unbelievable: &Option<Vec<Unbelievable>>| unbelievable.as_ref().is_some_and(Vec::is_empty);
        let (chosen, selected_unbelievable) = &all[attack.chosen];
        let outcome = if chosen.is_attack() && is_believed(selected_unbelievable) {
            Outcome::Attack
        } else if chosen.is_attack() {
            Outcome::NotBelievable
        } else if !all.iter().any(|(evaluation, _)| evaluation.is_feasible()) {
            Outcome::NoFeasiblePlan
        } else if hits().next().is_none() {
            Outcome::NeverHit
        } else if feasible_hits().next().is_none() {
            Outcome::NoFeasibleHit
        } else {
            Outcome::NotPreferred
        };
        let evaluations: Vec<&Evaluation> = all.iter().map(|(evaluation, _)| evaluation).collect();
        let chosen_words = selected_unbelievable.iter().flatten().map(Unbelievable::words).collect();
        Self {
            scene: ctx.scene().id.clone(),
            adversary: ctx.adversary().id.clone(),
            attack: label,
            outcome,
            candidates: all.len(),
            feasible: evaluations.iter().filter(|evaluation| evaluation.is_feasible()).count(),
            hits: hits().count(),
            feasible_hits: feasible_hits().count(),
            believable_hits: feasible_hits().filter(|(_, unbelievable)| is_believed(unbelievable)).count(),
            violations,
            unbelievable,
            selected_unbelievable: chosen_words,
            best: best(&evaluations, attack.chosen, objective, mu),
        }
    }
}

/// What a violation breaks, and what it touches.
fn violated(violation: &Violation) -> String {
    let rule = violation.words();
    if violation.with.is_empty() { rule } else { format!("{rule} `{}`", violation.with) }
}

/// Counts each word of a candidate once.
fn count_each(counts: &mut BTreeMap<String, usize>, words: impl Iterator<Item = String>) {
    let words: std::collections::BTreeSet<String> = words.collect();
    words.into_iter().for_each(|word| *counts.entry(word).or_default() += 1);
}

/// The selected candidate, the best feasible hit, then the best others: feasible ones first, as a selection ranks them.
fn best(all: &[&Evaluation], chosen: usize, objective: &Objective, mu: f64) -> Vec<ValuedCandidate> {
    let value = |k: usize| objective.value(all[k], mu);
    let mut order: Vec<usize> = (0..all.len()).filter(|k| *k != chosen).collect();
    order.sort_by(|a, b| {
        let infeasible = |k: &usize| !all[*k].is_feasible();
        infeasible(a).cmp(&infeasible(b)).then(value(*b).total_cmp(&value(*a)))
    });
    let hit = order.iter().copied().find(|k| all[*k].is_attack());
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
            terms,
        }
    };
    shown.map(valued).collect()
}
