//! `sage` with a generator of your own: the adversary brakes as hard as the dial says.
//!
//! ```sh
//! cargo run --release -p experiments --example own_generator -- generate examples/crossing.pkl \
//!     --method brake --lambda 0:1:0.5 --weights procedural --out braked
//! ```

use std::process::ExitCode;

use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::Context,
    registry::Entry,
};
use sage_generators::{Method, Setting};
use serde::{Deserialize, Serialize};

/// Brakes straight on at an even rate until it stands.
struct Brake {
    name: String,
    /// m/s².
    rate: f64,
}

impl Generator for Brake {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, _seed: u64) -> Result<Attack, Error> {
        let track = ctx.adversary();
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let speed = vx.hypot(vy);
        let (sin, cos) = track.heading[NOW].sin_cos();
        let at = |step: usize| {
            let t = (step as f64 * DT).min(if self.rate > 0.0 { speed / self.rate } else { f64::INFINITY });
            let gone = speed * t - 0.5 * self.rate * t * t;
            [x + gone * cos, y + gone * sin]
        };
        let trajectory = Trajectory::new("braking", (1..=HORIZON).map(at).collect())?;
        let candidates = vec![Proposed { trajectory, log_prob: None, goal: None }];
        Ok(Attack { candidates, chosen: 0, note: None })
    }
}

/// How to build it: its options, and what the dial means to it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct BrakeMethod {
    /// Rate at the end of the dial, m/s².
    hardest: f64,
}

impl Default for BrakeMethod {
    fn default() -> Self {
        Self { hardest: 6.0 }
    }
}

impl Method for BrakeMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let name = format!("brake {}", setting.label);
        Ok(Box::new(Brake { name, rate: self.hardest * setting.lambda }))
    }
}

impl Entry<dyn Method> for BrakeMethod {
    const NAME: &'static str = "brake";
    const SUMMARY: &'static str = "brakes straight on";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn Method>, String> {
        if options.hardest >= 0.0 {
            Ok(Box::new(options))
        } else {
            Err(format!("`hardest` is {}; expected 0 m/s² or more", options.hardest))
        }
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.methods = registries.methods.with::<BrakeMethod>()?;
        Ok(registries)
    })
}
