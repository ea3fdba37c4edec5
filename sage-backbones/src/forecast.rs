//! What a network expects of the ego, as an input for those who look at a target beside it.

use std::sync::Arc;

use sage_core::{generator::Observation, motion::NOW, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error,
    backbone::MotionModel,
    candidates::Selection,
    features::{CELL, EgoForecast, Features, GoalColumn, Layout},
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
    pub fn check(self) -> Result<Self, Error> {
        let fail = |problem| Err(Error::Training(problem));
        if self.pieces == 0 || self.ego_pieces == 0 {
            return fail(format!(
                "`pieces` is {} and `ego_pieces` {}; expected at least 1",
                self.pieces, self.ego_pieces
            ));
        }
        if !(self.near >= 0.0) {
            return fail(format!("`near` is {}; expected 0 metres or more", self.near));
        }
        if !(1..=4).contains(&self.ego_every) {
            return fail(format!("`ego_every` is {}; expected 1 to 4", self.ego_every));
        }
        Ok(self)
    }
}

impl Default for View {
    fn default() -> Self {
        Self { pieces: 128, near: 60.0, ego_pieces: 64, ego_every: 2 }
    }
}

/// A model's forecast of the ego as an input for a target beside it; none if the ego is the target or not seen
/// *now*.
///
/// *Errors*: those of the network.
pub fn ego_forecast(
    model: &dyn MotionModel,
    now: &Observation,
    target: usize,
    view: View,
) -> Result<Option<EgoForecast>, Error> {
    let scene = now.scene();
    if target == scene.ego || !scene.tracks[scene.ego].is_valid(NOW) {
        return Ok(None);
    }
    let mut ego = model.features(now, scene.ego, None)?;
    if ego.layout == Layout::Lattice {
        ego = on_the_road(ego, view);
    }
    let mut rng = Rng::new(0, &scene.id, "foresight");
    let futures = predict(model, Arc::new(ego), FUTURES, Selection::Nms { radius: APART }, &mut rng)?;
    Ok(Some(EgoForecast::new(futures.into_iter().map(|f| (f.log_prob, f.trajectory)).collect())))
}

/// Features of a target with the model's own forecast of the ego, as closely as a view looks: what
/// fine-tuning and proposing look at.
///
/// *Errors*: those of the network.
pub fn features_with_forecast(
    model: &dyn MotionModel,
    now: &Observation,
    target: usize,
    view: View,
) -> Result<Features, Error> {
    let forecast = ego_forecast(model, now, target, view)?;
    let features = model.features(now, target, forecast.as_ref())?;
    Ok(if features.layout == Layout::Lattice { thinned(features, view) } else { features })
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

/// Goals that pass a test of their lattice point, place and row.
fn passing(features: &Features, pass: impl Fn([i32; 2], [f32; 2], &[f32]) -> bool) -> Vec<usize> {
    let passes = |goal: &usize| {
        let place = features.goals[*goal];
        let point = place.map(|x| (x / CELL as f32).round() as i32);
        pass(point, place, features.goal_features.row(*goal))
    };
    (0..features.modes()).filter(passes).collect()
}
