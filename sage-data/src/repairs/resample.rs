//! Resampling to 10 Hz.
//!
//! Positions follow a cubic Hermite curve through the recorded positions with the recorded velocities; headings turn the
//! short way; velocities, heights and sizes are linear. A frame is valid if both recorded neighbours are; one that
//! falls on a recorded frame is that frame. A light has the state of the last recorded frame.

use std::path::Path;

use sage_core::{
    geometry::{Point, wrap_angle},
    motion::DT,
    scene::{Scene, Track},
};

use super::Repair;
use crate::{Error, metadrive::MAX_FRAMES};

/// Distance in time at which a frame falls on a recorded one, seconds.
const SAME: f64 = 1e-4;
/// Longest gap between frames over which motion is interpolated, seconds, unless the recording is slower than 5 Hz.
const LONGEST_GAP: f64 = 0.25;
/// Time up to which 32 bits tell milliseconds apart, seconds.
const LONG_CLOCK: f64 = 8192.0;
/// Tolerance of the last frame, as a share of a frame: the end of a recording is rounded.
const END: f64 = 1e-3;

/// Largest number of frames of all tracks together after resampling, unless the file has as many: an attack then takes less than 1 GB.
const MOST_STATES: usize = 1_500_000;

/// Refuses a recording that would become too large.
///
/// *Errors*: [`Error::Field`].
pub(super) fn check_size(scene: &Scene, times: &[f64], step: f64, path: &Path) -> Result<(), Error> {
    let count = (times[times.len() - 1] - times[0]) / DT + 1.0;
    let states = count * scene.tracks.len() as f64;
    let limit = MOST_STATES.max(scene.frames * scene.tracks.len()) as f64;
    if states <= limit && count <= MAX_FRAMES as f64 {
        return Ok(());
    }
    Err(Error::Field {
        path: path.to_owned(),
        field: "metadata/ts".to_owned(),
        found: format!("{} frames, {step:.3} s apart, which are {count:.0} at 10 Hz", scene.frames),
        expected: format!("at most {MAX_FRAMES} frames and {MOST_STATES} states at 10 Hz"),
    })
}

/// Place of a new frame among the recorded ones.
#[derive(Clone, Copy)]
struct Place {
    /// The recorded frame at or before it.
    before: usize,
    /// Time from that frame to the next, seconds; 0 if the new frame is the recorded one.
    gap: f64,
    /// Share of the gap, 0 to below 1.
    share: f64,
}

impl Place {
    fn nearest(&self) -> usize {
        if self.share < 0.5 { self.before } else { self.before + 1 }
    }
}

/// Resamples a scene with increasing times. Returns the recorded frame nearest to each new one.
pub(super) fn to_ten_hertz(scene: &mut Scene, times: &[f64], step: f64) -> Vec<usize> {
    let places = places(times);
    let longest = LONGEST_GAP.max(1.5 * step);
    let gaps = times.windows(2).filter(|w| w[1] - w[0] > longest).count();
    if gaps > 0 {
        let text =
            format!("{gaps} gaps of more than {longest:.2} s in the times; the frames there are not valid");
        scene.notes.push(Repair::FrameRate.note(text));
    }
    for track in &mut scene.tracks {
        *track = resampled(track, &places, longest);
    }
    for light in &mut scene.lights {
        light.states = places.iter().map(|place| light.states[place.before]).collect();
    }
    scene.frames = places.len();
    // As files and records hold times, in 32 bits; a clock that counts from long ago has no such digits.
    let time = |frame: usize| times[0] + DT * frame as f64;
    let is_short = time(places.len()).abs() < LONG_CLOCK;
    scene.timestamps = (0..places.len())
        .map(|frame| if is_short { f64::from(time(frame) as f32) } else { time(frame) })
        .collect();
    places.iter().map(Place::nearest).collect()
}

fn places(times: &[f64]) -> Vec<Place> {
    let (first, last) = (times[0], times[times.len() - 1]);
    let count = ((last - first) / DT + END).floor() as usize + 1;
    let mut before = 0;
    (0..count)
        .map(|frame| {
            let time = first + DT * frame as f64;
            while before + 1 < times.len() && times[before + 1] <= time + SAME {
                before += 1;
            }
            let rest = time - times[before];
            match times.get(before + 1) {
                Some(next) if rest > SAME => {
                    let gap = next - times[before];
                    Place { before, gap, share: rest / gap }
                }
                _ => Place { before, gap: 0.0, share: 0.0 },
            }
        })
        .collect()
}

fn resampled(track: &Track, places: &[Place], longest: f64) -> Track {
    let mut new = Track {
        id: track.id.clone(),
        kind: track.kind.clone(),
        position: Vec::with_capacity(places.len()),
        heading: Vec::with_capacity(places.len()),
        velocity: Vec::with_capacity(places.len()),
        size: Vec::with_capacity(places.len()),
        valid: Vec::with_capacity(places.len()),
    };
    for place in places {
        let (a, b) = (place.before, place.before + 1);
        let is_recorded = place.gap == 0.0;
        let is_valid = track.valid[a] && (is_recorded || track.valid[b] && place.gap <= longest);
        new.valid.push(is_valid);
        if is_recorded || !is_valid {
            // What is not valid is never read.
            let frame = if is_recorded { a } else { place.nearest() };
            new.position.push(track.position[frame]);
            new.heading.push(track.heading[frame]);
            new.velocity.push(track.velocity[frame]);
            new.size.push(track.size[frame]);
            continue;
        }
        let s = place.share;
        let mix = |x: f64, y: f64| x + s * (y - x);
        let [x, y] = hermite([track.point(a), track.point(b)], [track.velocity[a], track.velocity[b]], place);
        new.position.push([x, y, mix(track.position[a][2], track.position[b][2])]);
        new.heading.push(track.heading[a] + s * wrap_angle(track.heading[b] - track.heading[a]));
        new.velocity.push([0, 1].map(|k| mix(track.velocity[a][k], track.velocity[b][k])));
        new.size.push([0, 1, 2].map(|k| mix(track.size[a][k], track.size[b][k])));
    }
    new
}

/// The cubic through two positions with two velocities.
fn hermite([p, q]: [Point; 2], [v, w]: [Point; 2], place: &Place) -> Point {
    let (s, gap) = (place.share, place.gap);
    let (s2, s3) = (s * s, s * s * s);
    let [from, out, to, into] = [2.0 * s3 - 3.0 * s2 + 1.0, s3 - 2.0 * s2 + s, 3.0 * s2 - 2.0 * s3, s3 - s2];
    [0, 1].map(|k| from * p[k] + out * gap * v[k] + to * q[k] + into * gap * w[k])
}
