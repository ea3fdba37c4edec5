//! Drives against one plan, and answers the clauses.

use std::{cell::OnceCell, collections::HashMap};

use sage_core::{
    generator::Proposal,
    geometry::Point,
    motion::{DT, NOW},
    objective::{Context, EgoPaths, Feasibility, PersonMet, Situation, drives_believably, is_believable_1},
};
use serde::{Deserialize, Serialize};

use super::{
    Circumstances, Clause, Clauses, Met, PoolPlan, Reason, Requirement, SearchOptions, Variation,
    holds::Variants, onset::onset,
};
use crate::{
    Error,
    attack_test::{AttackOutcome, AttackTest},
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
    drive::Drive,
    episode::{Episode, Progress},
    reference::{Answer, Watching},
    vehicle::{Motion, SUBSTEP, SUBSTEPS},
};

/// An attacked drive with the answers to the clauses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluated {
    /// Number of the plan in the pool.
    pub plan: usize,
    /// First contact; `None` without one, or if the driver gave an error.
    pub contact: Option<Met>,
    /// Answers to the clauses.
    pub clauses: Clauses,
    /// The paper's reward with the contact of the drive; 0 if the driver gave an error.
    pub reward: f64,
    /// Latest start of an evasive manoeuvre, seconds before the contact; `None` without one, or if it was not asked for.
    pub latest_start: Option<f64>,
    /// Seconds from the onset of the plan to the latest start; of a person, from when it is in sight and walks to the last full braking.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub human_time: Option<f64>,
    /// Latest start within the limits of UN R157's driver, asked if there is one at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latest_start_r157: Option<f64>,
    /// The reference drivers that were asked whether the contact is preventable.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<Answer>,
    /// The contact with a pedestrian or cyclist; `None` if the adversary is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub person: Option<PersonMet>,
    /// What becomes of the failure in each variant of the drive, if that was asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variations: Vec<Variation>,
    /// What went wrong, if the driver gave an error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

impl Evaluated {
    fn of(plan: usize) -> Self {
        Self {
            plan,
            contact: None,
            clauses: Clauses::default(),
            reward: 0.0,
            latest_start: None,
            human_time: None,
            latest_start_r157: None,
            references: Vec::new(),
            person: None,
            variations: Vec::new(),
            error: None,
        }
    }

    /// A drive that ended in an error of the driver.
    pub(crate) fn failed(plan: usize, error: String) -> Self {
        Self { error: Some(error), ..Self::of(plan) }
    }

    /// Why the drive is no failure; `None` if it is one.
    pub fn missing(&self, requirement: Requirement) -> Option<Reason> {
        if self.error.is_some() {
            return Some(Reason::Error);
        }
        let missing = self.clauses.first_missing(requirement)?;
        let is_never_hit = missing == Clause::Attack && self.contact.is_none();
        Some(if is_never_hit { Reason::NeverHit } else { Reason::missing(missing) })
    }
}

/// A time, which is a number of steps, without the error of its sums.
fn seconds(time: f64) -> f64 {
    (time * 1e3).round() / 1e3
}

/// Drives against plans of one scene.
pub(super) struct Evaluator<'t> {
    test: &'t AttackTest<'t>,
    /// The scene with the unattacked drive.
    ctx: &'t Context,
    /// The drive up to *now*, which all plans share; `None` for a driver that cannot be copied.
    until_now: Option<Progress>,
    requirement: Requirement,
    search: AvoidanceOptions,
    /// The reference drivers, once they are asked.
    watching: OnceCell<Watching<'t>>,
    /// The variants of the drive, once they are asked.
    variants: OnceCell<Variants>,
}

impl<'t> Evaluator<'t> {
    /// Drives up to *now*, unless the driver cannot be copied.
    pub(super) fn new(
        test: &'t AttackTest<'t>,
        ctx: &'t Context,
        requirement: Requirement,
        search: AvoidanceOptions,
    ) -> Self {
        let (watching, variants) = (OnceCell::new(), OnceCell::new());
        Self { test, ctx, until_now: test.until_now(), requirement, search, watching, variants }
    }

