//! Plans that the pool does not hold: a driven plan, refined against the path that the driver took.
//!
//! The parent is the drive that met the most clauses, or came nearest, less what it was used before. Its ego path is frozen, and an
//! evolution strategy over deformations of the plan ([`sage_core::deformation`]) maximises the objective `natural` at μ = 1, with
//! bonuses for what makes a failure: a believable contact, a moving ego whose front meets the adversary, time from the onset on, and
//! nearness to the parent's plan, because the driver does the same only as long as it sees the same. What comes out is driven
//! like any other plan; the reference drivers are asked only then.

use sage_core::{
    Error as CoreError,
    deformation::{Deformable, Evolution, LEAST_GAIN},
    generator::Proposal,
    geometry::{distance, norm},
    motion::DT,
    objective::{
        Candidate, Context, Evaluation, Feasibility, Objective, ObjectiveSpec, feasibilities,
        is_within_limits, rewards,
    },
    seed::Rng,
};

use super::{
    AttackedPath, Clause, Evaluated, Pool, PoolPlan, SearchOptions,
    onset::{REACTION, onset},
};

/// The objective that rates a plan against a path of the ego.
const NATURAL: &str = "natural";
/// Tries of a refinement.
const TRIES: usize = 100;
/// Refinements for each drive of the budget.
const TRIES_A_DRIVE: usize = 4;
/// Value of a believable contact, of an ego that moves, and of its front meeting the adversary.
const BONUS: f64 = 3.0;
/// Speed from which the ego moves, m/s.
const MOVING: f64 = 0.5;
/// Value of as much time from the onset to the contact as a person needs to react and to brake.
const REACTS: f64 = 1.0;
/// Seconds for it.
const TIME: f64 = REACTION + 1.0;
/// Cost of the mean distance to the parent's plan up to the contact, 1/m.
const FAR: f64 = 0.3;
/// How much a parent's rank falls with each use.
const USED: f64 = 0.7;
/// Distance without contact that costs a parent one rank, metres.
const NEAR: f64 = 10.0;

/// What refines plans of a search in one scene.
pub(super) struct Refiner {
    objective: Objective,
    rng: Rng,
    /// Number of drives from which on it refines.
    from: usize,
    /// Refinements that are left: not each finds a plan.
    left: usize,
    parents: Vec<Parent>,
}

/// A drive whose plan can be refined.
struct Parent {
    /// Number of its plan in the pool.
    plan: usize,
    path: AttackedPath,
    rank: f64,
    had_contact: bool,
}

impl Refiner {
    /// Refines in a scene, with random numbers of a seed; `None` if the options ask for none.
    ///
    /// *Errors*: none; the objective is one of the shipped ones.
    pub(super) fn new(ctx: &Context, options: &SearchOptions, seed: u64) -> Result<Option<Self>, CoreError> {
        let Some(from) = options.refined_from() else { return Ok(None) };
        let spec = ObjectiveSpec::preset(NATURAL).ok_or(CoreError::Unknown {
            kind: "objective",
            name: NATURAL.to_owned(),
            known: Vec::new(),
        })?;
        let objective = Objective::new(&spec, &rewards()?, &feasibilities()?)?;
        let rng = Rng::new(seed, &ctx.scene().id, "refinement");
        Ok(Some(Self { objective, rng, from, left: TRIES_A_DRIVE * options.budget, parents: Vec::new() }))
    }

    /// Takes notice of a drive.
    pub(super) fn see_drive(&mut self, plan: &PoolPlan, driven: &Evaluated, path: &AttackedPath) {
        let had_contact = driven.contact.is_some();
        let met = Clause::ALL.into_iter().filter(|clause| driven.clauses.reach(*clause)).count();
        let rank = if met > 0 { 1.0 + met as f64 } else { -least_distance(&plan.candidate, path) / NEAR };
        self.parents.push(Parent { plan: driven.plan, path: path.clone(), rank, had_contact });
    }

    /// Whether the next plan is a refined one, after so many drives; the pool may have no plan left.
    pub(super) fn is_due(&self, driven: usize, is_empty: bool) -> bool {
        self.left > 0 && (is_empty || driven >= self.from)
    }

