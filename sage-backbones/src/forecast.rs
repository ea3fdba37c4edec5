//! Ego forecasts of a network, as input for another target.
//!
//! From the forecast of the ego the interaction head gets the probability of contact. It costs a second encoding and gives half
//! again as many feasible hits.

use std::sync::Arc;

use sage_core::{generator::Observation, motion::NOW, seed::Rng};

use crate::{
    Error,
    backbone::Backbone,
    candidates::Sampling,
    features::{EgoForecast, Features, Layout},
    prediction::predict,
    subsampling::Subsampling,
};

/// Modes of the ego forecast.
const EGO_MODES: usize = 8;
/// Least distance between their ends, metres.
const EGO_MODE_RADIUS: f32 = 4.0;

/// The model's forecast of the ego for another target; `None` if the ego is the target or is not valid *now*.
///
/// *Errors*: those of the network.
pub fn ego_forecast(
    model: &dyn Backbone,
    now: &Observation,
    target: usize,
    subsampling: Subsampling,
) -> Result<Option<EgoForecast>, Error> {
    let scene = now.scene();
    if target == scene.ego || !scene.tracks[scene.ego].is_valid(NOW) {
        return Ok(None);
    }
    let mut ego = model.features(now, scene.ego, None)?;
    if ego.layout == Layout::Lattice {
        ego = subsampling.of_ego(ego);
    }
    let mut rng = Rng::new(0, &scene.id, "foresight");
    let nms = Sampling::Nms { radius: EGO_MODE_RADIUS };
    let modes = predict(model, Arc::new(ego), EGO_MODES, nms, &mut rng)?;
    Ok(Some(EgoForecast::new(modes.into_iter().map(|mode| (mode.log_prob, mode.trajectory)).collect())))
}

/// Features of a target with the model's own forecast of the ego. Fine-tuning and proposers use them.
///
/// *Errors*: those of the network.
pub fn features_with_forecast(
    model: &dyn Backbone,
    now: &Observation,
    target: usize,
    subsampling: Subsampling,
) -> Result<Features, Error> {
    let forecast = ego_forecast(model, now, target, subsampling)?;
    let features = model.features(now, target, forecast.as_ref())?;
    Ok(if features.layout == Layout::Lattice { subsampling.of_target(features) } else { features })
}
