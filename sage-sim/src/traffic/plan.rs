//! A trajectory for one track in place of its log, usually the adversary's, and what drives it from a frame on.

use sage_core::{
    Error as CoreError,
    generator::{Attack, Reaction},
    geometry::MAX_COORDINATE,
    motion::Trajectory,
    scene::{Scene, Track},
};

use crate::Error;

/// A trajectory for one track in place of its log.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Index of the track.
    pub track: usize,
    /// The recording that it follows, as long as the scene.
    pub motion: Track,
    /// What drives the track from a frame on; `None` if it follows the recording to the end.
    pub reaction: Option<Reaction>,
}

impl Plan {
    /// The plan of the adversary: its log up to *now*, then a trajectory for frames 11 to 90; absent after it.
    ///
    /// *Errors*: [`CoreError::Scene`] if the scene has no adversary.
    pub fn of_adversary(scene: &Scene, trajectory: &Trajectory) -> Result<Self, Error> {
        let track = scene.adversary_index()?;
        Ok(Self { track, motion: scene.tracks[track].following(trajectory), reaction: None })
    }

    /// The plan of an attack, with its reaction.
    ///
    /// *Errors*: as [`Plan::of_adversary`].
    pub fn of_attack(scene: &Scene, attack: &Attack) -> Result<Self, Error> {
        Ok(Self { reaction: attack.reaction.clone(), ..Self::of_adversary(scene, attack.trajectory())? })
    }

    /// Checks that the plan fits a scene.
    ///
    /// *Errors*: [`Error::Plan`] for a track that the scene has not, or the ego; [`CoreError::Length`] for
    /// another number of frames; [`CoreError::NotFinite`] for a number that is not finite.
    pub(crate) fn check(&self, scene: &Scene) -> Result<(), Error> {
        if self.track >= scene.tracks.len() || self.track == scene.ego {
            let problem = format!("track number {} cannot have a plan", self.track);
            return Err(Error::Plan { scene: scene.id.clone(), problem });
        }
        let Track { position, heading, velocity, size, valid, .. } = &self.motion;
        let columns = [position.len(), heading.len(), velocity.len(), size.len(), valid.len()];
        if let Some(found) = columns.into_iter().find(|length| *length != scene.frames) {
            return Err(CoreError::Length { what: "plan".to_owned(), found, expected: scene.frames }.into());
        }
        let is_finite = |frame: usize| {
            let numbers = position[frame].iter().chain(&velocity[frame]).chain(&size[frame]);
            numbers.chain([&heading[frame]]).all(|x| x.abs() <= MAX_COORDINATE)
        };
        match (0..scene.frames).find(|&frame| valid[frame] && !is_finite(frame)) {
            Some(index) => {
                let what = format!("plan of track `{}`", scene.tracks[self.track].id);
                Err(CoreError::NotFinite { what, index, point: self.motion.point(index) }.into())
            }
            None => Ok(()),
        }
    }
}
