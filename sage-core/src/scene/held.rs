//! Frames at which a road user is held in its place.
//!
//! A standing road user is there during a gap, but that is known only afterwards: [`Held`] keeps such frames out of
//! observations and of written files.

use std::ops::Range;

use super::Track;
use crate::geometry::Point;

/// Frames at which a standing road user was not seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Index of its track.
    pub track: usize,
    /// The frames.
    pub frames: Range<usize>,
    /// What the file holds there.
    recorded: Vec<Recorded>,
}

/// Position, heading, velocity and size of a frame.
type Recorded = ([f64; 3], f64, Point, [f64; 3]);

impl Held {
    /// Holds a track, of an index in its scene, where it is at a valid frame, up to another frame.
    pub fn between(index: usize, track: &mut Track, last: usize, next: usize) -> Self {
        let frames = last + 1..next;
        let row =
            |frame| (track.position[frame], track.heading[frame], track.velocity[frame], track.size[frame]);
        let recorded = frames.clone().map(row).collect();
        for frame in frames.clone() {
            track.position[frame] = track.position[last];
            track.heading[frame] = track.heading[last];
            track.velocity[frame] = [0.0; 2];
            track.size[frame] = track.size[last];
            track.valid[frame] = true;
        }
        Self { track: index, frames, recorded }
    }

    /// Gives a track back what the file holds.
    pub(super) fn release(&self, track: &mut Track) {
        for (frame, (position, heading, velocity, size)) in self.frames.clone().zip(&self.recorded) {
            (track.position[frame], track.heading[frame]) = (*position, *heading);
            (track.velocity[frame], track.size[frame]) = (*velocity, *size);
            track.valid[frame] = false;
        }
    }

    /// Ends before a frame: from there on the track follows something else.
    pub fn end_before(&mut self, frame: usize) {
        self.frames.end = self.frames.end.min(frame);
        self.frames.start = self.frames.start.min(self.frames.end);
    }
}
