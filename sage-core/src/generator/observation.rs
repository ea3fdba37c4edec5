//! The observation of a scene: the eleven frames that end *now*.
//!
//! It is a [`Scene`], so code that reads a scene needs no other type for it and cannot read the future.

use std::{ops::RangeInclusive, sync::Arc};

use crate::{
    Error,
    motion::{HISTORY, NOW},
    scene::{Scene, SceneIndex, Track, TrafficLight},
};

/// A scene that ends *now*, with its map. It is the input of predictors and proposers and holds no future.
///
/// Of a recorded `scene`:
///
/// ```
/// use sage_core::{generator::Observation, scene::SceneIndex};
///
/// # let scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs"));
/// assert_eq!(scene.frames, 91);
/// let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone()))?;
/// // Eleven frames, the last of which is *now*: what a predictor gets holds no future.
/// assert_eq!((now.scene().frames, now.scene().horizon()), (11, 0));
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone)]
pub struct Observation {
    scene: Arc<Scene>,
    index: Arc<SceneIndex>,
}

impl Observation {
    /// Frames 0 to 10 of a scene; *now* is frame 10.
    ///
    /// *Errors*: [`Error::Scene`] for a scene with fewer frames, which no reader returns.
    pub fn of(scene: &Scene, index: &Arc<SceneIndex>) -> Result<Self, Error> {
        Self::at(scene, index, NOW)
    }

    /// The eleven frames of a scene that end at a given frame, which becomes *now*.
    ///
    /// *Errors*: [`Error::Scene`] if the scene does not have these frames.
    pub fn at(scene: &Scene, index: &Arc<SceneIndex>, now: usize) -> Result<Self, Error> {
        if now + 1 < HISTORY || now >= scene.frames {
            return Err(Error::Scene {
                scene: scene.id.clone(),
                problem: format!(
                    "frame {now} cannot be now: expected {} to {}",
                    HISTORY - 1,
                    scene.frames.saturating_sub(1)
                ),
            });
        }
        let first = now + 1 - HISTORY;
        let track = |(k, track): (usize, &Track)| Track {
            id: track.id.clone(),
            kind: track.kind.clone(),
            position: track.position[first..=now].to_vec(),
            heading: track.heading[first..=now].to_vec(),
            velocity: track.velocity[first..=now].to_vec(),
            size: track.size[first..=now].to_vec(),
            valid: observed(scene, k, first..=now),
        };
        let light = |light: &TrafficLight| TrafficLight {
            lane: light.lane.clone(),
            stop_point: light.stop_point,
            states: light.states.get(first..=now).unwrap_or_default().to_vec(),
        };
        let scene = Scene {
            id: scene.id.clone(),
            frames: HISTORY,
            timestamps: scene.timestamps.get(first..=now).unwrap_or_default().to_vec(),
            tracks: scene.tracks.iter().enumerate().map(track).collect(),
            map: scene.map.clone(),
            lights: scene.lights.iter().map(light).collect(),
            ego: scene.ego,
            adversary: scene.adversary,
            adversary_origin: scene.adversary_origin,
            notes: Vec::new(),
            held: Vec::new(),
        };
        Ok(Self { scene: Arc::new(scene), index: index.clone() })
    }

    /// The eleven frames as a scene; *now* is its last frame, 10.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The search trees of the map.
    pub fn index(&self) -> &Arc<SceneIndex> {
        &self.index
    }
}

/// Whether a track was seen at some frames. That one which is hidden stands in its place is known only later.
fn observed(scene: &Scene, track: usize, frames: RangeInclusive<usize>) -> Vec<bool> {
    let is_held =
        |frame: &usize| scene.held.iter().any(|held| held.track == track && held.frames.contains(frame));
    let valid = &scene.tracks[track].valid;
    frames.map(|frame| valid[frame] && !is_held(&frame)).collect()
}
