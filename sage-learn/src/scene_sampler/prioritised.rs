//! Scenes in which the driver sometimes fails come back more often.
//!
//! The weight of scene i of n is `0.3/n + 0.7 (pᵢ (1 − pᵢ) + 0.02)/Σ`, with the success rate pᵢ over its last eight
//! outcomes. One draw in ten is by the number of episodes since the scene's last one, so that none is forgotten
//! (prioritised level replay, Jiang et al. 2021, with the learnability of Rutherford et al. 2024).

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{SceneRecord, SceneSampler};

/// Share of the draws by age.
const BY_AGE: f64 = 0.1;
/// Share of the weight that all scenes have alike.
const ALIKE: f64 = 0.3;
/// Weight of a scene with a success rate of 0 or 1.
const LEAST_WEIGHT: f64 = 0.02;

/// The sampler `prioritised`.
#[derive(Clone, Debug, Default)]
pub struct Prioritised;

impl Entry<dyn SceneSampler> for Prioritised {
    const NAME: &'static str = "prioritised";
    const SUMMARY: &'static str = "scenes in which the driver sometimes fails come back more often";
    const SOURCE: &'static str = "this project, after Jiang et al. 2021 and Rutherford et al. 2024";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn SceneSampler>, String> {
        Ok(Box::new(Self))
    }
}

impl SceneSampler for Prioritised {
    fn draw(&self, scenes: &[SceneRecord], episode: u64, rng: &mut Rng) -> usize {
        let kind = rng.unit();
        let weight = |scene: &SceneRecord| {
            let p = scene.success();
            p * (1.0 - p) + LEAST_WEIGHT
        };
        let age = |scene: &SceneRecord| episode.saturating_sub(scene.last) as f64;
        if kind < BY_AGE {
            drawn(scenes, age, rng)
        } else if kind < BY_AGE + (1.0 - BY_AGE) * ALIKE {
            rng.below(scenes.len())
        } else {
            drawn(scenes, weight, rng)
        }
    }
}

/// A draw in proportion to weights; uniform if all are 0.
fn drawn(scenes: &[SceneRecord], weight: impl Fn(&SceneRecord) -> f64, rng: &mut Rng) -> usize {
    let sum: f64 = scenes.iter().map(&weight).sum();
    if sum <= 0.0 {
        return rng.below(scenes.len());
    }
    let mut left = rng.unit() * sum;
    let found = scenes.iter().position(|scene| {
        left -= weight(scene);
        left < 0.0
    });
    found.unwrap_or(scenes.len() - 1)
}
