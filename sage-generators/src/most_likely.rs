//! The most likely goal of the steered network, without any choice: what the policy itself wants.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::{finite, to_world},
    candidates::ranked,
    foresight::{View, foreseeing},
};
use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    objective::Context,
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use crate::{Method, Setting, steered::in_scene};

/// The generator over one network.
pub struct MostLikely {
    /// Name for tables.
    pub name: String,
    /// The steered network.
    pub network: Arc<dyn Backbone>,
    /// The prior, which says what the ego may do.
    pub prior: Arc<dyn Backbone>,
}

impl Generator for MostLikely {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, _seed: u64) -> Result<Attack, Error> {
        let attack = || {
            let scene = ctx.scene();
            let adversary = scene.adversary_index()?;
            let features = foreseeing(&*self.prior, scene, ctx.index(), adversary, View::FULL)?;
            let encoding = self.network.encode(Arc::new(features))?;
            let log_probs: Vec<f32> = finite(&self.network.log_probs(&encoding)?)?;
            let best = ranked(&log_probs)[0];
            let end = self.network.mode_ends(&encoding)?[best];
            let mut paths = to_world(&self.network.trajectories(&encoding, &[best])?, encoding.features())?;
            let candidate = Proposed {
                trajectory: paths.swap_remove(0),
                log_prob: Some(f64::from(log_probs[best])),
                goal: Some(encoding.features().frame.to_world(end.map(f64::from))),
            };
            Ok(Attack { candidates: vec![candidate], chosen: 0, note: None })
        };
        attack().map_err(|error| in_scene(ctx, &error))
    }
}

/// [`MostLikely`] of the mixture.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MostLikelyMethod {}

impl Method for MostLikelyMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let name = format!("most likely {}", setting.label);
        Ok(Box::new(MostLikely { name, network: setting.mixture()?, prior: setting.prior()? }))
    }
}

impl Entry<dyn Method> for MostLikelyMethod {
    const NAME: &'static str = "most-likely";
    const SUMMARY: &'static str = "the steered network's most likely goal, without choice";
    const SOURCE: &'static str = "this project: what the policy alone does";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn Method>, String> {
        Ok(Box::new(options))
    }
}
