//! `sage` with your own feasibility rule: the adversary must not be faster than a limit.
//!
//! ```sh
//! cargo run --release -p experiments --example own_feasibility -- generate examples/crossing.pkl \
//!     --weights procedural --feasibility 'speed-limit{"limit": 6.0}' --out slow
//! ```

use std::process::ExitCode;

use sage_core::{
    objective::{Candidate, Context, Feasibility, MapFeasibility, Violation},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

/// The paper's rule and a speed limit.
struct SpeedLimit(SpeedLimitOptions);

#[derive(Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct SpeedLimitOptions {
    /// Speed limit, m/s, > 0.
    limit: f64,
    /// Cost of a violation. Costs rank candidates if none is feasible.
    cost: f64,
}

impl Default for SpeedLimitOptions {
    fn default() -> Self {
        Self { limit: 14.0, cost: 5.0 }
    }
}

impl Entry<dyn Feasibility> for SpeedLimit {
    const NAME: &'static str = "speed-limit";
    const SUMMARY: &'static str = "the paper's rule, and no step faster than a limit";
    const SOURCE: &'static str = "this example";
    type Options = SpeedLimitOptions;

    fn build(options: SpeedLimitOptions) -> Result<Box<dyn Feasibility>, String> {
        if options.limit > 0.0 && options.cost > 0.0 {
            Ok(Box::new(Self(options)))
        } else {
            Err("`limit` and `cost` must be above 0".to_owned())
        }
    }
}

impl Feasibility for SpeedLimit {
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation> {
        let mut violations = MapFeasibility::default().violations(candidate, ctx);
        let too_fast = candidate.profile().speed.iter().position(|speed| *speed > self.0.limit);
        if let Some(step) = too_fast {
            violations.push(Violation::at(candidate, step + 1, "speed_limit", self.0.cost, "road"));
        }
        violations
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.feasibilities = registries.parts.feasibilities.with::<SpeedLimit>()?;
        Ok(registries)
    })
}
