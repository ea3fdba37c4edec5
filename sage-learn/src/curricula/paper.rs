//! The paper's dual curriculum: λ rises from 0.5 to 1 over the training, the share of attacks from 0.1 to 0.9 over
//! its first half.

use sage_core::{registry::Entry, seed::Rng};
use sage_sim::curriculum::{Curriculum, Progress};
use serde::{Deserialize, Serialize};

use super::check_share;

/// The curriculum `paper`.
#[derive(Clone, Debug, Default)]
pub struct Paper(PaperOptions);

/// Options of [`Paper`]: a number takes the place of a schedule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperOptions {
    /// Intensity of all attacks.
    pub lambda: Option<f64>,
    /// Share of episodes with an attack.
    pub probability: Option<f64>,
}

impl Entry<dyn Curriculum> for Paper {
    const NAME: &'static str = "paper";
    const SUMMARY: &'static str = "λ from 0.5 to 1, share of attacks from 0.1 to 0.9 in the first half";
    const SOURCE: &'static str = "SAGE, section 4.3 and algorithm 2";
    type Options = PaperOptions;

    fn build(options: PaperOptions) -> Result<Box<dyn Curriculum>, String> {
        options.lambda.map_or(Ok(()), |x| check_share("lambda", x))?;
        options.probability.map_or(Ok(()), |x| check_share("probability", x))?;
        Ok(Box::new(Self(options)))
    }
}

impl Curriculum for Paper {
    fn draw(&self, at: &Progress, rng: &mut Rng) -> Option<f64> {
        let probability = self.0.probability.unwrap_or(0.1 + 0.8 * (2.0 * at.share).min(1.0));
        (rng.unit() < probability).then(|| self.0.lambda.unwrap_or(0.5 + 0.5 * at.share))
    }
}