    /// Adds a refined plan to the pool and gives its number; `None` if none was found, or it is known.
    pub(super) fn refine(&mut self, pool: &mut Pool, rule: &dyn Feasibility, ctx: &Context) -> Option<usize> {
        self.left -= 1;
        let (parent, plan) = self.next(&pool.plans, rule, ctx)?;
        pool.add_refined(ctx, plan, parent)
    }

    /// A new plan from the best parent, with the number of the parent's plan; `None` if no try is better than the parent's plan, or
    /// the driver's path is none that a plan can be held against.
    fn next(
        &mut self,
        plans: &[PoolPlan],
        rule: &dyn Feasibility,
        ctx: &Context,
    ) -> Option<(usize, Proposal)> {
        let best = (0..self.parents.len()).reduce(|best, other| {
            if self.parents[other].rank > self.parents[best].rank { other } else { best }
        });
        let best = best?;
        let Self { objective, rng, parents, .. } = self;
        let parent = &mut parents[best];
        parent.rank -= USED;
        let ctx = parent.path.context(ctx).ok()?;
        let plan = &plans[parent.plan].candidate;
        let value = |candidate: &Candidate, evaluation: &Evaluation| {
            objective.value(evaluation, 1.0) + bonus(candidate, evaluation, &ctx)
                - FAR * distance_up_to_contact(candidate, plan, evaluation)
        };
        let own = objective.evaluate(plan, &ctx);
        // A parent with a contact failed to be a failure: any other plan is as good.
        let mut most = if parent.had_contact { f64::NEG_INFINITY } else { value(plan, &own) };
        let mut found = None;
        let mut evolution = Evolution::new(Deformable::new(plan.trajectory(), plan.start()));
        evolution.run(TRIES, rng, |deformed| {
            let candidate = ctx.candidate(deformed);
            if !is_within_limits(candidate.profile()) {
                return false;
            }
            let least = most - 3.0 * BONUS - REACTS;
            let Some(evaluation) = objective.evaluate_above(least, &candidate, &ctx, 1.0) else {
                return false;
            };
            let value = value(&candidate, &evaluation);
            let is_better = value > most + LEAST_GAIN && rule.is_feasible(&candidate, &ctx);
            if is_better {
                most = value;
                found = Some(candidate.into_trajectory());
            }
            is_better
        });
        found.map(|trajectory| (parent.plan, Proposal::of(trajectory)))
    }
}

/// What a contact on paper is worth besides the objective.
fn bonus(candidate: &Candidate, evaluation: &Evaluation, ctx: &Context) -> f64 {
    let Some(step) = evaluation.contact else { return 0.0 };
    let believable = if evaluation.is_believable { BONUS } else { 0.0 };
    let time = step as f64 * DT - onset(candidate, ctx, step);
    let reacts = REACTS * (time / TIME).min(1.0);
    let is_moving = ctx.ego().velocity(step).is_some_and(|velocity| norm(velocity) > MOVING);
    let fault = match ctx.ego().box_at(step).filter(|_| is_moving) {
        None => 0.0,
        Some(ego) => {
            let [front_left, .., front_right] = ego.corners();
            let by_front = candidate.boxes()[step - 1].intersects_segment(front_left, front_right);
            if by_front { 2.0 * BONUS } else { BONUS }
        }
    };
    believable + reacts + fault
}

/// Mean distance of two plans up to the contact of the first, metres.
fn distance_up_to_contact(plan: &Candidate, other: &Candidate, evaluation: &Evaluation) -> f64 {
    let steps = evaluation.contact.unwrap_or(plan.horizon());
    let pairs = plan.points().iter().zip(other.points()).take(steps);
    pairs.map(|(a, b)| distance(*a, *b)).sum::<f64>() / steps as f64
}

/// Least distance of the centres of a plan and a path of the ego, metres.
fn least_distance(plan: &Candidate, path: &AttackedPath) -> f64 {
    let pairs = plan.points().iter().zip(&path.positions);
    pairs.map(|(a, b)| distance(*a, *b)).fold(f64::INFINITY, f64::min)
}
