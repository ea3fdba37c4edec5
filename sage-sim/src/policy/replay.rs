//! Replay of the recording, pose by pose. It knows its own future and reacts to nothing.

use sage_core::{
    motion::Pose,
    registry::{Entry, NoOptions},
    scene::Track,
};

use super::{Driver, EgoPolicy, Knowledge, Start, View};
use crate::{Error, world::Control};

/// The policy `replay`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Replay;

impl Entry<dyn EgoPolicy> for Replay {
    const NAME: &'static str = "replay";
    const SUMMARY: &'static str = "the recording, pose by pose; holds the last valid pose";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self))
    }
}

impl EgoPolicy for Replay {
    fn knows(&self) -> Knowledge {
        Knowledge::OwnLog
    }

    fn is_recording(&self) -> bool {
        true
    }

    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(Self))
    }
}

impl Driver for Replay {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let log = view.own_log().ok_or_else(|| view.error("replay needs its recording".to_owned()))?;
        Ok(logged(log, view.step() + 1))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

/// The logged pose at a frame; after a gap or the end the last valid pose, at rest.
pub(super) fn logged(track: &Track, frame: usize) -> Control {
    if track.is_valid(frame) {
        let [x, y] = track.point(frame);
        let pose = Pose::new(x, y, track.heading[frame]);
        return Control::Pose { pose, velocity: Some(track.velocity[frame]) };
    }
    let last = (0..frame.min(track.valid.len())).rev().find(|&f| track.valid[f]).unwrap_or(0);
    let [x, y] = track.point(last);
    Control::Pose { pose: Pose::new(x, y, track.heading[last]), velocity: Some([0.0, 0.0]) }
}
