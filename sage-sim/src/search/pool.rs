//! The plans that a search can drive against: feasible, and different from each other.

use sage_core::{
    generator::Proposal,
    objective::{Candidate, Context, Feasibility},
};
use serde::{Deserialize, Serialize};

/// Plans whose positions are this close at every step count as one, metres.
const SAME: f64 = 0.1;
/// Largest number of plans of a pool by default.
pub const MOST_PLANS: usize = 256;

/// A plan of the adversary.
#[derive(Clone)]
pub struct PoolPlan {
    /// The plan, with its negative log-likelihood under the prior if that is known.
    pub proposal: Proposal,
    /// Number of the source that proposed it, or the plan that it was refined from.
    pub source: usize,
    /// Number of the plan that it was refined from, if it was.
    pub refined_from: Option<usize>,
    /// The plan prepared for evaluation.
    pub candidate: Candidate,
}

/// How many plans were proposed, and what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PoolCounts {
    /// Plans of all sources.
    pub proposed: usize,
    /// Left out, because they are not feasible.
    pub infeasible: usize,
    /// Left out, because another plan is within 0.1 m at all steps.
    pub merged: usize,
    /// Left out, because the pool is full.
    pub beyond: usize,
}

/// The plans of a search, in a fixed order.
///
/// Simple plans in a `scene`, whose context is `ctx`:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{objective::{Context, ContextOptions}, scene::SceneIndex};
/// # use sage_data::procedural::{Kind, attacks, generate};
/// use sage_core::{generator::Proposal, objective::feasibilities};
/// use sage_sim::search::Pool;
///
/// # let scene = Arc::new(generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?);
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let plans: Vec<Proposal> = attacks(&scene).into_iter().map(|(_, plan)| Proposal::of(plan)).collect();
/// let rule = feasibilities()?.build_default("paper")?;
///
/// // A second source with the same plans adds none: what is within 0.1 m at all steps counts once.
/// let pool = Pool::new(&ctx, &*rule, vec![plans.clone(), plans.clone()], 256);
/// let counts = pool.counts;
/// assert_eq!(counts.proposed, 2 * plans.len());
/// assert_eq!(pool.plans.len() + counts.infeasible + counts.merged + counts.beyond, counts.proposed);
/// assert!(counts.merged >= pool.plans.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Pool {
    /// The plans.
    pub plans: Vec<PoolPlan>,
    /// Where the others went.
    pub counts: PoolCounts,
    /// Largest number of plans.
    most: usize,
}

impl Pool {
    /// The feasible plans of several sources, one source after the other taking its next, at most `most`. The rule must
    /// not depend on the ego's path.
    pub fn new(ctx: &Context, rule: &dyn Feasibility, sources: Vec<Vec<Proposal>>, most: usize) -> Self {
        let counts = PoolCounts { proposed: sources.iter().map(Vec::len).sum(), ..PoolCounts::default() };
        let mut pool = Self { plans: Vec::new(), counts, most };
        let mut sources: Vec<_> = sources.into_iter().map(Vec::into_iter).collect();
        loop {
            let mut is_empty = true;
            for (source, proposals) in sources.iter_mut().enumerate() {
                let Some(proposal) = proposals.next() else { continue };
                is_empty = false;
                pool.add(ctx, rule, proposal, source);
            }
            if is_empty {
                return pool;
            }
        }
    }

    /// Adds a plan unless it is infeasible or known, or the pool is full. Returns whether it was added.
    pub fn add(&mut self, ctx: &Context, rule: &dyn Feasibility, proposal: Proposal, source: usize) -> bool {
        if self.plans.len() >= self.most {
            self.counts.beyond += 1;
            return false;
        }
        let is_known = |plan: &PoolPlan| is_same(&plan.proposal, &proposal);
        if self.plans.iter().any(is_known) {
            self.counts.merged += 1;
            return false;
        }
        let candidate = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
        if !rule.is_feasible(&candidate, ctx) {
            self.counts.infeasible += 1;
            return false;
        }
        self.plans.push(PoolPlan { proposal, source, refined_from: None, candidate });
        true
    }

    /// Adds a feasible plan that was refined from another one, however full the pool is, and gives its number; `None` if it is known.
    pub(super) fn add_refined(&mut self, ctx: &Context, proposal: Proposal, parent: usize) -> Option<usize> {
        if self.plans.iter().any(|plan| is_same(&plan.proposal, &proposal)) {
            return None;
        }
        let candidate = ctx.candidate(proposal.trajectory.clone());
        let source = self.plans[parent].source;
        self.plans.push(PoolPlan { proposal, source, refined_from: Some(parent), candidate });
        Some(self.plans.len() - 1)
    }
}

/// Whether two plans are within 0.1 m at all steps.
fn is_same(a: &Proposal, b: &Proposal) -> bool {
    let is_near = |(a, b): (&[f64; 2], &[f64; 2])| {
        let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
        dx * dx + dy * dy <= SAME * SAME
    };
    // Plans differ most at the end, so it is compared first.
    a.trajectory.points().iter().zip(b.trajectory.points()).rev().all(is_near)
}
