//! A target that knows what a network expects of the ego.

use std::sync::Arc;

use sage_core::{
    motion::{NOW, Trajectory},
    scene::{Scene, SceneIndex},
    seed::Rng,
};

use crate::{
    Error,
    backbone::Backbone,
    candidates::Selection,
    features::{Features, GoalColumn},
    prediction::predict,
};

/// Futures of the ego that are looked at.
const FUTURES: usize = 8;
/// How far apart they end, metres.
const APART: f32 = 4.0;
/// Goals nearer than this are kept even off the road, metres.
const CLOSE: f32 = 10.0;

/// Looks around a target like [`Backbone::features`], and replaces what it expects of the ego by the
/// futures that a network predicts for it from what can be seen *now*.
///
/// *Errors*: those of the network.
pub fn foreseeing(
    network: &dyn Backbone,
    scene: &Scene,
    index: &SceneIndex,
    target: usize,
) -> Result<Features, Error> {
    let mut features = network.features(scene, index, target)?;
    if target == scene.ego || !scene.tracks[scene.ego].is_valid(NOW) {
        return Ok(features);
    }
    let ego = network.features(scene, index, scene.ego)?;
    let ego = on_the_road(ego);
    let mut rng = Rng::new(0, &scene.id, "foresight");
    let all = predict(network, Arc::new(ego), FUTURES, Selection::Nms { radius: APART }, &mut rng)?;
    let futures: Vec<(f32, &Trajectory)> = all.iter().map(|p| (p.log_prob, &p.trajectory)).collect();
    let frame = features.frame;
    features.outlook.foresee(&futures, &frame);
    Ok(features)
}

/// The same with the goals alone that lie along the road or close by, if these are enough: nothing
/// else is likely, and it is half the work.
fn on_the_road(features: Features) -> Features {
    let keep: Vec<usize> = (0..features.modes())
        .filter(|&goal| {
            let [x, y] = features.goals[goal];
            let row = features.goal_features.row(goal);
            row.get(GoalColumn::Reachable as usize).is_some_and(|on| *on > 0.0)
                || x * x + y * y < CLOSE * CLOSE
        })
        .collect();
    if keep.len() < 8 * FUTURES { features } else { features.with_goals(&keep) }
}
