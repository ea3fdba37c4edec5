//! `sage` with your own generator: the adversary brakes, harder for a larger mu. It needs no experts.
//!
//! ```sh
//! cargo run --release -p experiments --example own_generator -- generate examples/crossing.pkl \
//!     --method brake --lambda 0:1:0.5 --out braked
//! ```

use std::process::ExitCode;

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Proposal},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::Context,
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use serde::{Deserialize, Serialize};

/// Brakes straight on at a constant rate until the vehicle stands. The type is also its own options.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Brake {
    /// Rate at mu = 1, m/s².
    hardest: f64,
}

impl Default for Brake {
    fn default() -> Self {
        Self { hardest: 6.0 }
    }
}

impl Generator for Brake {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, Error> {
        at.iter().map(|point| self.attack(ctx, self.hardest * point.mu)).collect()
    }
}

impl Brake {
    /// The attack that brakes at `rate`, m/s².
    fn attack(&self, ctx: &Context, rate: f64) -> Result<Attack, Error> {
        let track = ctx.adversary();
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let speed = vx.hypot(vy);
        let (sin, cos) = track.heading[NOW].sin_cos();
        let at = |step: usize| {
            let t = (step as f64 * DT).min(if rate > 0.0 { speed / rate } else { f64::INFINITY });
            let distance = speed * t - 0.5 * rate * t * t;
            [x + distance * cos, y + distance * sin]
        };
        let trajectory = Trajectory::new("braking", (1..=HORIZON).map(at).collect())?;
        Ok(Attack::only(Proposal::of(trajectory)))
    }
}

/// Its facts: it uses no information after *now*, needs no experts, and depends on mu.
impl GeneratorKind for Brake {
    fn facts(&self) -> Facts {
        Facts { depends_on_mu: true, ..Facts::without_operating_point(Knowledge::NOW) }
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        Ok(Box::new(*self))
    }
}

impl Entry<dyn GeneratorKind> for Brake {
    const NAME: &'static str = "brake";
    const SUMMARY: &'static str = "brakes straight on";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
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
        registries.parts.generators = registries.parts.generators.with::<Brake>()?;
        Ok(registries)
    })
}
