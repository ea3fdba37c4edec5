//! What came of the selection among a generator's candidates: an attack, or why there is none.

use std::collections::{BTreeMap, BTreeSet};

use sage_core::{
    geometry::distance,
    objective::{Candidate, Context, Reason, Violation},
};
use serde::{Deserialize, Serialize};

/// What came of a selection. The names are those of `sage search`, where it has the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SelectionOutcome {
    /// A believable attack.
    Attack,
    /// The selected candidate is a feasible hit that a person would not believe.
    NotBelievable,
    /// No candidate is feasible.
    NoFeasiblePlan,
    /// No candidate touches the ego.
    NeverHit,
    /// Candidates touch the ego, none of them is feasible.
    NoFeasibleHit,
    /// A feasible one touches the ego, and the selection prefers another.
    NotPreferred,
}

impl SelectionOutcome {
    /// Whether the selected candidate is a feasible hit.
    pub(crate) fn is_attack(self) -> bool {
        matches!(self, Self::Attack | Self::NotBelievable)
    }

    /// Why there is no believable attack, in words; `None` if there is one.
    pub(crate) fn reason(self) -> Option<&'static str> {
        Some(match self {
            Self::Attack => return None,
            Self::NotBelievable => "the attack is not believable",
            Self::NoFeasiblePlan => "no candidate is feasible",
            Self::NeverHit => "no candidate touches the ego",
            Self::NoFeasibleHit => "no candidate that touches the ego is feasible",
            Self::NotPreferred => "the selection prefers one without contact",
        })
    }

    /// The outcome in words. A selection says more about an attack.
    pub(crate) fn words(self) -> String {
        match self {
            Self::Attack => "believable attack".to_owned(),
            Self::NotBelievable => "attack, not believable".to_owned(),
            other => format!("no attack: {}", other.reason().unwrap_or_default()),
        }
    }
}

/// What a candidate does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum CandidateKind {
    /// It does not touch the ego.
    NoContact,
    /// It touches the ego, and is not feasible.
    InfeasibleHit,
    /// A feasible hit that a person would not believe.
    UnbelievableHit,
    /// A believable hit.
    BelievableHit,
}

impl CandidateKind {
    /// Words of a legend.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::NoContact => "no contact",
            Self::InfeasibleHit => "hit, not feasible",
            Self::UnbelievableHit => "hit, not believable",
            Self::BelievableHit => "believable hit",
        }
    }
}

/// One candidate of a selection, measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured<'a> {
    /// Whether it touches the ego.
    pub(crate) is_hit: bool,
    /// Violations of the rule of the selection.
    pub(crate) violations: &'a [Violation],
    /// Why a person would not believe it; empty without contact.
    pub(crate) unbelievable: &'a [Reason],
    pub(crate) nearest: Option<Nearest>,
}

/// Where a candidate comes nearest to the ego.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Nearest {
    /// Distance of the centres, metres.
    pub(crate) distance: f64,
    /// Seconds from *now*.
    pub(crate) after: f64,
}

impl Nearest {
    /// That of a candidate; `None` if the ego has no box at any of its steps.
    pub(crate) fn of(candidate: &Candidate, ctx: &Context) -> Option<Self> {
        let steps = candidate.boxes().iter().zip(ctx.ego().boxes()).enumerate();
        let steps = steps.filter_map(|(k, (own, ego))| Some((k, distance(own.center, ego.as_ref()?.center))));
        let (k, distance) = steps.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Self { distance, after: (k + 1) as f64 / 10.0 })
    }
}

/// Hits that break one rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Broken {
    pub(crate) hits: usize,
    /// Earliest violation, seconds from *now*.
    pub(crate) from: f64,
}

impl Measured<'_> {
    fn is_feasible(&self) -> bool {
        self.violations.is_empty()
    }

    fn is_believable(&self) -> bool {
        self.kind() == CandidateKind::BelievableHit
    }

    /// What it does.
    pub(crate) fn kind(&self) -> CandidateKind {
        match (self.is_hit, self.is_feasible()) {
            (false, _) => CandidateKind::NoContact,
            (true, false) => CandidateKind::InfeasibleHit,
            (true, true) if self.unbelievable.is_empty() => CandidateKind::BelievableHit,
            (true, true) => CandidateKind::UnbelievableHit,
        }
    }
}

/// The candidates of a selection by what they do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct CandidateCounts {
    pub(crate) candidates: usize,
    /// Feasible by the rule of the selection.
    pub(crate) feasible: usize,
    /// Touch the ego.
    pub(crate) hits: usize,
    pub(crate) feasible_hits: usize,
    pub(crate) believable_hits: usize,
    /// The candidate that comes nearest.
    pub(crate) nearest: Option<Nearest>,
    /// What makes hits infeasible: rule and what is touched.
    pub(crate) violations: BTreeMap<String, Broken>,
    /// Why feasible hits are not believable, with the number of hits.
    pub(crate) unbelievable: BTreeMap<String, usize>,
}

