//! The best feasible proposal by an objective.
//!
//! Proposals are sorted by an upper bound, with slow terms at their best, and evaluated until none can be better. All are
//! evaluated if the best is a hit that a person would not believe and the objective prefers believable ones. The result is
//! always that of evaluating all (tested).

use std::{
    borrow::{Borrow, Cow},
    sync::Arc,
};

use sage_core::{
    Error,
    generator::{Knowledge, Note, Proposal},
    objective::{Candidate, Context, Evaluation, Objective},
};

use super::{Choice, Selector};
use crate::{Facts, GeneratorInputs};

/// Largest number of candidates that are kept between their bound and their evaluation.
const MOST_KEPT: usize = 256;

/// Selects by an objective. The objective uses the ego's path and, for feasibility, the others' log.
pub struct Best(Arc<Objective>);

impl Best {
    /// Properties of a generator that selects so among the prior's proposals.
    pub const FACTS: Facts = Facts::of_selection(
        Knowledge { ego_future: true, others_future: true, own_future: false, ..Knowledge::NOW },
        true,
    );

    /// A selector by an objective.
    pub fn new(objective: Arc<Objective>) -> Self {
        Self(objective)
    }

    /// The selector by the objective of the selection.
    pub(crate) fn boxed(inputs: &GeneratorInputs) -> Box<dyn Selector> {
        Box::new(Self::new(inputs.selection.clone()))
    }
}

impl Selector for Best {
    fn select(&self, proposals: &[Proposal], ctx: &Context, mu: f64) -> Result<Choice, Error> {
        Ok(self.best(&mut Evaluated::new(proposals, ctx), mu))
    }

    /// A proposal is evaluated once for all μ.
    fn select_each(&self, proposals: &[Proposal], ctx: &Context, mus: &[f64]) -> Result<Vec<Choice>, Error> {
        let mut evaluated = Evaluated::new(proposals, ctx);
        Ok(mus.iter().map(|mu| self.best(&mut evaluated, *mu)).collect())
    }
}

impl Best {
    /// Evaluates proposals by descending upper bound and stops when no other proposal can be the best.
    fn best(&self, all: &mut Evaluated, mu: f64) -> Choice {
        let objective = &*self.0;
        let at_most = |k: usize| (objective.value_at_most(&all.candidate(k), all.ctx, mu), k);
        let mut order: Vec<(f64, usize)> = (0..all.proposals.len()).map(at_most).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut most, mut used) = (f64::NEG_INFINITY, Vec::new());
        for (at_most, k) in order {
            if at_most < most {
                break;
            }
            let evaluation = all.evaluate(objective, k);
            if evaluation.is_feasible() {
                most = most.max(objective.value(evaluation, mu));
            }
            used.push(k);
        }
        used.sort_unstable();
        let found = all.best_of(&used, objective, mu);
        let is_unbelievable_hit =
            all.known[found.chosen].as_ref().is_some_and(Evaluation::is_unbelievable_hit);
        if !(objective.spec().believable_first && is_unbelievable_hit) {
            return found;
        }
        // Any other may be the best believable hit.
        let every: Vec<usize> = (0..all.proposals.len()).collect();
        every.iter().for_each(|k| {
            all.evaluate(objective, *k);
        });
        all.best_of(&every, objective, mu)
    }
}

/// Proposals, each evaluated when it is needed.
struct Evaluated<'p> {
    proposals: &'p [Proposal],
    ctx: &'p Context,
    /// Those of an exhaustive proposer, 10 kB each, are built anew where they are needed.
    kept: Vec<Candidate>,
    known: Vec<Option<Evaluation>>,
}

impl<'p> Evaluated<'p> {
    fn new(proposals: &'p [Proposal], ctx: &'p Context) -> Self {
        let mut all = Self { proposals, ctx, kept: Vec::new(), known: vec![None; proposals.len()] };
        if proposals.len() <= MOST_KEPT {
            all.kept = (0..proposals.len()).map(|k| all.built(k)).collect();
        }
        all
    }

    fn built(&self, k: usize) -> Candidate {
        let proposal = &self.proposals[k];
        self.ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll)
    }

    fn candidate(&self, k: usize) -> Cow<'_, Candidate> {
        self.kept.get(k).map_or_else(|| Cow::Owned(self.built(k)), Cow::Borrowed)
    }

    fn evaluate(&mut self, objective: &Objective, k: usize) -> &Evaluation {
        let known = self.known[k].take();
        let evaluation = known.unwrap_or_else(|| objective.evaluate(&self.candidate(k), self.ctx));
        self.known[k].insert(evaluation)
    }

    /// The best of some proposals that are evaluated.
    fn best_of(&self, used: &[usize], objective: &Objective, mu: f64) -> Choice {
        let evaluations: Vec<&Evaluation> = used.iter().filter_map(|k| self.known[*k].as_ref()).collect();
        let Choice { chosen, note } = best_of(&evaluations, objective, mu);
        Choice { chosen: used.get(chosen).copied().unwrap_or(0), note }
    }
}

