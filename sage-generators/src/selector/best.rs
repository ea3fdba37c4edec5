//! The best feasible proposal by an objective.

use std::{borrow::Cow, sync::Arc};

use sage_core::{
    Error,
    generator::{Knowledge, Note, Proposal},
    objective::{Candidate, Context, Evaluation, Objective},
};

use super::{Selection, Selector, SelectorKind};
use crate::GeneratorInputs;

/// Largest number of candidates that are kept between their bound and their evaluation.
const MOST_KEPT: usize = 256;

/// Selects by an objective. The objective uses the ego's path and, for feasibility, the others' log.
pub struct Best(Arc<Objective>);

impl Best {
    /// A selector by an objective.
    pub fn new(objective: Arc<Objective>) -> Self {
        Self(objective)
    }
}

impl SelectorKind for Best {
    const KNOWS: Knowledge = Knowledge { ego_future: true, others_future: true, own_future: false };
    const DEPENDS_ON_MU: bool = true;

    fn build(inputs: &GeneratorInputs) -> Box<dyn Selector> {
        Box::new(Self::new(inputs.selection.clone()))
    }
}

impl Selector for Best {
    /// Evaluates proposals by descending upper bound and stops when no other proposal can be the best.
    fn select(&self, proposals: &[Proposal], ctx: &Context, mu: f64) -> Result<Selection, Error> {
        let objective = &*self.0;
        let build = |proposal: &Proposal| ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
        // Those of an exhaustive proposer, 10 kB each, are built anew where they are needed.
        let kept: Vec<Candidate> =
            if proposals.len() <= MOST_KEPT { proposals.iter().map(build).collect() } else { Vec::new() };
        let candidate =
            |k: usize| kept.get(k).map_or_else(|| Cow::Owned(build(&proposals[k])), Cow::Borrowed);
        let at_most = |k: usize| (objective.value_at_most(&candidate(k), ctx, mu), k);
        let mut order: Vec<(f64, usize)> = (0..proposals.len()).map(at_most).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut most, mut evaluated) = (f64::NEG_INFINITY, Vec::new());
        for (at_most, k) in order {
            if at_most < most {
                break;
            }
            let evaluation = objective.evaluate(&candidate(k), ctx);
            if evaluation.is_feasible() {
                most = most.max(objective.value(&evaluation, mu));
            }
            evaluated.push((k, evaluation));
        }
        evaluated.sort_by_key(|(k, _)| *k);
        let (numbers, evaluations): (Vec<usize>, Vec<Evaluation>) = evaluated.into_iter().unzip();
        let Selection { chosen, note } = best_of(&evaluations, objective, mu);
        Ok(Selection { chosen: numbers.get(chosen).copied().unwrap_or(0), note })
    }
}

/// The best feasible evaluation at a weight μ, the first of equals. If none is feasible, the one with the
/// largest value minus the cost of its violations, with a note.
pub fn best_of(evaluations: &[Evaluation], objective: &Objective, mu: f64) -> Selection {
    let best = |value: &dyn Fn(&Evaluation) -> Option<f64>| {
        let mut best: Option<(usize, f64)> = None;
        for (k, evaluation) in evaluations.iter().enumerate() {
            let Some(value) = value(evaluation) else { continue };
            if best.is_none_or(|(_, most)| value > most) {
                best = Some((k, value));
            }
        }
        best.map(|(k, _)| k)
    };
    if let Some(chosen) = best(&|e| e.is_feasible().then(|| objective.value(e, mu))) {
        return Selection { chosen, note: None };
    }
    let chosen = best(&|e| Some(objective.value(e, mu) - e.cost())).unwrap_or(0);
    Selection { chosen, note: Some(Note::NoneFeasible) }
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
        assert_eq!(selected(1.0), Selection { chosen: 2, note: None });
        assert_eq!(selected(0.0).chosen, 1, "the least penalised");
        assert_eq!(selected(0.5).chosen, 1);
    }

    #[test]
    fn without_a_feasible_one_the_least_violating_is_selected_with_a_note() {
        let all = [evaluation(9.0, 2.0, 60.0), evaluation(3.0, 2.0, 10.0), evaluation(9.0, 2.0, 50.0)];
        let selection = best_of(&all, &objective("paper-selection"), 1.0);
        assert_eq!(selection, Selection { chosen: 1, note: Some(Note::NoneFeasible) });
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
