//! No curriculum: the same intensity and share of attacks in the whole training.

use sage_core::{registry::Entry, seed::Rng};
use sage_sim::curriculum::{Curriculum, Progress};
use serde::{Deserialize, Serialize};

use super::check_share;

/// The curriculum `constant`.
#[derive(Clone, Debug, Default)]
pub struct Constant(ConstantOptions);

/// Options of [`Constant`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConstantOptions {
    /// Intensity of all attacks.
    pub lambda: f64,
    /// Share of episodes with an attack.
    pub probability: f64,
}

impl Default for ConstantOptions {
    fn default() -> Self {
        Self { lambda: 1.0, probability: 0.5 }
    }
}

impl Entry<dyn Curriculum> for Constant {
    const NAME: &'static str = "constant";
    const SUMMARY: &'static str = "the same intensity and share of attacks throughout";
    const SOURCE: &'static str = "this project";
    type Options = ConstantOptions;

    fn build(options: ConstantOptions) -> Result<Box<dyn Curriculum>, String> {
        check_share("lambda", options.lambda)?;
        check_share("probability", options.probability)?;
        Ok(Box::new(Self(options)))
    }
}

impl Curriculum for Constant {
    fn draw(&self, _: &Progress, rng: &mut Rng) -> Option<f64> {
        (rng.unit() < self.0.probability).then_some(self.0.lambda)
    }
}
