//! Random goals at random speed profiles: the effect of search alone.

use std::sync::Arc;

use sage_backbones::{Backbone, backbone::trajectories_in_world, encoding::Encoding};
use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    objective::Body,
    registry::Entry,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::{Draw, check_candidates, encoded, goal, in_scene, nll};
use crate::{
    Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, Refinement, Rounds,
    drivable::drivable,
    selector::Best,
    speed_profile::{Extended, speed_profiles},
};

/// Options of random goals.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomGoals {
    /// Number of candidates; 48 by default, or 32 with a network that sees road boundaries alone.
    pub candidates: Option<usize>,
    /// Rounds of the refinement of the selected plan, such as `[[16, 8], [4, 25], [1, 100]]`: plans, and tries for each.
    pub refine: Option<Rounds>,
}

impl Entry<dyn GeneratorKind> for RandomGoals {
    const NAME: &'static str = "random";
    const SUMMARY: &'static str = "random goals with the same selection";
    const SOURCE: &'static str = "this project: the effect of search alone";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        check_candidates(options.candidates)?;
        options.refine.as_ref().map_or(Ok(()), Rounds::check)?;
        Ok(Box::new(options))
    }
}

impl GeneratorKind for RandomGoals {
    fn facts(&self) -> Facts {
        Best::FACTS
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let (prior, with_nll) = (inputs.prior(Self::NAME)?, inputs.selection.needs_prior());
        let proposer = Box::new(Decoder { prior, candidates: self.candidates, with_nll });
        let (selector, refinement) = (Best::boxed(inputs), Refinement::of(inputs, self.refine.as_ref()));
        Ok(Box::new(ProposeAndSelect { proposer, selector, refinement, facts: self.facts() }))
    }
}

#[derive(Clone)]
struct Decoder {
    prior: Arc<dyn Backbone>,
    candidates: Option<usize>,
    with_nll: bool,
}

impl Proposer for Decoder {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let encoding = encoded(&*self.prior, now).map_err(|error| in_scene(now.scene(), error))?;
        let body = Body::of(now.scene())?;
        Ok(Box::new(Encoded { decoder: self.clone(), encoding, body, now: now.clone() }))
    }
}

struct Encoded {
    decoder: Decoder,
    encoding: Encoding,
    body: Body,
    now: Observation,
}

impl PreparedProposer for Encoded {
    fn propose(&self, _: &Mixture, seed: u64) -> Result<Vec<Proposal>, Error> {
        let Self { decoder: Decoder { prior, candidates, with_nll }, encoding, body, now } = self;
        let id = &now.scene().id;
        let propose = || -> Result<Vec<Proposal>, sage_backbones::Error> {
            let ends = prior.mode_ends(encoding)?;
            let mut modes: Vec<usize> = (0..ends.len()).collect();
            Rng::new(seed, id, "random goals").shuffle(&mut modes);
            let draw = Draw::of(*candidates, encoding.features().edge_kinds);
            modes.truncate(draw.modes);
            let trajectories =
                trajectories_in_world(&prior.trajectories(encoding, &modes)?, encoding.features())?;
            let origin = encoding.features().frame.origin();
            let mut rng = Rng::new(seed, id, "random paces");
            let profiles = speed_profiles(encoding.features().edge_kinds);
            let retimed = trajectories.iter().map(|trajectory| {
                let profile = &profiles[rng.below(profiles.len())];
                profile.whole(&Extended::new(trajectory, origin))
            });
            let edges = encoding.features().edge_kinds.of(now.index());
            let accepted = drivable(retimed, draw.candidates, body, edges)?;
            let modes: Vec<usize> = accepted.iter().map(|(k, _)| modes[*k]).collect();
            let nll = nll(&**prior, encoding, &modes, *with_nll)?;
            let proposal = |(((_, trajectory), mode), nll): (((usize, _), &usize), _)| Proposal {
                trajectory,
                log_prob: None,
                goal: Some(goal(encoding, ends[*mode])),
                nll,
            };
            Ok(accepted.into_iter().zip(&modes).zip(nll).map(proposal).collect())
        };
        propose().map_err(|error| in_scene(now.scene(), error))
    }
}
