//! `sage` with a reward of your own: one type, one line.
//!
//! ```sh
//! cargo run --release -p experiments --example own_reward -- list
//! ```

use std::process::ExitCode;

use sage_core::{
    objective::{Candidate, Context, Reward},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

/// Closeness of the two boxes: `exp(−gap / scale)` at the least gap.
struct NearMiss(NearMissOptions);

#[derive(Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct NearMissOptions {
    /// Gap at which the reward has fallen to 1/e, metres, > 0.
    scale: f64,
}

impl Default for NearMissOptions {
    fn default() -> Self {
        Self { scale: 5.0 }
    }
}

impl Entry<dyn Reward> for NearMiss {
    const NAME: &'static str = "near-miss";
    const SUMMARY: &'static str = "closeness of the two cars without contact";
    const SOURCE: &'static str = "this example";
    type Options = NearMissOptions;

    fn build(options: NearMissOptions) -> Result<Box<dyn Reward>, String> {
        if options.scale > 0.0 {
            Ok(Box::new(Self(options)))
        } else {
            Err("`scale` must be above 0".to_owned())
        }
    }
}

impl Reward for NearMiss {
    fn score(&self, candidate: &Candidate, ctx: &Context) -> f64 {
        let pairs = candidate.boxes().iter().zip(ctx.ego_boxes());
        let gaps = pairs.filter_map(|(adversary, ego)| ego.as_ref().map(|ego| adversary.distance(ego)));
        (-gaps.fold(f64::INFINITY, f64::min) / self.0.scale).exp()
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.rewards = registries.rewards.with::<NearMiss>()?;
        Ok(registries)
    })
}
