//! The row of a rate: a driver in a scene.

use std::{collections::BTreeMap, path::Path};

use sage_core::{files, geometry::Point, motion::Trajectory};
use sage_sim::{
    attack_test::AttackTest,
    rate::{Driven, Event, Given, Nominal, Rate},
    search::{Clauses, Met, Requirement},
};
use serde::{Deserialize, Serialize};

use super::{ROW_LIMIT, contact::step, search::RowHead};
use crate::rate::NamedRate;

/// The row of a driver in a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RateRow {
    /// What every row begins with.
    #[serde(flatten)]
    pub head: RowHead,
    /// What makes a failure.
    pub require: Requirement,
    /// What the headline is conditioned on.
    pub given: Given,
    /// Temperature of the nominal density.
    pub temperature: f64,
    /// Shifts of the timings of a goal, metres.
    pub shifts: Vec<f64>,
    /// Whether the adversary looks out.
    pub aware: bool,
    /// Number of all plans of the density.
    pub plans: usize,
    /// Number of the feasible ones.
    pub feasible_plans: usize,
    /// Number of drives.
    pub drives: usize,
    /// Number of drives that ended in an error of the driver; what they would have been is in the bounds.
    pub errors: usize,
    /// Files beside this one.
    pub files: Vec<String>,
    /// Probability of what is given, among all plans.
    pub mass: BTreeMap<Given, f64>,
    /// Share of it that was not driven.
    pub undriven: BTreeMap<Given, f64>,
    /// Rates of the events; empty for a condition that no plan meets.
    pub rates: BTreeMap<Given, BTreeMap<String, Rate>>,
    /// Step of the first contact of the unattacked drive.
    pub unattacked_contact: Option<i64>,
    /// Whether the driver is at fault in it.
    pub unattacked_at_fault: bool,
    /// The likeliest failure that was driven and meets the headline's condition.
    pub likeliest: Option<LikeliestFailure>,
    /// All feasible plans, in their order.
    pub goals: Vec<GoalRow>,
}

/// The likeliest failure of a driver in a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LikeliestFailure {
    /// Its probability under the headline's condition.
    pub probability: f64,
    /// Whether the plan does not touch the recorded ego.
    pub is_clear: bool,
    /// The plan.
    pub trajectory: Trajectory,
    /// Its contact.
    pub contact: Option<Met>,
    /// Its clauses.
    pub clauses: Clauses,
}

/// A plan of the density.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct GoalRow {
    /// Its goal, metres, world frame.
    pub goal: Option<Point>,
    /// How far its timing is shifted from that of the goal's trajectory, metres.
    pub shift: f64,
    /// Its probability among all plans.
    pub probability: f64,
    /// Whether it does not touch the recorded ego.
    pub is_clear: bool,
    /// Probability with which it is driven.
    pub inclusion: f64,
    /// Whether the drive has a contact with the adversary, an attack, a failure; none if it was not driven.
    pub outcome: Option<Outcome>,
}

/// What came of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// No contact with the adversary.
    NoContact,
    /// A contact that is no attack.
    Contact,
    /// An attack that is no failure.
    Attack,
    /// A failure.
    Failure,
}

/// What a rate is of.
pub struct RateOf<'a> {
    /// The density.
    pub nominal: &'a Nominal,
    /// What measures the rate.
    pub rate: &'a NamedRate,
    /// Probability with which each plan is driven.
    pub inclusions: &'a [f64],
    /// The drives.
    pub driven: &'a [Driven],
    /// The events.
    pub events: &'a [Event],
}

