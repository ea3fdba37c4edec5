//! `sage` with your own proposer and the shipped selector. The candidates drive straight on at many
//! decelerations, and the selector takes the best. It needs no experts.
//!
//! ```sh
//! cargo run --release -p experiments --example own_proposer -- generate examples/crossing.pkl \
//!     --method straight-on --lambda 0:1:0.5 --out straight
//! ```

use std::process::ExitCode;

use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    motion::{DT, HORIZON, NOW, Trajectory},
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, selector::Best};
use serde::{Deserialize, Serialize};

/// Proposes braking and accelerating. The type is also its own options.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct StraightOn {
    /// Number of candidates.
    candidates: usize,
}

impl Default for StraightOn {
    fn default() -> Self {
        Self { candidates: 16 }
    }
}

impl Entry<dyn GeneratorKind> for StraightOn {
    const NAME: &'static str = "straight-on";
    const SUMMARY: &'static str = "straight on, at many decelerations";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        if options.candidates > 0 {
            Ok(Box::new(options))
        } else {
            Err("`candidates` must be above 0".to_owned())
        }
    }
}

impl GeneratorKind for StraightOn {
    fn facts(&self) -> Facts {
        Facts { needs_experts: false, ..Best::FACTS }
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        let selector = Box::new(Best::new(inputs.selection.clone()));
        Ok(Box::new(ProposeAndSelect {
            proposer: Box::new(*self),
            selector,
            refinement: None,
            facts: self.facts(),
        }))
    }
}

impl Proposer for StraightOn {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let track = now.scene().adversary()?;
        let [vx, vy] = track.velocity[NOW];
        let (start, heading) = (track.point(NOW), track.heading[NOW]);
        Ok(Box::new(Straight { start, heading, speed: vx.hypot(vy), count: self.candidates }))
    }
}

struct Straight {
    start: [f64; 2],
    heading: f64,
    speed: f64,
    count: usize,
}

impl PreparedProposer for Straight {
    fn propose(&self, _: &Mixture, _: u64) -> Result<Vec<Proposal>, Error> {
        let Self { start: [x, y], heading, speed, count } = *self;
        let (sin, cos) = heading.sin_cos();
        let proposal = |k: usize| {
            // Deceleration from −2 to 6 m/s².
            let rate = -2.0 + 8.0 * k as f64 / count as f64;
            let at = |step: usize| {
                let t = step as f64 * DT;
                let t = if rate > 0.0 { t.min(speed / rate) } else { t };
                let distance = speed * t - 0.5 * rate * t * t;
                [x + distance * cos, y + distance * sin]
            };
            Ok(Proposal::of(Trajectory::new("straight", (1..=HORIZON).map(at).collect())?))
        };
        (0..count).map(proposal).collect()
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.generators = registries.parts.generators.with::<StraightOn>()?;
        Ok(registries)
    })
}
