//! How likely a driver fails in a scene, if the adversary moves as a *nominal* density of plans says.
//!
//! The density is finite: a motion prior gives each goal of the adversary a probability and a trajectory. The rate of an event is the
//! probability of the plans in whose drive it happens, conditioned on what is [`Given`]. With as many drives as plans it is exact;
//! with fewer it is an estimate without bias ([`systematic`]), between bounds that hold for sure.
//!
//! It is no accident rate. Scenes are chosen, nothing is per kilometre, and this traffic does not look out: it collides with recorded
//! egos more often than people did.

mod sampling;

use sage_core::{
    generator::Proposal,
    geometry::Point,
    objective::{Context, Encounter, Feasibility},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

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

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClearOfRecordedEgo => "clear-of-recorded-ego",
            Self::Feasible => "feasible",
        }
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
    /// The density of proposals with log-probabilities at a temperature: `p ∝ exp(log p / T)`. `recorded` holds the recorded ego. The
    /// rule must not depend on the ego's path.
    pub fn new(
        recorded: &Context,
        rule: &dyn Feasibility,
        proposals: Vec<Proposal>,
        temperature: f64,
    ) -> Self {
        let scaled = |plan: &Proposal| plan.log_prob.unwrap_or(f64::NEG_INFINITY) / temperature;
        let most = proposals.iter().map(scaled).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = proposals.iter().map(|plan| (scaled(plan) - most).exp()).collect();
        let mass: f64 = weights.iter().sum();
        let all = proposals.len();
        let plan = |(proposal, weight): (Proposal, f64)| {
            let candidate = recorded.candidate(proposal.trajectory.clone());
            rule.is_feasible(&candidate, recorded).then(|| NominalPlan {
                probability: weight / mass,
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

    /// Drives a driver against so many plans, likelier ones more often. `ctx` is that of the unattacked drive.
    ///
    /// *Errors*: every drive ends in an error of the driver.
    pub fn drive(
        &self,
        test: &AttackTest,
        ctx: &Context,
        rule: &dyn Feasibility,
        options: &SearchOptions,
        seed: u64,
    ) -> Result<Vec<Driven>, Error> {
        let probabilities: Vec<f64> = self.plans.iter().map(|plan| plan.probability).collect();
        let inclusions = inclusions(&probabilities, options.budget);
        let start = Rng::new(seed, &ctx.scene().id, "rate").unit();
        let mut drives = PlanDrives::new(test, ctx, rule, options)?;
        let mut driven = Vec::new();
        for plan in self.sample(&inclusions, start) {
            if let Some(evaluated) = drives.evaluate(plan, &self.plans[plan].proposal)? {
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
        // Bounds that no estimate may leave: it can be above 1 where few plans were driven.
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
