//! Avoidability as predictions of the ego say it: an attack is avoidable if one of them does not touch the adversary.
//!
//! It differs from a search for an evasive manoeuvre: predictions are what the ego might do by itself, from *now* on and
//! without seeing the attack, and there are few of them. That all touch the adversary does not mean that a driver who
//! brakes or steers must.

use crate::Result;
use sage_backbones::{
    Backbone,
    candidates::Sampling,
    prediction::{Predicted, predict},
};
use sage_core::{
    objective::{Candidate, Context, EgoPaths, Encounter},
    scene::SceneData,
    seed::Rng,
};

/// Predictions of the ego.
const SAMPLES: usize = 32;
/// Least distance of their ends, metres.
const APART: f32 = 2.0;

/// The ego's most likely predictions under the prior.
pub struct EgoSamples(Context);

impl EgoSamples {
    /// Predicts the ego from the observation up to *now*.
    ///
    /// *Errors*: those of the prior.
    pub fn of(data: &SceneData, ctx: &Context, prior: &dyn Backbone) -> Result<Self> {
        let features = prior.features(&data.observe()?, data.scene.ego, None)?;
        let rng = &mut Rng::new(0, &data.scene.id, "ego samples");
        let predicted = predict(prior, features.into(), SAMPLES, Sampling::Nms { radius: APART }, rng)?;
        let path = |paths: Option<EgoPaths>, one: &Predicted| -> Result<Option<EgoPaths>> {
            let positions = one.trajectory.points().to_vec();
            let what = "a prediction of the ego";
            Ok(Some(match paths {
                None => EgoPaths::one(what, positions, None)?,
                Some(paths) => paths.and(what, 1.0, positions, None)?,
            }))
        };
        let paths = predicted.iter().try_fold(None, path)?;
        Ok(Self(paths.map_or_else(|| Ok(ctx.clone()), |paths| ctx.with_ego(&paths))?))
    }

    /// Share of the predictions that a trajectory of the adversary touches.
    pub fn share_hit(&self, candidate: &Candidate) -> f64 {
        let paths = self.0.egos();
        let hit = paths.iter().filter(|path| Encounter::of(candidate, path).contact.is_some()).count();
        hit as f64 / paths.len() as f64
    }
}
