//! A generator of two parts: a proposer, whose input is the observation up to *now*, and a selector, which
//! may use the ego's path.

use sage_core::{
    Error,
    generator::{Attack, Generator, Observation, OperatingPoint, PreparedProposer, Proposal, Proposer},
    objective::Context,
};

use crate::{
    Facts, Refinement,
    selector::{Choice, Selector},
};

/// Selects among the proposals of a proposer.
pub struct ProposeAndSelect {
    /// Proposes trajectories.
    pub proposer: Box<dyn Proposer>,
    /// Selects one of them.
    pub selector: Box<dyn Selector>,
    /// Refines what is selected, if asked for: the refined plan is a further candidate.
    pub refinement: Option<Refinement>,
    /// Properties of both. Proposals are made once for equal mixtures, or once if they depend on none; the attacks of an
    /// upper bound list only the selected candidate.
    pub facts: Facts,
}

impl Generator for ProposeAndSelect {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let prepared = self.proposer.prepare(&Observation::of(ctx.scene(), ctx.index())?)?;
        self.attacks_prepared(&*prepared, ctx, at, seed)
    }

    fn prepare(&self, ctx: &Context) -> Result<Option<Box<dyn PreparedProposer>>, Error> {
        self.proposer.prepare(&Observation::of(ctx.scene(), ctx.index())?).map(Some)
    }

    fn attacks_prepared(
        &self,
        prepared: &dyn PreparedProposer,
        ctx: &Context,
        at: &[OperatingPoint],
        seed: u64,
    ) -> Result<Vec<Attack>, Error> {
        let mut attacks: Vec<Option<Attack>> = vec![None; at.len()];
        for first in 0..at.len() {
            if attacks[first].is_some() {
                continue;
            }
            // If only μ differs, the proposals are the same.
            let mixture = &at[first].mixture;
            let proposals = prepared.propose(mixture, seed)?;
            let is_alike = |k: &usize| !self.facts.depends_on_lambda || at[*k].mixture == *mixture;
            let alike: Vec<usize> = (first..at.len()).filter(is_alike).collect();
            let mus: Vec<f64> = alike.iter().map(|k| at[*k].mu).collect();
            let selections = self.selector.select_each(&proposals, ctx, &mus)?;
            let refinement = self.refinement.as_ref();
            let refinement =
                refinement.map(|refinement| (refinement, refinement.evaluations(&proposals, ctx)));
            for (k, selection) in alike.into_iter().zip(selections) {
                let refined = refinement.as_ref().and_then(|(refinement, evaluations)| {
                    refinement.refined(&proposals, evaluations, &selection, ctx, at[k].mu, seed)
                });
                let Choice { chosen, note } = selection;
                attacks[k] = Some(match refined {
                    _ if self.facts.is_upper_bound => Attack::of(vec![proposals[chosen].clone()], 0, note),
                    None => Attack::of(proposals.clone(), chosen, note),
                    Some(refined) => {
                        let candidates: Vec<Proposal> = proposals.iter().cloned().chain([refined]).collect();
                        // It is feasible, whatever the note of the first choice says.
                        Attack::of(candidates, proposals.len(), None)
                    }
                });
            }
        }
        Ok(attacks.into_iter().flatten().collect())
    }
}
