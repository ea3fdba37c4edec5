//! Training samples from recorded futures.

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance},
    motion::{HORIZON, NOW},
    scene::{SceneData, Track, TrackKind},
};

use crate::{
    Error,
    backbone::{Sample, Trainable},
    features::Frame,
    labels,
    prediction::Recorded,
};

/// A vehicle whose last recorded position is within this distance of its present one counts as standing,
/// metres.
pub const MOVING: f64 = 4.0;
/// Least number of recorded future steps of a sample.
const LEAST: usize = 30;

impl Error {
    /// The error with the scene and the agent that it concerns.
    pub fn of(self, data: &SceneData, track: usize) -> Self {
        let agent = data
            .scene
            .tracks
            .get(track)
            .map_or_else(|| track.to_string(), |t| t.id.escape_debug().to_string());
        Self::Agent { scene: data.name.clone(), agent, source: Box::new(self) }
    }
}

/// One vehicle of one scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Example {
    /// Index of the scene.
    pub scene: usize,
    /// Index of the track.
    pub track: usize,
    /// Whether it is the ego or the adversary.
    pub of_interest: bool,
    /// Whether it moves by more than [`MOVING`].
    pub moves: bool,
    /// Whether the last step is recorded.
    pub is_whole: bool,
}

/// Vehicles of many scenes with enough recorded future for a sample.
pub struct Examples<'d> {
    scenes: &'d [SceneData],
    list: Vec<Example>,
}

impl<'d> Examples<'d> {
    /// All vehicles that are valid now and in at least 3 s of the future.
    pub fn of(scenes: &'d [SceneData]) -> Self {
        let mut list = Vec::new();
        for (k, SceneData { scene, .. }) in scenes.iter().enumerate() {
            for track in 0..scene.tracks.len() {
                if let Some((moves, is_whole)) = usable(&scene.track_as_observed(track)) {
                    let of_interest = track == scene.ego || Some(track) == scene.adversary;
                    list.push(Example { scene: k, track, of_interest, moves, is_whole });
                }
            }
        }
        Self { scenes, list }
    }

    /// The examples that a rule accepts.
    pub fn filter(mut self, accept: impl Fn(&Example) -> bool) -> Self {
        self.list.retain(accept);
        self
    }

    /// The examples.
    pub fn list(&self) -> &[Example] {
        &self.list
    }

    /// The scene of an example.
    pub fn scene(&self, example: &Example) -> &'d SceneData {
        &self.scenes[example.scene]
    }

    /// Training sample of an example. With `mirrored`, it is mirrored if the network supports that.
    ///
    /// *Errors*: those of the network's features.
    pub fn sample(
        &self,
        example: &Example,
        network: &dyn Trainable,
        mirrored: bool,
    ) -> Result<Sample, Error> {
        let data = self.scene(example);
        let mut sample =
            recorded_sample(data, example.track, network).map_err(|error| error.of(data, example.track))?;
        if mirrored && let Some(features) = network.mirrored(&sample.features) {
            sample.future.iter_mut().for_each(|p| p[1] = -p[1]);
            sample.features = Arc::new(features);
        }
        Ok(sample)
    }
}

/// Training sample of one track of a scene. The track must be valid *now*.
///
/// *Errors*: those of the network's features.
pub fn recorded_sample(data: &SceneData, track: usize, network: &dyn Trainable) -> Result<Sample, Error> {
    let recorded = &*data.scene.track_as_observed(track);
    let frame = Frame::new(recorded.point(NOW), recorded.heading[NOW]);
    let (positions, valid) = future(recorded, |p| frame.frame_from_world(p));
    let end = frame.world_from_frame(labels::end(&positions, &valid).position.map(f64::from));
    let features = network.labelled_features(&data.observe()?, track, end)?;
    // The network's features may have another frame.
    let (future, _) = future(recorded, |p| features.frame.frame_from_world(p));
    Ok(Sample { features: Arc::new(features), future, valid })
}

/// The 80 future positions in a frame, and which of them were recorded.
pub(crate) fn future(track: &Track, local: impl Fn(Point) -> Point) -> (Vec<[f32; 2]>, Vec<bool>) {
    let frames = NOW + 1..=NOW + HORIZON;
    let valid: Vec<bool> = frames.clone().map(|f| track.is_valid(f)).collect();
    let position =
        |f: usize| if track.is_valid(f) { local(track.point(f)).map(|x| x as f32) } else { [0.0; 2] };
    (frames.map(position).collect(), valid)
}

/// Whether a track moves, and whether its last step is recorded; `None` if it cannot be a sample.
fn usable(track: &Track) -> Option<(bool, bool)> {
    if track.kind != TrackKind::Vehicle || !track.is_valid(NOW) {
        return None;
    }
    let future = NOW + 1..NOW + HORIZON + 1;
    if track.count_valid(future.clone()) < LEAST {
        return None;
    }
    let last = future.rev().find(|f| track.is_valid(*f))?;
    let moves = distance(track.point(NOW), track.point(last)) > MOVING;
    Some((moves, last == NOW + HORIZON))
}

/// A track's recorded future in the world frame.
pub fn recorded(track: &Track) -> Recorded {
    let (positions, valid): (Vec<Point>, Vec<bool>) = (NOW + 1..=NOW + HORIZON)
        .map(|f| if track.is_valid(f) { (track.point(f), true) } else { ([0.0; 2], false) })
        .unzip();
    let last = (NOW..=NOW + HORIZON).rev().find(|f| track.is_valid(*f)).unwrap_or(NOW);
    let [vx, vy] = track.velocity[NOW];
    Recorded { positions, valid, heading: track.heading[last], speed: vx.hypot(vy) }
}
