//! How likely a driver fails in a scene, if the adversary moves as a *nominal* density of plans says.
//!
//! The density is finite: a motion prior gives each goal of the adversary a probability and a trajectory. The rate of an event is the
//! probability of the plans in whose drive it happens, conditioned on what is [`Given`]. With as many drives as plans it is exact;
//! with fewer it is an estimate without bias ([`systematic`]), between bounds that hold for sure.
//!
//! It is no accident rate. Scenes are chosen, nothing is per kilometre, and a density that does not look out collides with recorded
//! egos more often than people did.

mod importance;
mod metrics;
mod sampling;

use sage_core::{
    generator::Proposal,
    geometry::Point,
    objective::{Context, Encounter, Feasibility},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use importance::{BESIDE, LEAST, importance};
pub use metrics::{MeasuredRate, rate_metrics};
pub use sampling::{inclusions, systematic};

use crate::{
    Error, PlannerLog,
    attack_test::AttackTest,
    search::{Clause, Evaluated, PlanDrives, Requirement, SearchOptions},
};

/// What a rate is conditioned on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Given {
    /// The plan is feasible and does not touch the recorded ego: traffic in which the person who was recorded was not hit.
    #[default]
    ClearOfRecordedEgo,
    /// The plan is feasible.
    Feasible,
}

impl Given {
    /// All conditions, the headline first.
    pub const ALL: [Self; 2] = [Self::ClearOfRecordedEgo, Self::Feasible];

    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::ClearOfRecordedEgo => Self::Feasible,
            Self::Feasible => Self::ClearOfRecordedEgo,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClearOfRecordedEgo => "clear-of-recorded-ego",
            Self::Feasible => "feasible",
        }
    }
}

impl std::fmt::Display for Given {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Given {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|given| given.name() == name);
        found.ok_or_else(|| format!("`{name}` is none; known: {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// An event in a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The first contact is with the adversary.
    Contact,
    /// A clause and the ones before it hold.
    Clause(Clause),
    /// All required clauses hold.
    Failure,
}

impl Event {
    /// Those that are measured if none are named.
    pub const DEFAULT: [Self; 4] =
        [Self::Contact, Self::Clause(Clause::Attack), Self::Clause(Clause::Believable), Self::Failure];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Contact => "contact",
            Self::Clause(clause) => clause.name(),
            Self::Failure => "failure",
        }
    }

    /// Whether it happens in a drive.
    pub fn happens(self, driven: &Evaluated, require: Requirement) -> bool {
        match self {
            Self::Contact => driven.contact.as_ref().is_some_and(|met| met.is_adversary),
            Self::Clause(clause) => driven.clauses.reach(clause),
            Self::Failure => driven.clauses.meet(require),
        }
    }
}

impl std::str::FromStr for Event {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "contact" => Ok(Self::Contact),
            "failure" => Ok(Self::Failure),
            _ => {
                let clause = serde_json::from_value(name.into()).map(Self::Clause);
                clause.map_err(|_| format!("`{name}` is no event; known: contact, failure, and clauses such as attack, believable, at-fault"))
            }
        }
    }
}

/// A feasible plan of the nominal density.
#[derive(Clone, Debug)]
pub struct NominalPlan {
    /// The plan with its goal.
    pub proposal: Proposal,
    /// Its probability among all plans, infeasible ones included.
    pub probability: f64,
    /// How far its timing is shifted from that of its goal's trajectory, metres.
    pub shift: f64,
    /// Whether it does not touch the recorded ego.
    pub is_clear: bool,
}

/// The feasible plans of a nominal density in a scene.
#[derive(Clone, Debug)]
pub struct Nominal {
    /// The plans, in the order of the proposals.
    pub plans: Vec<NominalPlan>,
    /// Number of all plans.
    pub all: usize,
}

impl Nominal {
    /// The density of proposals with log-probabilities, normalised; each comes with the shift of its timing.
    /// `recorded` holds the recorded ego. The rule must not depend on the ego's path.
    pub fn new(recorded: &Context, rule: &dyn Feasibility, proposals: Vec<(Proposal, f64)>) -> Self {
        let log_prob = |plan: &Proposal| plan.log_prob.unwrap_or(f64::NEG_INFINITY);
        let most = proposals.iter().map(|(plan, _)| log_prob(plan)).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = proposals.iter().map(|(plan, _)| (log_prob(plan) - most).exp()).collect();
        let mass: f64 = weights.iter().sum();
        let all = proposals.len();
        let plan = |((proposal, shift), weight): ((Proposal, f64), f64)| {
            let candidate = recorded.candidate(proposal.trajectory.clone());
            rule.is_feasible(&candidate, recorded).then(|| NominalPlan {
                probability: weight / mass,
                shift,
                is_clear: Encounter::of(&candidate, recorded.ego()).contact.is_none(),
                proposal,
            })
        };
        Self { plans: proposals.into_iter().zip(weights).filter_map(plan).collect(), all }
    }

    /// Probability of what is given.
    pub fn mass(&self, given: Given) -> f64 {
        self.of(given).map(|(_, plan)| plan.probability).sum()
    }

    /// The plans that are given, with their numbers.
    pub fn of(&self, given: Given) -> impl Iterator<Item = (usize, &NominalPlan)> {
        let plans = self.plans.iter().enumerate();
        plans.filter(move |(_, plan)| given == Given::Feasible || plan.is_clear)
    }

