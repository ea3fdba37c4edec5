//! Another frame becomes *now*: the scene is cut to the frames around it.

use std::{ops::Range, path::Path};

use sage_core::{
    motion::{HORIZON, NOW},
    scene::Scene,
};

use crate::Error;

/// Cuts a scene to the frames from 10 before `now` to 80 after it, as far as they exist. Returns the frames.
///
/// *Errors*: [`Error::Field`] if the scene does not have 10 frames before it.
pub(super) fn around(scene: &mut Scene, now: usize, path: &Path) -> Result<Range<usize>, Error> {
    if now < NOW || now >= scene.frames {
        return Err(Error::Field {
            path: path.to_owned(),
            field: "length".to_owned(),
            found: format!("{} frames at 10 Hz, so frame {now} cannot be now", scene.frames),
            expected: match scene.frames.checked_sub(NOW + 1) {
                Some(_) => format!("--now {NOW} to {}", scene.frames - 1),
                None => format!("a recording of at least {} frames", NOW + 1),
            },
        });
    }
    let frames = now - NOW..(now + HORIZON + 1).min(scene.frames);
    for track in &mut scene.tracks {
        track.position = track.position[frames.clone()].to_vec();
        track.heading = track.heading[frames.clone()].to_vec();
        track.velocity = track.velocity[frames.clone()].to_vec();
        track.size = track.size[frames.clone()].to_vec();
        track.valid = track.valid[frames.clone()].to_vec();
    }
    for light in &mut scene.lights {
        light.states = light.states[frames.clone()].to_vec();
    }
    if !scene.timestamps.is_empty() {
        scene.timestamps = scene.timestamps[frames.clone()].to_vec();
    }
    scene.frames = frames.len();
    Ok(frames)
}