impl CandidateCounts {
    /// Counts candidates.
    pub(crate) fn of<'a>(all: impl IntoIterator<Item = Measured<'a>>) -> Self {
        let mut counts = Self::default();
        all.into_iter().for_each(|one| counts.add(&one));
        counts
    }

    fn add(&mut self, one: &Measured) {
        self.candidates += 1;
        self.feasible += usize::from(one.is_feasible());
        let is_nearer = |a: &Nearest| self.nearest.is_none_or(|b| a.distance < b.distance);
        self.nearest = one.nearest.filter(is_nearer).or(self.nearest);
        if !one.is_hit {
            return;
        }
        self.hits += 1;
        if !one.is_feasible() {
            let mut first: BTreeMap<String, usize> = BTreeMap::new();
            for violation in one.violations {
                let step = first.entry(violated(violation)).or_insert(violation.step);
                *step = violation.step.min(*step);
            }
            for (what, step) in first {
                let from = step as f64 / 10.0;
                let broken = self.violations.entry(what).or_insert(Broken { hits: 0, from });
                *broken = Broken { hits: broken.hits + 1, from: broken.from.min(from) };
            }
            return;
        }
        self.feasible_hits += 1;
        self.believable_hits += usize::from(one.is_believable());
        let doubts: BTreeSet<String> =
            one.unbelievable.iter().map(|reason| reason.reason.replace('_', " ")).collect();
        doubts.into_iter().for_each(|doubt| *self.unbelievable.entry(doubt).or_default() += 1);
    }

    /// What came of a selection among these.
    pub(crate) fn outcome(&self, selected: &Measured) -> SelectionOutcome {
        match selected.is_hit && selected.is_feasible() {
            true if selected.is_believable() => SelectionOutcome::Attack,
            true => SelectionOutcome::NotBelievable,
            false if self.feasible == 0 => SelectionOutcome::NoFeasiblePlan,
            false if self.hits == 0 => SelectionOutcome::NeverHit,
            false if self.feasible_hits == 0 => SelectionOutcome::NoFeasibleHit,
            false => SelectionOutcome::NotPreferred,
        }
    }

    /// The counts in a sentence.
    pub(crate) fn words(&self) -> String {
        let touching = match (self.hits, self.feasible_hits) {
            (0, _) => {
                let nearest = self.nearest.map_or(String::new(), |Nearest { distance, after }| {
                    format!(" (centres at least {distance:.1} m apart, after {after:.1} s)")
                });
                format!("none touches the ego{nearest}")
            }
            (1, 0) => "1 touches the ego, and is not feasible".to_owned(),
            (hits, 0) => format!("{hits} touch the ego, none of them is feasible"),
            (hits, feasible) => {
                let touch = if hits == 1 { "touches" } else { "touch" };
                format!(
                    "{hits} {touch} the ego, {feasible} of them feasible, {} believable",
                    self.believable_hits
                )
            }
        };
        let many = if self.candidates == 1 { "candidate" } else { "candidates" };
        format!("{} {many}, {} feasible; {touching}", self.candidates, self.feasible)
    }
}

/// What a violation breaks, and what it touches.
fn violated(violation: &Violation) -> String {
    let rule = violation.words();
    if violation.with.is_empty() { rule } else { format!("{rule} `{}`", violation.with) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured<'a>(is_hit: bool, violations: &'a [Violation], unbelievable: &'a [Reason]) -> Measured<'a> {
        Measured { is_hit, violations, unbelievable, nearest: None }
    }

    #[test]
    fn every_outcome_has_its_candidates() {
        let edge =
            [Violation { rule: "road_edge".into(), cost: 50.0, step: 3, place: [0.0; 2], with: "7".into() }];
        let grazes = [Reason { reason: "contact_depth".into(), value: 0.1, limit: Some(0.5) }];
        let (hit, miss) = (measured(true, &[], &[]), measured(false, &[], &[]));
        let (grazing, infeasible_hit) = (measured(true, &[], &grazes), measured(true, &edge, &[]));
        let infeasible = measured(false, &edge, &[]);
        let outcome = |all: &[Measured]| CandidateCounts::of(all.iter().copied()).outcome(&all[0]);
        assert_eq!(outcome(&[hit, miss]), SelectionOutcome::Attack);
        assert_eq!(outcome(&[grazing, miss]), SelectionOutcome::NotBelievable);
        assert_eq!(outcome(&[infeasible_hit, infeasible]), SelectionOutcome::NoFeasiblePlan);
        assert_eq!(outcome(&[miss, infeasible]), SelectionOutcome::NeverHit);
        assert_eq!(outcome(&[miss, infeasible_hit]), SelectionOutcome::NoFeasibleHit);
        assert_eq!(outcome(&[miss, hit]), SelectionOutcome::NotPreferred);
        let counts = CandidateCounts::of([miss, infeasible_hit, grazing]);
        assert_eq!(
            counts.words(),
            "3 candidates, 2 feasible; 2 touch the ego, 1 of them feasible, 0 believable"
        );
        assert_eq!(
            counts.violations,
            BTreeMap::from([("road edge `7`".to_owned(), Broken { hits: 1, from: 0.3 })])
        );
        assert_eq!(counts.unbelievable, BTreeMap::from([("contact depth".to_owned(), 1)]));
    }
}
