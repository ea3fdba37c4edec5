//! The dual curriculum as the published code runs it: λ reaches 1 after two thirds of the training, and the share of
//! attacks rises from 0 to 0.9 over its first half.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};
use sage_sim::curriculum::{Curriculum, Progress};

/// The curriculum `release`.
#[derive(Clone, Debug, Default)]
pub struct Release;

impl Entry<dyn Curriculum> for Release {
    const NAME: &'static str = "release";
    const SUMMARY: &'static str = "λ from 0.5 to 1 in two thirds, share of attacks from 0 to 0.9 in one half";
    const SOURCE: &'static str = "the released code of SAGE";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Curriculum>, String> {
        Ok(Box::new(Self))
    }
}

impl Curriculum for Release {
    fn draw(&self, at: &Progress, rng: &mut Rng) -> Option<f64> {
        let probability = (1.8 * at.share).min(0.9);
        (rng.unit() < probability).then(|| 0.5 + 0.5 * (1.5 * at.share).min(1.0))
    }
}
