//! The vehicles of recorded scenes as egos, for trainings of drivers.

use std::sync::Arc;

use rayon::prelude::*;
use sage_core::{
    geometry::distance,
    motion::DT,
    scene::{Levels, Scene, SceneData, Track, TrackKind, is_copy_of_ego},
};
use sage_sim::{
    SimScene,
    environment::{Environment, EnvironmentOptions},
};

/// Least time that a vehicle is recorded without a gap from frame 0 on, where drives start, seconds.
const LEAST_TIME: f64 = 3.0;
/// Least distance between its first and its last position, metres.
const LEAST_DISTANCE: f64 = 2.0;

/// Adds to the scenes the same scenes with other vehicles as egos. They share map and index. Vehicles that would start
/// inside another road user are left out, and with `needs_adversary` those without one.
pub fn with_other_egos(scenes: Vec<SceneData>, needs_adversary: bool) -> Vec<SceneData> {
    let rules = Arc::new(EnvironmentOptions::training());
    let others = |data: &SceneData| -> Vec<SceneData> {
        let scene = &data.scene;
        let with_ego = |track: &Track| -> Option<SceneData> {
            let seen = Scene::clone(scene).with_roles(Some(&track.id), None).ok()?;
            let scene = Arc::new(seen);
            let sim = SimScene::new(scene.clone(), data.index.clone()).ok()?;
            Environment::reset(sim, rules.clone(), None, 0).ok()?;
            let name = format!("{} ego {}", data.name, track.id);
            let is_usable = !needs_adversary || scene.adversary.is_some();
            is_usable.then(|| SceneData { name, scene, index: data.index.clone() })
        };
        let ego = scene.ego();
        let driven = scene.tracks.iter().enumerate().filter(|(k, track)| *k != scene.ego && moves(track));
        driven
            .filter(|(_, track)| !is_copy_of_ego(track, ego, &Levels::of(&scene.map)))
            .filter_map(|(_, track)| with_ego(track))
            .collect()
    };
    let others: Vec<Vec<SceneData>> = scenes.par_iter().map(others).collect();
    scenes.into_iter().chain(others.into_iter().flatten()).collect()
}

/// Whether a track is a vehicle that is recorded long enough and moves.
fn moves(track: &Track) -> bool {
    let frames = track.valid.iter().take_while(|valid| **valid).count();
    let last = track.valid.iter().rposition(|valid| *valid).unwrap_or(0);
    track.kind == TrackKind::Vehicle
        && frames as f64 * DT > LEAST_TIME
        && distance(track.point(0), track.point(last)) >= LEAST_DISTANCE
}
