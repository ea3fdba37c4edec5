//! A target as steering sees it: it knows what a network expects of the ego.

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
    features::{CELL, Features, GOAL_COLUMNS, GoalColumn},
    prediction::predict,
};

/// Futures of the ego that are looked at.
const FUTURES: usize = 8;
/// How far apart they end, metres.
const APART: f32 = 4.0;
/// Goals of the ego nearer than this are kept even off the road, metres.
const CLOSE: f32 = 10.0;
/// Pieces of the map in a coarse view, the nearest: around the target …
const PIECES: usize = 96;
/// … and around the ego.
const EGO_PIECES: usize = 64;
/// In a coarse view every second goal of the target is left out farther away than this, metres.
const NEAR: f32 = 40.0;

/// How closely to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// At every goal, from all pieces of the map: what policies are trained and measured on.
    Full,
    /// From the nearer pieces of the map, at fewer of the farther goals: enough for candidates, which end
    /// metres apart, and faster (`docs/steering.md`).
    Coarse,
}

/// Looks around a target like [`Backbone::features`], and replaces what it expects of the ego by the
/// futures that a network predicts for it from what can be seen *now*.
///
/// *Errors*: those of the network.
pub fn foreseeing(
    network: &dyn Backbone,
    scene: &Scene,
    index: &SceneIndex,
    target: usize,
    detail: Detail,
) -> Result<Features, Error> {
    let mut features = network.features(scene, index, target)?;
    if detail == Detail::Coarse && has_lattice(&features) {
        features = coarse(features);
    }
    if target == scene.ego || !scene.tracks[scene.ego].is_valid(NOW) {
        return Ok(features);
    }
    let mut ego = network.features(scene, index, scene.ego)?;
    if has_lattice(&ego) {
        ego = on_the_road(ego, detail);
    }
    let mut rng = Rng::new(0, &scene.id, "foresight");
    let all = predict(network, Arc::new(ego), FUTURES, Selection::Nms { radius: APART }, &mut rng)?;
    let futures: Vec<(f32, &Trajectory)> = all.iter().map(|p| (p.log_prob, &p.trajectory)).collect();
    let frame = features.frame;
    features.outlook.foresee(&futures, &frame);
    Ok(features)
}

fn coarse(features: Features) -> Features {
    let keep = passing(&features, |[i, j], [x, y], _| x * x + y * y < NEAR * NEAR || (i + j) % 2 == 0);
    features.with_pieces(PIECES).with_goals(&keep)
}

/// The same with the goals alone that lie along the road or close by, if these are enough: nothing
/// else is likely, and it is half the work. In a coarse view they lie as far apart as futures.
fn on_the_road(mut features: Features, detail: Detail) -> Features {
    let is_coarse = detail == Detail::Coarse;
    if is_coarse {
        features = features.with_pieces(EGO_PIECES);
    }
    let keep = passing(&features, |[i, j], [x, y], row| {
        let is_on_road = row[GoalColumn::Reachable as usize] > 0.0;
        x * x + y * y < CLOSE * CLOSE || (is_on_road && (!is_coarse || (i % 2 == 0 && j % 2 == 0)))
    });
    if keep.len() < 8 * FUTURES { features } else { features.with_goals(&keep) }
}

/// Whether these are features of our own kind, and not of a published network.
fn has_lattice(features: &Features) -> bool {
    features.goal_features.columns == GOAL_COLUMNS
}

/// Goals that pass a test of their lattice point, place and row.
fn passing(features: &Features, pass: impl Fn([i32; 2], [f32; 2], &[f32]) -> bool) -> Vec<usize> {
    let passes = |goal: &usize| {
        let place = features.goals[*goal];
        let point = place.map(|x| (x / CELL as f32).round() as i32);
        pass(point, place, features.goal_features.row(*goal))
    };
    (0..features.modes()).filter(passes).collect()
}
