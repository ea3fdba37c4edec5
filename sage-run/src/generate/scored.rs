//! Scores of the candidates of a scene.

use std::collections::{HashMap, hash_map::Entry};

use advsage::{WithContext as _, rows::attack::CandidateRow};
use sage_core::{
    generator::{Attack, Proposal},
    motion::Trajectory,
    objective::{Context, Objective, Scorer, Scores, Violation},
    selection_outcome::{CandidateCounts, CandidateKind, Measured, Nearest, SelectionOutcome},
};
use sage_sim::avoidable::{Avoidable, Avoidance};
use serde_json::value::{RawValue, to_raw_value};

use crate::Result;

/// A trajectory with its scores, also as JSON.
pub(super) struct Scored {
    pub(super) scores: Scores,
    nearest: Option<Nearest>,
    /// Violations of the rule of the selection, if the scores do not hold them.
    violations: Option<Vec<Violation>>,
    json: Box<RawValue>,
    trajectory: Box<RawValue>,
}

/// Candidates as a row holds them, written as JSON before.
pub(super) type Candidates<'s> = Vec<CandidateRow<&'s RawValue, &'s RawValue>>;

/// Scores of the candidates of one scene. Attacks at several operating points share many candidates, so each
/// candidate is scored and written as JSON only once.
pub(super) struct ScoredCandidates<'s> {
    ctx: &'s Context,
    scorer: Scorer<'s>,
    selection: &'s Objective,
    avoidance: &'s Avoidance,
    /// Whether a driver could have avoided a chosen candidate, by its index in `all`.
    avoidable: HashMap<usize, Avoidable>,
    all: Vec<Scored>,
    /// Index of each trajectory in `all`, by the bits of its coordinates.
    indices: HashMap<Vec<u64>, usize>,
}

impl<'s> ScoredCandidates<'s> {
    pub(super) fn new(
        ctx: &'s Context,
        scorer: Scorer<'s>,
        selection: &'s Objective,
        avoidance: &'s Avoidance,
    ) -> Self {
        let (all, indices, avoidable) = (Vec::new(), HashMap::new(), HashMap::new());
        Self { ctx, scorer, selection, avoidance, avoidable, all, indices }
    }

    /// Scores the trajectories of an attack.
    pub(super) fn score(&mut self, attack: &Attack) -> Result<()> {
        for proposal in &attack.candidates {
            if let Entry::Vacant(entry) = self.indices.entry(bits(&proposal.trajectory)) {
                entry.insert(self.all.len());
                let candidate = self.ctx.candidate(proposal.trajectory.clone());
                let scores = self.scorer.scores(&candidate);
                let (json, trajectory) = (to_raw_value(&scores)?, to_raw_value(&proposal.trajectory)?);
                let violations = match self.violations(&scores) {
                    Some(_) => None,
                    None => Some(self.selection.rule().violations(&candidate, self.ctx)),
                };
                let nearest = Nearest::of(&candidate, self.ctx);
                self.all.push(Scored { scores, nearest, violations, json, trajectory });
            }
        }
        Ok(())
    }

    /// Whether a driver could have avoided a scored trajectory.
    pub(super) fn avoidable(&mut self, trajectory: &Trajectory) -> Result<Avoidable> {
        let index = self.index(trajectory)?;
        let (ctx, avoidance) = (self.ctx, self.avoidance);
        let search = || avoidance.of(&ctx.candidate(trajectory.clone()));
        Ok(self.avoidable.entry(index).or_insert_with(search).clone())
    }

    /// Violations of the rule of the selection, if the scores hold them.
    fn violations<'a>(&self, scores: &'a Scores) -> Option<&'a [Violation]> {
        let rule = &self.selection.spec().feasibility;
        match &*rule.name {
            "paper" if rule.options.is_empty() => Some(&scores.violations),
            "drivable" if rule.options.is_empty() => Some(&scores.violations_drivable),
            _ => None,
        }
    }

    /// What a scored trajectory does.
    fn measured<'a>(&'a self, trajectory: &'a Trajectory) -> Result<Measured<'a>> {
        let one = self.get(trajectory)?;
        let own = one.violations.as_deref();
        Ok(Measured {
            trajectory,
            is_hit: one.scores.collision_step.is_some(),
            violations: own.or_else(|| self.violations(&one.scores)).unwrap_or_default(),
            unbelievable: &one.scores.unbelievable,
            nearest: one.nearest,
        })
    }

    /// What kind of candidate a scored trajectory is.
    pub(super) fn kind(&self, trajectory: &Trajectory) -> Result<CandidateKind> {
        Ok(self.measured(trajectory)?.kind())
    }

    /// What came of a scored attack's selection, and what its candidates do.
    pub(super) fn outcome(&self, attack: &Attack) -> Result<(SelectionOutcome, CandidateCounts)> {
        let all = attack.candidates.iter().map(|proposal| self.measured(&proposal.trajectory));
        let counts = CandidateCounts::of(all.collect::<Result<Vec<_>>>()?);
        Ok((counts.outcome(&self.measured(attack.trajectory())?), counts))
    }

    fn index(&self, trajectory: &Trajectory) -> Result<usize> {
        let index = self.indices.get(&bits(trajectory)).copied();
        Ok(index.with_context(|| "the trajectory is among the candidates")?)
    }

    /// Scores of a trajectory that [`ScoredCandidates::score`] has scored.
    pub(super) fn get(&self, trajectory: &Trajectory) -> Result<&Scored> {
        Ok(&self.all[self.index(trajectory)?])
    }

    /// The candidates of a scored attack.
    pub(super) fn rows(&self, attack: &Attack) -> Result<Candidates<'_>> {
        let row = |proposal: &Proposal| {
            let Scored { json, trajectory, .. } = self.get(&proposal.trajectory)?;
            let Proposal { log_prob, nll, goal, .. } = *proposal;
            Ok(CandidateRow { log_prob, nll, goal, trajectory: &**trajectory, scores: &**json })
        };
        attack.candidates.iter().map(row).collect()
    }
}

/// Identifies a trajectory.
pub(super) fn bits(trajectory: &Trajectory) -> Vec<u64> {
    trajectory.points().as_flattened().iter().map(|x| x.to_bits()).collect()
}
