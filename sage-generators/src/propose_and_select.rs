//! A generator of two parts: a proposer, whose input is the observation up to *now*, and a selector, which
//! may use the ego's path.

use sage_core::{
    Error,
    generator::{Attack, Generator, Observation, OperatingPoint, Proposer},
    objective::Context,
};

use crate::{Facts, selector::Selector};

/// Selects among the proposals of a proposer.
pub struct ProposeAndSelect {
    /// Proposes trajectories.
    pub proposer: Box<dyn Proposer>,
    /// Selects one of them.
    pub selector: Box<dyn Selector>,
    /// Properties of both. Proposals are made once for equal mixtures, or once if they depend on none; the attacks of an
    /// upper bound list only the selected candidate.
    pub facts: Facts,
}

impl Generator for ProposeAndSelect {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let prepared = self.proposer.prepare(&Observation::of(ctx.scene(), ctx.index())?)?;
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
            for (k, selection) in alike.into_iter().zip(self.selector.select_each(&proposals, ctx, &mus)?) {
                let (candidates, chosen) = if self.facts.is_upper_bound {
                    (vec![proposals[selection.chosen].clone()], 0)
                } else {
                    (proposals.clone(), selection.chosen)
                };
                attacks[k] = Some(Attack::of(candidates, chosen, selection.note));
            }
        }
        Ok(attacks.into_iter().flatten().collect())
    }
}
