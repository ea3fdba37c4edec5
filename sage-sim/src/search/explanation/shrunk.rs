//! A failure with less of its difference from the recording.

use sage_core::{
    generator::Proposal,
    motion::Trajectory,
    objective::{Context, Feasibility, is_within_limits},
};
use serde::{Deserialize, Serialize};

use super::deviation::{blended, difference_of_accelerations, recorded};
use crate::search::{Clauses, Evaluated, Met, PoolPlan, Reason, evaluation::Evaluator};

/// The shares that are tried until one fails: most failures are on the edge of a clause, but much less of them may be one again.
const SHARES: [f64; 4] = [0.99, 0.8, 0.6, 0.4];
/// Most shares that are tried, bisections below the one that fails included.
const MOST_TRIED: usize = 6;

/// The smallest share of a plan's difference from the recording at which a failure was found.
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
    /// How much less was no failure, as a share of the whole difference; `None` if the recording itself is next.
    pub less: Option<f64>,
    /// Why it was none.
    pub less_is: Option<Reason>,
}

/// A plan that was tried.
enum Tried {
    Fails(Trajectory, Box<Evaluated>),
    Passes(Reason),
}

/// Shrinks a failure in at most [`MOST_TRIED`] drives. `None` if the adversary is not recorded up to the contact. The
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
    // The largest smaller share that is no failure.
    let (mut passes, mut why) = (0.0, None);
    for tried in 0..MOST_TRIED {
        let next = match SHARES.get(tried) {
            _ if found.0 < 1.0 => 0.5 * (found.0 + passes),
            Some(share) => *share,
            None => break,
        };
        match attempt(next)? {
            Tried::Fails(trajectory, evaluated) => {
                found = (next, trajectory, *evaluated);
                if passes > next {
                    (passes, why) = (0.0, None);
                }
            }
            Tried::Passes(reason) if next > passes => (passes, why) = (next, Some(reason)),
            Tried::Passes(_) => {}
        }
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