/// The best feasible evaluation at a weight μ, the first of equals; in place of a hit that a person would not believe the best
/// believable one, if the objective prefers it. If none is feasible, the one with the largest value minus the cost of its
/// violations, with a note.
///
/// The best of simple plans in a `scene`, whose context is `ctx`:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{objective::{Context, ContextOptions}, scene::SceneIndex};
/// # use sage_data::procedural::{Kind, attacks, generate};
/// use sage_core::objective::{Objective, ObjectiveSpec, feasibilities, rewards};
/// use sage_generators::selector::best_of;
///
/// # let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let spec = ObjectiveSpec::preset("paper-selection").ok_or("no such preset")?;
/// let objective = Objective::new(&spec, &rewards()?, &feasibilities()?)?;
/// // Simple plans: the recorded path with other accelerations and lanes. Each is evaluated once.
/// let plans = attacks(&scene).into_iter().map(|(_, plan)| objective.evaluate(&ctx.candidate(plan), &ctx));
/// let evaluations: Vec<_> = plans.collect();
/// // At μ = 1 the earliest contact is chosen, at μ = 0 the most realistic motion; never one that breaks the rule.
/// let [calm, hits] = [0.0, 1.0].map(|mu| &evaluations[best_of(&evaluations, &objective, mu).chosen]);
/// assert!(hits.is_attack() && calm.is_feasible() && hits.adversarial > calm.adversarial);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn best_of<E: Borrow<Evaluation>>(evaluations: &[E], objective: &Objective, mu: f64) -> Choice {
    let best = |value: &dyn Fn(&Evaluation) -> Option<f64>| {
        let mut best: Option<(usize, f64)> = None;
        for (k, evaluation) in evaluations.iter().enumerate() {
            let Some(value) = value(evaluation.borrow()) else { continue };
            if best.is_none_or(|(_, most)| value > most) {
                best = Some((k, value));
            }
        }
        best.map(|(k, _)| k)
    };
    if let Some(chosen) = best(&|e| e.is_feasible().then(|| objective.value(e, mu))) {
        let is_unbelievable_hit =
            objective.spec().believable_first && evaluations[chosen].borrow().is_unbelievable_hit();
        let believable = || best(&|e| e.is_believable.then(|| objective.value(e, mu)));
        let chosen = is_unbelievable_hit.then(believable).flatten().unwrap_or(chosen);
        return Choice { chosen, note: None };
    }
    let chosen = best(&|e| Some(objective.value(e, mu) - e.cost())).unwrap_or(0);
    Choice { chosen, note: Some(Note::NoneFeasible) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::{
        motion::{HORIZON, NOW, Trajectory},
        objective::{ContextOptions, ObjectiveSpec, Violation, feasibilities, rewards},
        scene::SceneIndex,
    };

    fn objective(name: &str) -> Objective {
        let spec = ObjectiveSpec::preset(name).unwrap();
        Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).unwrap()
    }

    fn evaluation(reward: f64, penalty: f64, cost: f64) -> Evaluation {
        let violation =
            Violation { rule: "wall".into(), cost, step: 1, place: [0.0; 2], with: String::new() };
        let violations = if cost > 0.0 { vec![violation] } else { Vec::new() };
        Evaluation {
            terms: vec![Some(reward), Some(penalty)],
            violations,
            contact: None,
            is_believable: false,
            adversarial: reward,
        }
    }

    #[test]
    fn the_best_feasible_one_is_selected_and_the_first_of_equals() {
        let all = [
            evaluation(9.0, 2.0, 50.0),
            evaluation(3.0, 2.5, 0.0),
            evaluation(5.0, 9.0, 0.0),
            evaluation(5.0, 9.0, 0.0),
        ];
        let selected = |mu| best_of(&all, &objective("paper-selection"), mu);
        assert_eq!(selected(1.0), Choice { chosen: 2, note: None });
        assert_eq!(selected(0.0).chosen, 1, "the least penalised");
        assert_eq!(selected(0.5).chosen, 1);
    }

    #[test]
    fn without_a_feasible_one_the_least_violating_is_selected_with_a_note() {
        let all = [evaluation(9.0, 2.0, 60.0), evaluation(3.0, 2.0, 10.0), evaluation(9.0, 2.0, 50.0)];
        let selection = best_of(&all, &objective("paper-selection"), 1.0);
        assert_eq!(selection, Choice { chosen: 1, note: Some(Note::NoneFeasible) });
    }

    #[test]
    fn skipping_proposals_that_cannot_be_the_best_changes_nothing() {
        let kinds = [sage_data::procedural::Kind::FourWay, sage_data::procedural::Kind::Merge];
        for (seed, kind) in (0..6).zip(kinds.into_iter().cycle()) {
            let Some(scene) = sage_data::procedural::generate(kind, seed, 0) else { continue };
            let (index, scene) = (SceneIndex::new(scene.map.clone()), Arc::new(scene));
            let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
            let track = scene.adversary().unwrap();
            let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
            let bent = |k: usize| {
                let (a, b) = (0.2 + 0.1 * (k % 8) as f64, 0.02 * (k / 8) as f64 - 0.05);
                let at = |t: usize| {
                    let t = 0.1 * t as f64;
                    [x + a * t * (vx - b * t * vy), y + a * t * (vy + b * t * vx)]
                };
                let points = (1..=HORIZON).map(at).collect();
                let trajectory = Trajectory::new("bent", points).unwrap();
                Proposal { nll: Some(k as f64 / 7.0), ..Proposal::of(trajectory) }
            };
            let proposals: Vec<Proposal> = (0..40).map(bent).collect();
            for name in ["paper-selection", "natural"] {
                let objective = Arc::new(objective(name));
                let all: Vec<Evaluation> = proposals
                    .iter()
                    .map(|p| ctx.candidate(p.trajectory.clone()).with_nll(p.nll))
                    .map(|candidate| objective.evaluate(&candidate, &ctx))
                    .collect();
                for mu in [0.0, 0.1, 0.5, 1.0] {
                    let found = Best::new(objective.clone()).select(&proposals, &ctx, mu).unwrap();
                    assert_eq!(found, best_of(&all, &objective, mu), "{name}, seed {seed}, mu {mu}");
                }
            }
        }
    }
}
