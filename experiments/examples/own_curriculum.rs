//! `sage` with your own curriculum: attacks begin when the policy drives well without them.
//!
//! ```sh
//! cargo run --release -p experiments --example own_curriculum -- train-ego --method rule \
//!     --curriculum 'patient{"least": 0.6}' --updates 20000 --ratio 0.5 --out run
//! ```

use std::process::ExitCode;

use sage_core::{registry::Entry, seed::Rng};
use sage_sim::curriculum::{Curriculum, Progress};
use serde::{Deserialize, Serialize};

/// Attacks half of the episodes once the success rate without attack is high enough. The type is also its own options.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Patient {
    /// Success rate without attack from which on attacks begin.
    least: f64,
}

impl Default for Patient {
    fn default() -> Self {
        Self { least: 0.7 }
    }
}

impl Entry<dyn Curriculum> for Patient {
    const NAME: &'static str = "patient";
    const SUMMARY: &'static str = "attacks from a success rate without attack on";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn Curriculum>, String> {
        if (0.0..=1.0).contains(&options.least) {
            Ok(Box::new(options))
        } else {
            Err(format!("`least` is {}; expected a number from 0 to 1", options.least))
        }
    }
}

impl Curriculum for Patient {
    fn draw(&self, at: &Progress, rng: &mut Rng) -> Option<f64> {
        let unattacked = at.success.rates[0];
        (unattacked >= self.least && rng.unit() < 0.5).then_some(at.share)
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.curricula = registries.parts.curricula.with::<Patient>()?;
        Ok(registries)
    })
}
