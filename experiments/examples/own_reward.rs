//! `sage` with your own reward: one type and one line of registration. The reward becomes a column of
//! `score` and of tables. Any objective can use it as a term, in `generate --selection` and in
//! `finetune --config`.
//!
//! ```sh
//! cargo run --release -p experiments --example own_reward -- score examples/crossing.pkl \
//!     --candidates examples/crossing.json
//! ```

use std::process::ExitCode;

use sage_core::{
    objective::{Reward, Situation},
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
    fn score(&self, situation: &Situation) -> Option<f64> {
        let pairs = situation.candidate.boxes().iter().zip(situation.ego.boxes());
        let gaps = pairs.filter_map(|(adversary, ego)| Some(adversary.distance(ego.as_ref()?)));
        // Not measured if the two are never valid at the same step.
        let least = gaps.min_by(f64::total_cmp)?;
        Some((-least / self.0.scale).exp())
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.rewards = registries.parts.rewards.with::<NearMiss>()?;
        Ok(registries)
    })
}