    /// Probabilities with which plans are driven, if there are so many drives: proportional to their own, larger for plans that meet
    /// the unattacked drive, whose context `ctx` is, and smaller for plans that do not meet the headline's condition.
    pub fn inclusions(&self, ctx: &Context, headline: Given, drives: usize) -> Vec<f64> {
        let weight = |plan: &NominalPlan| {
            // Where all are driven, none counts more.
            if drives >= self.plans.len() {
                return plan.probability;
            }
            let is_beside = headline == Given::ClearOfRecordedEgo && !plan.is_clear;
            let importance = importance(&ctx.candidate(plan.proposal.trajectory.clone()), ctx);
            plan.probability * (importance * if is_beside { BESIDE } else { 1.0 }).max(LEAST)
        };
        inclusions(&self.plans.iter().map(weight).collect::<Vec<_>>(), drives)
    }

    /// Drives a driver against plans, each with its probability of inclusion. `ctx` is that of the unattacked drive.
    ///
    /// *Errors*: every drive ends in an error of the driver.
    pub fn drive(
        &self,
        test: &AttackTest,
        ctx: &Context,
        rule: &dyn Feasibility,
        options: &SearchOptions,
        inclusions: &[f64],
        seed: u64,
    ) -> Result<Vec<Driven>, Error> {
        let start = Rng::new(seed, &ctx.scene().id, "rate").unit();
        let mut drives = PlanDrives::new(test, ctx, rule, options)?;
        let mut driven = Vec::new();
        for plan in self.sample(inclusions, start) {
            let evaluated = match drives.evaluate(plan, &self.plans[plan].proposal) {
                // The driver may do better against other plans.
                Err(error @ Error::Planner { .. }) => Some(Evaluated::failed(plan, error.to_string())),
                other => other?,
            };
            if let Some(evaluated) = evaluated {
                driven.push(Driven { plan, inclusion: inclusions[plan], evaluated });
            }
        }
        match driven
            .iter()
            .map(|driven| driven.evaluated.error.as_ref())
            .collect::<Option<Vec<_>>>()
            .as_deref()
        {
            Some([first, ..]) => Err(Error::Planner {
                scene: ctx.scene().id.clone(),
                step: None,
                is_late: false,
                problem: format!("every attacked drive ended in an error; the first: {first}"),
                log: PlannerLog::default(),
                drive: None,
            }),
            _ => Ok(driven),
        }
    }

    /// The plans that are driven for a start from 0 to 1, in their order: sums have the same bits, whatever the curve.
    pub fn sample(&self, inclusions: &[f64], start: f64) -> Vec<usize> {
        let ends: Vec<Point> = self.plans.iter().map(|plan| end(&plan.proposal)).collect();
        let mut chosen = systematic(&ends, inclusions, start);
        chosen.sort_unstable();
        chosen
    }

    /// Share of what is given that was not driven; 0 if nothing is given.
    pub fn undriven(&self, driven: &[Driven], given: Given) -> f64 {
        let mass = self.mass(given);
        let is_driven = |plan: usize| driven.iter().any(|driven| driven.plan == plan);
        let left = self.of(given).filter(|(plan, _)| !is_driven(*plan));
        let left: f64 = left.map(|(_, plan)| plan.probability).sum();
        if mass > 0.0 { left / mass } else { 0.0 }
    }

    /// The rate of an event; `None` if nothing is given.
    pub fn rate(&self, driven: &[Driven], given: Given, event: impl Fn(&Evaluated) -> bool) -> Option<Rate> {
        let mass = self.mass(given);
        if !(mass > 0.0) {
            return None;
        }
        let is_given = |driven: &&Driven| given == Given::Feasible || self.plans[driven.plan].is_clear;
        let probability = |driven: &Driven| self.plans[driven.plan].probability;
        let of = || driven.iter().filter(is_given);
        let happened = || of().filter(|driven| event(&driven.evaluated));
        // What a driver that fails to drive would have done is not known.
        let known: f64 = of().filter(|driven| driven.evaluated.error.is_none()).map(probability).sum();
        // An empty sum of floating-point numbers is -0.
        let sum = |parts: &mut dyn Iterator<Item = f64>| parts.fold(0.0, |sum, part| sum + part);
        let sure = sum(&mut happened().map(probability));
        let estimate = sum(&mut happened().map(|driven| probability(driven) / driven.inclusion));
        // The rate lies between these for sure; an estimate of few drives may not, and may be above 1.
        let [low, high] = [sure / mass, ((sure + (mass - known).max(0.0)) / mass).min(1.0)];
        Some(Rate { rate: estimate / mass, low, high })
    }
}

/// A drive against a nominal plan.
#[derive(Clone, Debug)]
pub struct Driven {
    /// Number of the plan.
    pub plan: usize,
    /// Probability with which it is driven.
    pub inclusion: f64,
    /// What the drive was found to be.
    pub evaluated: Evaluated,
}

/// The rate of an event in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// The estimate, without bias; exact if all plans were driven.
    pub rate: f64,
    /// Probability of the plans in whose drive it happened.
    pub low: f64,
    /// The same with all plans that were not driven.
    pub high: f64,
}

/// Where a plan ends.
fn end(plan: &Proposal) -> Point {
    plan.trajectory.points().last().copied().unwrap_or_default()
}
