//! How much it takes: the smallest λ from which a driver fails at the plan that is selected there.

use std::collections::HashMap;

use sage_core::{
    generator::Proposal,
    objective::{Context, Feasibility},
};

use super::{Evaluated, SearchOptions, evaluation::Evaluator, pool::PoolPlan};
use crate::{Error, attack_test::AttackTest};

/// Consecutive points at which a driver must fail.
const CONSECUTIVE: usize = 3;

/// Number of the first point from which the driver fails at three consecutive points, or at all up to the last.
pub fn threshold(fails: &[bool]) -> Option<usize> {
    let stays = |first: &usize| fails[*first..].iter().take(CONSECUTIVE).all(|fails| *fails);
    (0..fails.len()).find(stays)
}

/// Drives against each of some plans and answers the clauses; `None` for a plan that is not feasible. Equal plans are
/// driven once. `ctx` is that of the unattacked drive.
///
/// *Errors*: an error of the driver, or options of the search for evasive manoeuvres that are out of range.
pub fn evaluate_each(
    test: &AttackTest,
    ctx: &Context,
    rule: &dyn Feasibility,
    plans: &[Proposal],
    options: &SearchOptions,
) -> Result<Vec<Option<Evaluated>>, Error> {
    options.avoidable.check()?;
    let evaluator = Evaluator::new(test, ctx, options.require, options.avoidable);
    let mut known: HashMap<Vec<u64>, Option<Evaluated>> = HashMap::new();
    let mut all = Vec::with_capacity(plans.len());
    for (number, proposal) in plans.iter().enumerate() {
        let bits: Vec<u64> =
            proposal.trajectory.points().as_flattened().iter().map(|x| x.to_bits()).collect();
        if let Some(evaluated) = known.get(&bits) {
            all.push(evaluated.clone());
            continue;
        }
        let candidate = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
        let evaluated = if rule.is_feasible(&candidate, ctx) {
            let plan = PoolPlan { proposal: proposal.clone(), source: 0, candidate };
            let (outcome, path) = evaluator.drive(&plan)?;
            Some(evaluator.evaluate(number, &plan, &outcome, &path)?)
        } else {
            None
        };
        known.insert(bits, evaluated.clone());
        all.push(evaluated);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_needs_three_failures_or_all_up_to_the_end() {
        let of = |text: &str| threshold(&text.chars().map(|c| c == 'x').collect::<Vec<_>>());
        assert_eq!(of("..xx.xxx."), Some(5));
        assert_eq!(of("xxx......"), Some(0));
        assert_eq!(of("......xx."), None);
        assert_eq!(of(".......xx"), Some(7));
        assert_eq!(of("........x"), Some(8));
        assert_eq!(of("........."), None);
        assert_eq!(of(""), None);
    }
}
