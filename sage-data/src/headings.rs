//! Warnings about headings that are wrong at a frame that decides, and about cars that turn while they stand.

use sage_core::{
    geometry::{Point, distance, norm, sub, wrap_angle},
    motion::{DT, NOW},
    scene::{Scene, Track, TrackKind},
};

use crate::warning::Warning;

/// Speed from which a car moves, m/s, and angle between heading and motion beyond which it drives backwards or is wrong.
const MOVING: f64 = 1.0;
const BACKWARDS: f64 = std::f64::consts::FRAC_PI_2;
/// Time before and after a frame, seconds, and distance within which a car stands in it, metres.
const WINDOW: f64 = 0.5;
const STANDING: f64 = 0.25;
/// Turn from one frame to the next that a standing car does not make, rad.
const TURN: f64 = 0.3;
/// Fewest such frames of a car that is named.
const FEWEST: usize = 3;
/// Names of cars in a warning.
const NAMED: usize = 3;

/// Warnings about headings at the frames that decide: *now* of ego and adversary, and the first frame of the ego, where drives
/// start.
pub(crate) fn at_deciding_frames(scene: &Scene) -> impl Iterator<Item = Warning> {
    let adversary = scene.adversary.map(|k| &scene.tracks[k]);
    let frames = [
        ("ego", Some(scene.ego()), 0, "drives begin in that direction"),
        ("ego", Some(scene.ego()), NOW, "forecasts begin in that direction"),
        ("adversary", adversary, NOW, "plans begin in that direction"),
    ];
    frames.into_iter().filter_map(|(role, track, frame, effect)| {
        let track = track?;
        let velocity = velocity_at(track, frame)?;
        let off = wrap_angle(track.heading[frame] - velocity[1].atan2(velocity[0])).abs();
        let detail = || {
            format!(
                "the heading of the {role} `{}` at frame {frame} is {:.0}° off its motion ({:.1} m/s), and {effect}; unless it \
                 drives backwards, --trust positions recomputes headings",
                track.id.escape_debug(),
                off.to_degrees(),
                norm(velocity)
            )
        };
        (norm(velocity) >= MOVING && off > BACKWARDS)
            .then(|| Warning::new("heading-against-motion", detail()))
    })
}

/// Velocity of a vehicle at a valid frame by its positions around it, m/s.
fn velocity_at(track: &Track, frame: usize) -> Option<Point> {
    let first = frame.checked_sub(1).filter(|first| track.is_valid(*first)).unwrap_or(frame);
    let last = if track.is_valid(frame + 1) { frame + 1 } else { frame };
    let is_known = track.kind == TrackKind::Vehicle && track.is_valid(frame) && last > first;
    is_known.then(|| sub(track.point(last), track.point(first)).map(|d| d / (DT * (last - first) as f64)))
}

/// Whether a track stays in its place around a valid frame. `step` is the time between two frames, seconds.
pub(crate) fn stands(track: &Track, frame: usize, step: f64) -> bool {
    let window = (WINDOW / step).round().max(1.0) as usize;
    let around = frame.saturating_sub(window)..=(frame + window).min(track.valid.len() - 1);
    let here = track.point(frame);
    around.filter(|f| track.valid[*f]).all(|f| distance(track.point(f), here) <= STANDING)
}

/// A warning about vehicles that turn while they stand.
pub(crate) fn of_standing(scene: &Scene) -> Option<Warning> {
    let (mut names, mut turns, mut frames) = (Vec::new(), 0, 0);
    for track in scene.tracks.iter().filter(|track| track.kind == TrackKind::Vehicle) {
        let turned = |frame: &usize| {
            let both = track.valid[*frame] && track.valid[frame - 1];
            both && wrap_angle(track.heading[*frame] - track.heading[frame - 1]).abs() > TURN
        };
        // Few cars turn at all.
        let found = (1..track.valid.len()).filter(turned).filter(|frame| stands(track, *frame, DT)).count();
        if found >= FEWEST {
            names.push(format!("`{}`", track.id.escape_debug()));
            turns += found;
            let valid = (0..track.valid.len()).filter(|frame| track.valid[*frame]);
            frames += valid.filter(|frame| stands(track, *frame, DT)).count();
        }
    }
    if names.is_empty() {
        return None;
    }
    let more = match names.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    names.truncate(NAMED);
    let detail = format!(
        "cars turn while they stand, in {:.0} % of their standing frames ({}{more}); --trust positions holds one heading",
        100.0 * turns as f64 / frames.max(1) as f64,
        names.join(", ")
    );
    Some(Warning::new("turns-while-standing", detail))
}