impl RateRow {
    /// The row of a driver in a scene.
    pub fn new(head: RowHead, of: &RateOf, test: &AttackTest) -> Self {
        let RateOf { nominal, driven, .. } = *of;
        let (require, headline) = (of.rate.spec.require, of.rate.spec.given);
        let mass: BTreeMap<Given, f64> = Given::ALL.map(|given| (given, nominal.mass(given))).into();
        let is_driven = |plan: usize| driven.iter().find(|driven| driven.plan == plan);
        let undriven = Given::ALL.map(|given| (given, nominal.undriven(driven, given)));
        let rates = Given::ALL.map(|given| {
            let rate = |event: &Event| {
                let rate = nominal.rate(driven, given, |driven| event.happens(driven, require));
                rate.map(|rate| (event.name().to_owned(), rate))
            };
            (given, of.events.iter().filter_map(rate).collect())
        });
        let is_given = |driven: &&Driven| headline == Given::Feasible || nominal.plans[driven.plan].is_clear;
        let failures = driven.iter().filter(is_given);
        let failures = failures.filter(|driven| Event::Failure.happens(&driven.evaluated, require));
        let likelier =
            |a: &Driven, b: &Driven| nominal.plans[b.plan].probability > nominal.plans[a.plan].probability;
        let likeliest = failures.reduce(|best, other| if likelier(best, other) { other } else { best });
        let goals = nominal.plans.iter().enumerate().map(|(k, plan)| {
            let driven = is_driven(k);
            GoalRow {
                goal: plan.proposal.goal,
                shift: plan.shift,
                probability: plan.probability,
                is_clear: plan.is_clear,
                inclusion: of.inclusions[k],
                outcome: driven.map(|driven| Outcome::of(driven, require)),
            }
        });
        Self {
            require,
            given: headline,
            temperature: of.rate.density.temperature,
            shifts: of.rate.density.shifts.clone(),
            aware: of.rate.density.is_aware,
            plans: nominal.all,
            feasible_plans: nominal.plans.len(),
            drives: driven.len(),
            errors: driven.iter().filter(|driven| driven.evaluated.error.is_some()).count(),
            files: Vec::new(),
            undriven: undriven.into(),
            rates: rates.into(),
            unattacked_contact: test.unattacked().contacts.first().map(|contact| step(contact.step)),
            unattacked_at_fault: test.unattacked_drive().is_at_fault(),
            likeliest: likeliest.map(|driven| {
                let plan = &nominal.plans[driven.plan];
                LikeliestFailure {
                    probability: plan.probability / mass[&headline],
                    is_clear: plan.is_clear,
                    trajectory: plan.proposal.trajectory.clone(),
                    contact: driven.evaluated.contact.clone(),
                    clauses: driven.evaluated.clauses,
                }
            }),
            goals: goals.collect(),
            mass,
            head,
        }
    }

    /// Reads a row; `None` if it is none.
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// The rate of an event.
    pub fn rate(&self, given: Given, event: &str) -> Option<Rate> {
        self.rates.get(&given)?.get(event).copied()
    }

    /// The printed line.
    pub fn line(&self) -> String {
        let percent = |x: f64| format!("{:.2}", 100.0 * x);
        let of = |given| {
            self.rate(given, "failure").map_or("no plan".to_owned(), |rate| percent(rate.rate) + " %")
        };
        let other = self.given.other();
        let bounds = match self.rate(self.given, "failure").filter(|rate| rate.high > rate.low) {
            Some(rate) => format!(" ({} to {} for sure)", percent(rate.low), percent(rate.high)),
            None => String::new(),
        };
        let errors = match self.errors {
            0 => String::new(),
            count => format!(", {count} with an error"),
        };
        format!(
            "{} {}: failure {}{bounds}; {other} {}; {} of {} driven{errors}",
            self.head.scene,
            self.head.ego,
            of(self.given),
            of(other),
            self.drives,
            self.feasible_plans
        )
    }
}

impl Outcome {
    fn of(driven: &Driven, require: Requirement) -> Self {
        let evaluated = &driven.evaluated;
        if Event::Failure.happens(evaluated, require) {
            Self::Failure
        } else if evaluated.clauses.attack {
            Self::Attack
        } else if Event::Contact.happens(evaluated, require) {
            Self::Contact
        } else {
            Self::NoContact
        }
    }
}
