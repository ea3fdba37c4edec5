//! A target as steering sees it: it knows what a network expects of the ego.

use std::sync::Arc;

use sage_core::{
    motion::{NOW, Trajectory},
    scene::{Scene, SceneIndex},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

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

/// How closely to look. Candidates end metres apart, so they need less than what policies are trained and
/// measured on ([`View::FULL`]): `docs/steering.md` says how the default was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct View {
    /// Most pieces of the map around the target, the nearest.
    pub pieces: usize,
    /// Every second goal of the target is left out farther away than this, metres.
    pub near: f32,
    /// Most pieces of the map around the ego.
    pub ego_pieces: usize,
    /// Of the ego's goals every so many-th is looked at, along and across.
    pub ego_every: usize,
}

impl View {
    /// All goals, from all pieces of the map.
    pub const FULL: Self = Self { pieces: usize::MAX, near: f32::MAX, ego_pieces: usize::MAX, ego_every: 1 };

    /// What is wrong with it, if something is.
    ///
    /// *Errors*: the field, its value and the range.
    pub fn check(self) -> Result<Self, String> {
        if self.pieces == 0 || self.ego_pieces == 0 {
            return Err(format!(
                "`pieces` is {} and `ego_pieces` {}; expected at least 1",
                self.pieces, self.ego_pieces
            ));
        }
        if !(self.near >= 0.0) {
            return Err(format!("`near` is {}; expected 0 metres or more", self.near));
        }
        if !(1..=4).contains(&self.ego_every) {
            return Err(format!("`ego_every` is {}; expected 1 to 4", self.ego_every));
        }
        Ok(self)
    }
}

impl Default for View {
    fn default() -> Self {
        Self { pieces: 128, near: 60.0, ego_pieces: 64, ego_every: 2 }
    }
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
    view: View,
) -> Result<Features, Error> {
    let mut features = network.features(scene, index, target)?;
    if has_lattice(&features) {
        features = thinned(features, view);
    }
    if target == scene.ego || !scene.tracks[scene.ego].is_valid(NOW) {
        return Ok(features);
    }
    let mut ego = network.features(scene, index, scene.ego)?;
    if has_lattice(&ego) {
        ego = on_the_road(ego, view);
    }
    let mut rng = Rng::new(0, &scene.id, "foresight");
    let all = predict(network, Arc::new(ego), FUTURES, Selection::Nms { radius: APART }, &mut rng)?;
    let futures: Vec<(f32, &Trajectory)> = all.iter().map(|p| (p.log_prob, &p.trajectory)).collect();
    let frame = features.frame;
    features.outlook.foresee(&futures, &frame);
    Ok(features)
}

fn thinned(mut features: Features, view: View) -> Features {
    features = features.with_pieces(view.pieces);
    if view.near == f32::MAX {
        return features;
    }
    let keep =
        passing(&features, |[i, j], [x, y], _| x * x + y * y < view.near * view.near || (i + j) % 2 == 0);
    features.with_goals(&keep)
}

/// The same with the goals alone that lie along the road or close by, if these are enough: nothing
/// else is likely, and it is half the work.
fn on_the_road(mut features: Features, view: View) -> Features {
    features = features.with_pieces(view.ego_pieces);
    let every = view.ego_every as i32;
    let keep = passing(&features, |[i, j], [x, y], row| {
        let is_on_road = row[GoalColumn::Reachable as usize] > 0.0;
        x * x + y * y < CLOSE * CLOSE || (is_on_road && i % every == 0 && j % every == 0)
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
