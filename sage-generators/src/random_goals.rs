//! Random goals and the same choice: what a table owes to search alone.

use std::sync::Arc;

use sage_backbones::{Backbone, backbone::to_world};
use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    objective::{Candidate, Context},
    registry::Entry,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use crate::{
    Method, Setting,
    choice::{Judge, drivable},
    method::check_candidates,
    steered::{SPARE, in_scene, surprises},
    timing::{Extended, PACES, Pace},
};

/// Goals and paces drawn evenly, decoded by a prior.
pub struct RandomGoals {
    /// Name for tables.
    pub name: String,
    /// Decodes the goals.
    pub prior: Arc<dyn Backbone>,
    /// Number of candidates.
    pub candidates: usize,
    /// Who chooses among them.
    pub judge: Judge,
}

impl Generator for RandomGoals {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, seed: u64) -> Result<Attack, Error> {
        let attack = || {
            let scene = ctx.scene();
            let features = self.prior.features(scene, ctx.index(), scene.adversary_index()?)?;
            let encoding = self.prior.encode(Arc::new(features))?;
            let ends = self.prior.mode_ends(&encoding)?;
            let mut modes: Vec<usize> = (0..ends.len()).collect();
            Rng::new(seed, &scene.id, "random goals").shuffle(&mut modes);
            modes.truncate(SPARE * self.candidates);
            let paths = to_world(&self.prior.trajectories(&encoding, &modes)?, encoding.features())?;
            let origin = encoding.features().frame.origin();
            let mut rng = Rng::new(seed, &scene.id, "random paces");
            let paces = PACES.map(Pace::new);
            let driven = paths.iter().map(|path| {
                let pace = &paces[rng.below(paces.len())];
                pace.whole(&Extended::new(path, origin))
            });
            let kept = drivable(driven, self.candidates, ctx)?;
            let modes: Vec<usize> = kept.iter().map(|(k, _)| modes[*k]).collect();
            let surprises = surprises(&self.judge, &*self.prior, &encoding, &modes)?;
            let judge = |((_, candidate), surprise): (&(_, Candidate), &f64)| {
                self.judge.judge(candidate, *surprise, ctx)
            };
            let judged: Vec<_> = kept.iter().zip(&surprises).map(judge).collect();
            let (chosen, note) = self.judge.choose(&judged);
            let proposed = |((_, candidate), &mode): ((_, Candidate), &usize)| Proposed {
                trajectory: candidate.into_trajectory(),
                log_prob: None,
                goal: Some(encoding.features().frame.to_world(ends[mode].map(f64::from))),
            };
            Ok(Attack { candidates: kept.into_iter().zip(&modes).map(proposed).collect(), chosen, note })
        };
        attack().map_err(|error| in_scene(ctx, &error))
    }
}

/// [`RandomGoals`] over the prior.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomMethod {
    /// Number of candidates.
    pub candidates: usize,
}

impl Default for RandomMethod {
    fn default() -> Self {
        Self { candidates: 32 }
    }
}

impl Method for RandomMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let (prior, judge) = (setting.prior()?, setting.judge()?);
        let name = format!("random goals, choice {}", setting.label);
        Ok(Box::new(RandomGoals { name, prior, candidates: self.candidates, judge }))
    }
}

impl Entry<dyn Method> for RandomMethod {
    const NAME: &'static str = "random";
    const SUMMARY: &'static str = "random goals with the same choice";
    const SOURCE: &'static str = "this project: what search alone does";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn Method>, String> {
        check_candidates(options.candidates)?;
        Ok(Box::new(options))
    }
}
