//! All scenes equally often, as published.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{SceneRecord, SceneSampler};

/// The sampler `uniform`.
#[derive(Clone, Debug, Default)]
pub struct Uniform;

impl Entry<dyn SceneSampler> for Uniform {
    const NAME: &'static str = "uniform";
    const SUMMARY: &'static str = "all scenes equally often";
    const SOURCE: &'static str = "CAT and SAGE";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn SceneSampler>, String> {
        Ok(Box::new(Self))
    }
}

impl SceneSampler for Uniform {
    fn draw(&self, scenes: &[SceneRecord], _: u64, rng: &mut Rng) -> usize {
        rng.below(scenes.len())
    }
}