    /// Drives against a plan.
    ///
    /// *Errors*: as [`AttackTest::attack`].
    pub(super) fn drive(&self, plan: &PoolPlan) -> Result<(AttackOutcome, AttackedPath), Error> {
        let outcome = self.test.attack_from(self.until_now.as_ref(), plan.candidate.trajectory(), true)?;
        let path = AttackedPath::of(&outcome.episode, self.test.unattacked());
        Ok((outcome, path))
    }

    /// What makes a drive a failure.
    pub(super) fn requirement(&self) -> Requirement {
        self.requirement
    }

    /// Drives against a plan that is in no pool, and answers the clauses; an error is noted.
    pub(super) fn driven(&self, plan: &PoolPlan) -> Evaluated {
        let driven = self.drive(plan).and_then(|(outcome, path)| self.evaluate(0, plan, &outcome, &path));
        driven.unwrap_or_else(|error| Evaluated::failed(0, error.to_string()))
    }

    /// Answers the clauses for an attacked drive.
    ///
    /// *Errors*: [`sage_core::Error::Options`] for options of the search out of range.
    pub(super) fn evaluate(
        &self,
        number: usize,
        plan: &PoolPlan,
        outcome: &AttackOutcome,
        path: &AttackedPath,
    ) -> Result<Evaluated, Error> {
        let mut evaluated = Evaluated {
            contact: Met::first(outcome, self.test),
            clauses: Clauses { attack: outcome.verdict.attack, ..Clauses::default() },
            reward: outcome.reward(),
            ..Evaluated::of(number)
        };
        let Some(step) = evaluated.contact.as_ref().map(|met| met.step as usize) else {
            return Ok(evaluated);
        };
        if !outcome.verdict.attack {
            return Ok(evaluated);
        }
        let ctx = path.context(self.ctx)?;
        if ctx.adversary().kind.is_person() {
            let met = PersonMet::at(&plan.candidate, ctx.ego(), &ctx, step);
            evaluated.clauses.believable =
                Some(met.is_some_and(|met| met.doubts(&plan.candidate, &ctx).is_empty()));
            evaluated.clauses.strict = Some(met.is_some_and(|met| met.is_strict(&ctx.adversary().kind)));
            evaluated.person = met;
        } else {
            let situation = Situation::new(&plan.candidate, ctx.ego(), &ctx);
            let believable_1 = outcome.verdict.solid && is_believable_1(&situation);
            evaluated.clauses.believable_1 = Some(believable_1);
            evaluated.clauses.believable = Some(believable_1 && drives_believably(&situation));
        }
        evaluated.clauses.at_fault = Some(outcome.verdict.at_fault);
        let is_dear = |clause: &Clause| {
            matches!(clause, Clause::Avoidable | Clause::Preventable | Clause::Holds)
                || clause.asked_time().is_some()
        };
        let mut others = self.requirement.clauses().filter(|clause| !is_dear(clause));
        if !others.all(|clause| evaluated.clauses.holds(clause)) {
            return Ok(evaluated);
        }
        let asks_time = self.requirement.clauses().any(|clause| clause.asked_time().is_some());
        if asks_time
            || [Clause::Avoidable, Clause::Preventable].into_iter().any(|c| self.requirement.holds(c))
        {
            let avoidance = Avoidance::new(&ctx, self.search)?;
            let time = avoidance.latest_start(&plan.candidate, step);
            evaluated.clauses.avoidable = Some(time.is_some());
            evaluated.latest_start = time;
            let human = match &evaluated.person {
                Some(met) => {
                    let brake = avoidance.latest_brake(&plan.candidate, step);
                    brake.map(|brake| met.noticeable_for() - brake)
                }
                None => time.map(|time| step as f64 * DT - time - onset(&plan.candidate, &ctx, step)),
            };
            evaluated.human_time = human.map(seconds);
            let has = |clause: Clause| {
                let is_asked = evaluated.person.is_some() || self.requirement.holds(clause);
                let time = clause.asked_time().filter(|_| is_asked)?;
                Some(evaluated.human_time.is_some_and(|human| human >= time))
            };
            evaluated.clauses.human_time = has(Clause::HumanTime);
            evaluated.clauses.human_time_r157 = has(Clause::HumanTimeR157);
            // The regulation's model is of vehicles.
            if time.is_some() && evaluated.person.is_none() {
                let r157 = Avoidance::new(&ctx, AvoidanceOptions::r157())?;
                evaluated.latest_start_r157 = r157.latest_start(&plan.candidate, step);
            }
        }
        if self.requirement.holds(Clause::Preventable) {
            let prevention = self.watching()?.prevention(plan.candidate.trajectory())?;
            evaluated.clauses.preventable = Some(prevention.by().is_some());
            evaluated.references = prevention.answers;
        }
        if self.requirement.holds(Clause::Holds) && evaluated.clauses.meet(self.requirement.without_holds()) {
            evaluated.variations = self.variations(plan)?;
            let holds = evaluated.variations.iter().all(|variation| variation.missing.is_none());
            evaluated.clauses.holds = Some(holds);
        }
        Ok(evaluated)
    }

