//! All goals of a prior at all speed profiles. With a selection that uses the ego's path this is an oracle
//! search, an upper bound for every proposer with the same goals.

use std::sync::Arc;

use sage_backbones::{Backbone, backbone::trajectories_in_world, encoding::Encoding};
use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    registry::Entry,
    scene::Scene,
};
use serde::{Deserialize, Serialize};

use super::{encoded, goal, in_scene, nll};
use crate::{
    Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect,
    selector::Best,
    speed_profile::{Extended, speed_profiles},
};

/// Options; there are none.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AllGoals {}

impl Entry<dyn GeneratorKind> for AllGoals {
    const NAME: &'static str = "oracle";
    const SUMMARY: &'static str = "the best of all goals: an upper bound";
    const SOURCE: &'static str = "this project";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(options))
    }
}

impl GeneratorKind for AllGoals {
    fn facts(&self) -> Facts {
        Facts { is_upper_bound: true, ..Best::FACTS }
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let (prior, with_nll) = (inputs.prior(Self::NAME)?, inputs.selection.needs_prior());
        let proposer = Box::new(Decoder { prior, with_nll });
        let selector = Best::boxed(inputs);
        Ok(Box::new(ProposeAndSelect { proposer, selector, refinement: None, facts: self.facts() }))
    }
}

#[derive(Clone)]
struct Decoder {
    prior: Arc<dyn Backbone>,
    with_nll: bool,
}

impl Proposer for Decoder {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let encoding = encoded(&*self.prior, now).map_err(|error| in_scene(now.scene(), error))?;
        Ok(Box::new(Encoded { decoder: self.clone(), encoding, scene: now.scene().clone() }))
    }
}

struct Encoded {
    decoder: Decoder,
    encoding: Encoding,
    scene: Arc<Scene>,
}

impl PreparedProposer for Encoded {
    /// All goals at the first speed profile, then at the next.
    fn propose(&self, _: &Mixture, _: u64) -> Result<Vec<Proposal>, Error> {
        let Self { decoder: Decoder { prior, with_nll }, encoding, .. } = self;
        let propose = || -> Result<Vec<Proposal>, sage_backbones::Error> {
            let ends = prior.mode_ends(encoding)?;
            let modes: Vec<usize> = (0..ends.len()).collect();
            let plain = trajectories_in_world(&prior.trajectories(encoding, &modes)?, encoding.features())?;
            let origin = encoding.features().frame.origin();
            let plain: Vec<Extended> =
                plain.iter().map(|trajectory| Extended::new(trajectory, origin)).collect();
            let nll = nll(&**prior, encoding, &modes, *with_nll)?;
            let profiles = speed_profiles(encoding.features().edge_kinds);
            let at_every_profile = profiles.iter().flat_map(|profile| {
                plain.iter().zip(&ends).zip(&nll).map(|((trajectory, end), nll)| {
                    let goal = Some(goal(encoding, *end));
                    Ok(Proposal { trajectory: profile.whole(trajectory)?, log_prob: None, goal, nll: *nll })
                })
            });
            at_every_profile.collect()
        };
        propose().map_err(|error| in_scene(&self.scene, error))
    }
}
