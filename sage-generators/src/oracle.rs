//! Oracle search: the best of *all* goals of a prior at all paces, knowing the ego's way. A ceiling for anything
//! that proposes from the same goals.

use std::sync::Arc;

use sage_backbones::{Backbone, backbone::to_world};
use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    objective::Context,
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use crate::{
    Method, Setting,
    choice::Judge,
    steered::{in_scene, surprises},
    timing::{Extended, PACES, Pace},
};

/// The search.
pub struct Oracle {
    /// Name for tables.
    pub name: String,
    /// Lays and decodes the goals.
    pub prior: Arc<dyn Backbone>,
    /// Who chooses among them.
    pub judge: Judge,
}

impl Generator for Oracle {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, _seed: u64) -> Result<Attack, Error> {
        let attack = || {
            let scene = ctx.scene();
            let features = self.prior.features(scene, ctx.index(), scene.adversary_index()?)?;
            let encoding = self.prior.encode(Arc::new(features))?;
            let ends = self.prior.mode_ends(&encoding)?;
            let modes: Vec<usize> = (0..ends.len()).collect();
            let plain = to_world(&self.prior.trajectories(&encoding, &modes)?, encoding.features())?;
            let origin = encoding.features().frame.origin();
            let plain: Vec<Extended> = plain.iter().map(|path| Extended::new(path, origin)).collect();
            let paces = PACES.map(Pace::new);
            let paced = paces.iter().flat_map(|pace| plain.iter().map(|path| pace.whole(path)));
            let mut paths = paced.collect::<Result<Vec<_>, Error>>()?;
            let surprises = surprises(&self.judge, &*self.prior, &encoding, &modes)?;
            // All goals at one pace, then at the next.
            let (best, note) = self.judge.search(paths.iter().zip(surprises.iter().copied().cycle()), ctx);
            let goal = Some(encoding.features().frame.to_world(ends[best % ends.len()].map(f64::from)));
            // One candidate: the thousands that lost are of no use to anyone.
            let candidates = vec![Proposed { trajectory: paths.swap_remove(best), log_prob: None, goal }];
            Ok(Attack { candidates, chosen: 0, note })
        };
        attack().map_err(|error| in_scene(ctx, &error))
    }
}

/// [`Oracle`] over the prior.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OracleMethod {}

impl Method for OracleMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn stands_once(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let name = format!("oracle, choice {}", setting.label);
        Ok(Box::new(Oracle { name, prior: setting.prior()?, judge: setting.judge()? }))
    }
}

impl Entry<dyn Method> for OracleMethod {
    const NAME: &'static str = "oracle";
    const SUMMARY: &'static str = "the best of all goals: a ceiling";
    const SOURCE: &'static str = "this project";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn Method>, String> {
        Ok(Box::new(options))
    }
}
