//! A generator of two parts: a proposer, whose input is the observation up to *now*, and a selector, which
//! may use the ego's path.

use std::marker::PhantomData;

use sage_core::{
    Error as CoreError,
    generator::{Attack, Generator, Knowledge, Observation, OperatingPoint, Proposer},
    objective::Context,
    registry::Entry,
};
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    Error, Facts, GeneratorInputs, GeneratorKind,
    selector::{Selector, SelectorKind},
};

/// A kind of proposer. Its value is its options; mark them `#[serde(default, deny_unknown_fields)]`.
pub trait ProposerKind: Default + Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Name of the generator.
    const NAME: &'static str;
    /// One-line description.
    const SUMMARY: &'static str;
    /// Origin: paper or publication.
    const SOURCE: &'static str;
    /// Whether proposals depend on the mixture of experts.
    const USES_MIXTURE: bool;
    /// Whether it needs a prior and experts.
    const NEEDS_EXPERTS: bool = true;
    /// Whether it proposes all goals. It is then an upper bound, and its attacks list only the selected
    /// candidate.
    const IS_EXHAUSTIVE: bool = false;

    /// Checks the ranges of the options.
    ///
    /// *Errors*: [`CoreError::Options`] with the option, its value and the range.
    fn check(&self) -> Result<(), CoreError> {
        Ok(())
    }

    /// The error of an option out of range, for [`ProposerKind::check`].
    fn refused(problem: String) -> CoreError {
        CoreError::Options { kind: "generator", name: Self::NAME, problem }
    }

    /// Builds the proposer.
    ///
    /// *Errors*: a missing input.
    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Proposer>, Error>;
}

/// A kind of generator: a proposer and a selector.
pub struct Pair<P, S> {
    proposer: P,
    selector: PhantomData<fn() -> S>,
}

impl<P: ProposerKind, S: SelectorKind> Entry<dyn GeneratorKind> for Pair<P, S> {
    const NAME: &'static str = P::NAME;
    const SUMMARY: &'static str = P::SUMMARY;
    const SOURCE: &'static str = P::SOURCE;
    type Options = P;

    fn build(proposer: P) -> Result<Box<dyn GeneratorKind>, String> {
        match proposer.check() {
            // The registry adds the name of the part to the error.
            Err(CoreError::Options { problem, .. }) => Err(problem),
            Err(other) => Err(other.to_string()),
            Ok(()) => Ok(Box::new(Self { proposer, selector: PhantomData })),
        }
    }
}

impl<P: ProposerKind, S: SelectorKind> GeneratorKind for Pair<P, S> {
    fn facts(&self) -> Facts {
        Facts {
            knows: Knowledge::NOW.and(S::KNOWS),
            depends_on_lambda: P::USES_MIXTURE,
            depends_on_mu: S::DEPENDS_ON_MU,
            needs_experts: P::NEEDS_EXPERTS,
            is_upper_bound: P::IS_EXHAUSTIVE,
        }
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, Error> {
        Ok(Box::new(ProposeAndSelect {
            proposer: self.proposer.build(inputs)?,
            selector: S::build(inputs),
            uses_mixture: P::USES_MIXTURE,
            lists_candidates: !P::IS_EXHAUSTIVE,
        }))
    }
}

struct ProposeAndSelect {
    proposer: Box<dyn Proposer>,
    selector: Box<dyn Selector>,
    uses_mixture: bool,
    lists_candidates: bool,
}

impl Generator for ProposeAndSelect {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, CoreError> {
        let prepared = self.proposer.prepare(&Observation::of(ctx.scene(), ctx.index())?)?;
        let mut attacks: Vec<Option<Attack>> = vec![None; at.len()];
        for first in 0..at.len() {
            if attacks[first].is_some() {
                continue;
            }
            // If only μ differs, the proposals are the same.
            let mixture = &at[first].mixture;
            let proposals = prepared.propose(mixture, seed)?;
            let is_alike = |k: &usize| !self.uses_mixture || at[*k].mixture == *mixture;
            let alike: Vec<usize> = (first..at.len()).filter(is_alike).collect();
            let mus: Vec<f64> = alike.iter().map(|k| at[*k].mu).collect();
            for (k, selection) in alike.into_iter().zip(self.selector.select_each(&proposals, ctx, &mus)?) {
                let (candidates, chosen) = if self.lists_candidates {
                    (proposals.clone(), selection.chosen)
                } else {
                    (vec![proposals[selection.chosen].clone()], 0)
                };
                attacks[k] = Some(Attack { candidates, chosen, note: selection.note });
            }
        }
        Ok(attacks.into_iter().flatten().collect())
    }
}
