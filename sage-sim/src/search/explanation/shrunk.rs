//! A failure with less of its difference from the recording.

use sage_core::{
    generator::Proposal,
    motion::Trajectory,
    objective::{Context, Feasibility, is_within_limits},
};
use serde::{Deserialize, Serialize};

use super::deviation::{blended, difference_of_accelerations, recorded};
use crate::search::{Clauses, Evaluated, Met, PoolPlan, Reason, evaluation::Evaluator};

/// The first share that is tried: most failures are on the edge of a clause.
const A_LITTLE_LESS: f64 = 0.99;
/// Bisections of the rest.
const BISECTIONS: usize = 5;

/// The smallest share of a plan's difference from the recording at which a bisection still finds a failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shrunk {
    /// Share of the difference; 1 is the plan itself.
    pub share: f64,
    /// Largest difference of the accelerations from the recording, mean over 0.5 s, m/s².
    pub acceleration: f64,
    /// The plan with this share.
    pub trajectory: Trajectory,
    /// First contact of the drive against it.
    pub contact: Option<Met>,
    /// Answers to the clauses in that drive.
    pub clauses: Clauses,
    /// How much less was no failure any more, as a share of the whole difference; `None` if the recording itself is next.
    pub less: Option<f64>,
    /// Why it was none.
    pub less_is: Option<Reason>,
}

/// A plan that was tried.
enum Tried {
    Fails(Trajectory, Box<Evaluated>),
    Passes(Reason),
}

/// Shrinks a failure: at most one drive and [`BISECTIONS`] more. `None` if the adversary is not recorded up to the contact. The
/// number of drives is added to `drives`.
pub(super) fn shrink(
    evaluator: &Evaluator,
    ctx: &Context,
    rule: &dyn Feasibility,
    plan: &PoolPlan,
    failure: &Evaluated,
    drives: &mut usize,
) -> Option<Shrunk> {
    let contact = usize::try_from(failure.contact.as_ref()?.step).ok()?;
    let recorded = recorded(ctx);
    let whole = plan.candidate.trajectory();
    let mut attempt = |share: f64| -> Option<Tried> {
        let trajectory = blended(whole, &recorded, share, contact)?;
        let candidate = ctx.candidate(trajectory.clone());
        if !(is_within_limits(candidate.profile()) && rule.is_feasible(&candidate, ctx)) {
            return Some(Tried::Passes(Reason::NoFeasiblePlan));
        }
        let proposal = Proposal::of(trajectory.clone());
        let plan = PoolPlan { proposal, source: 0, refined_from: None, candidate };
        *drives += 1;
        let evaluated = evaluator.driven(&plan);
        Some(match evaluated.missing(evaluator.requirement()) {
            Some(reason) => Tried::Passes(reason),
            None => Tried::Fails(trajectory, Box::new(evaluated)),
        })
    };
    let mut found = (1.0, whole.clone(), failure.clone());
    let (mut passes, mut why) = (0.0, None);
    let mut next = A_LITTLE_LESS;
    for _ in 0..=BISECTIONS {
        match attempt(next)? {
            Tried::Fails(trajectory, evaluated) => found = (next, trajectory, *evaluated),
            Tried::Passes(reason) => (passes, why) = (next, Some(reason)),
        }
        if passes >= A_LITTLE_LESS {
            break;
        }
        next = 0.5 * (found.0 + passes);
    }
    let (share, trajectory, evaluated) = found;
    let end = evaluated.contact.as_ref().and_then(|met| usize::try_from(met.step).ok()).unwrap_or(contact);
    Some(Shrunk {
        share,
        acceleration: difference_of_accelerations(&trajectory, &recorded[..end.min(recorded.len())]),
        trajectory,
        contact: evaluated.contact,
        clauses: evaluated.clauses,
        less: why.map(|_| ((share - passes) * 1e3).round() / 1e3),
        less_is: why,
    })
}