    /// What becomes of a failure in each variant of the drive.
    fn variations(&self, plan: &PoolPlan) -> Result<Vec<Variation>, Error> {
        let requirement = self.requirement.without_holds();
        let tests = self.variants()?.tests(self.test);
        let variation = |(name, varied): (&str, Option<(AttackTest, &Context)>)| {
            let missing = match varied {
                Some((test, ctx)) => {
                    let evaluator = Evaluator::new(&test, ctx, requirement, self.search);
                    evaluator.driven(plan).missing(requirement)
                }
                None => Some(Reason::Error),
            };
            Variation { variant: name.to_owned(), missing }
        };
        Ok(tests.map(variation).collect())
    }

    fn variants(&self) -> Result<&Variants, Error> {
        if let Some(variants) = self.variants.get() {
            return Ok(variants);
        }
        let variants = Variants::new(self.test)?;
        Ok(self.variants.get_or_init(|| variants))
    }

    fn watching(&self) -> Result<&Watching<'t>, Error> {
        if let Some(watching) = self.watching.get() {
            return Ok(watching);
        }
        let watching = self.test.watching()?;
        Ok(self.watching.get_or_init(|| watching))
    }

    /// What describes a failure: the search for an evasive manoeuvre, with its witness, and the circumstances.
    ///
    /// *Errors*: as [`Evaluator::evaluate`].
    pub(super) fn describe(
        &self,
        plan: &PoolPlan,
        met: Option<&Met>,
        path: &AttackedPath,
    ) -> Result<(Avoidable, Option<Circumstances>), Error> {
        let ctx = path.context(self.ctx)?;
        let step = met.and_then(|met| usize::try_from(met.step).ok());
        let avoidable = Avoidance::new(&ctx, self.search)?.of_contact(&plan.candidate, step);
        // Lights, lines and the right of way of lanes are those of cars.
        let met = met.filter(|_| !ctx.adversary().kind.is_person());
        Ok((avoidable, met.and_then(|met| Circumstances::of(&ctx, &plan.candidate, met))))
    }
}

/// Drives a driver against given plans of one scene.
pub struct PlanDrives<'t> {
    evaluator: Evaluator<'t>,
    rule: &'t dyn Feasibility,
    /// Equal plans are driven once.
    known: HashMap<Vec<u64>, Option<Evaluated>>,
}

impl<'t> PlanDrives<'t> {
    /// `ctx` is that of the unattacked drive.
    ///
    /// *Errors*: options of the search for evasive manoeuvres that are out of range.
    pub fn new(
        test: &'t AttackTest<'t>,
        ctx: &'t Context,
        rule: &'t dyn Feasibility,
        options: &SearchOptions,
    ) -> Result<Self, Error> {
        options.avoidable.check()?;
        let evaluator = Evaluator::new(test, ctx, options.require, options.avoidable);
        Ok(Self { evaluator, rule, known: HashMap::new() })
    }

    /// Drives against a plan and answers the clauses; `None` for a plan that is not feasible.
    ///
    /// *Errors*: an error of the driver.
    pub fn evaluate(&mut self, number: usize, proposal: &Proposal) -> Result<Option<Evaluated>, Error> {
        let bits: Vec<u64> =
            proposal.trajectory.points().as_flattened().iter().map(|x| x.to_bits()).collect();
        if let Some(evaluated) = self.known.get(&bits) {
            return Ok(evaluated.clone());
        }
        let ctx = self.evaluator.ctx;
        let candidate = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
        let evaluated = if self.rule.is_feasible(&candidate, ctx) {
            let plan = PoolPlan { proposal: proposal.clone(), source: 0, refined_from: None, candidate };
            let (outcome, path) = self.evaluator.drive(&plan)?;
            Some(self.evaluator.evaluate(number, &plan, &outcome, &path)?)
        } else {
            None
        };
        self.known.insert(bits, evaluated.clone());
        Ok(evaluated)
    }
}

/// The ego's path in an attacked drive: as driven up to the contact, then straight on at constant velocity. A policy that
/// sets the poses of the car goes on along its own drive.
#[derive(Clone, Debug, PartialEq)]
pub struct AttackedPath {
    /// Box centre and heading at frames 0 to *now*, as driven.
    pub history: Vec<[f64; 3]>,
    /// Box centre at steps 1 to 80, metres, world frame; shorter if the recording is.
    pub positions: Vec<Point>,
    /// Heading at each, rad.
    pub headings: Vec<f64>,
}

impl AttackedPath {
    /// The path of a drive; `unattacked` is the driver's drive without the attack.
    pub fn of(episode: &Episode, unattacked: &Drive) -> Self {
        let frames = unattacked.motions.len();
        let contact = episode.contacts.first().map(|contact| &contact.contact);
        let motions = if episode.is_posed { &unattacked.motions } else { &episode.drive.motions };
        let end = contact.filter(|_| !episode.is_posed).map_or(motions.len(), |contact| contact.step);
        let pose = |motion: &Motion| [motion.position[0], motion.position[1], motion.heading];
        let history = motions.iter().take(NOW + 1).map(pose).collect();
        let driven = motions.get(NOW + 1..end.max(NOW + 1)).unwrap_or_default();
        let mut positions: Vec<Point> = driven.iter().map(|motion| motion.position).collect();
        let mut headings: Vec<f64> = driven.iter().map(|motion| motion.heading).collect();
        if let Some(contact) = contact.filter(|_| !episode.is_posed) {
            let ([x, y], [vx, vy]) = (contact.areas[0].center, contact.velocities[0]);
            let axis = contact.areas[0].axis;
            for frame in end.max(NOW + 1)..frames {
                let time = (frame - contact.step) as f64 * DT
                    + SUBSTEP * (SUBSTEPS - contact.substep.min(SUBSTEPS)) as f64;
                positions.push([x + time * vx, y + time * vy]);
                headings.push(axis[1].atan2(axis[0]));
            }
        }
        Self { history, positions, headings }
    }

    /// A context with this path in place of the ego's.
    ///
    /// *Errors*: an empty path, or one with too long a step.
    pub fn context(&self, ctx: &Context) -> Result<Context, sage_core::Error> {
        ctx.with_ego(&self.ego(ctx.horizon())?)
    }

    /// The path as one of a context, up to its horizon.
    fn ego(&self, horizon: usize) -> Result<EgoPaths, sage_core::Error> {
        let count = self.positions.len().min(horizon);
        EgoPaths::one(
            "the attacked drive",
            self.positions[..count].to_vec(),
            Some(self.headings[..count].to_vec()),
        )
    }
}
