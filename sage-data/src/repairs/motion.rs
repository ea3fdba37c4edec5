//! Velocities and headings from positions.

use sage_core::{
    geometry::{Point, norm, sub, wrap_angle},
    motion::kinematics::paper::MOVING,
    scene::{Scene, Track},
};

use super::{Repair, clock::Clock};
use crate::headings::stands;

/// Replaces velocities and headings of valid frames by those of the positions: central
/// differences, at the ends of a run of valid frames one-sided. While a road user stands its heading is the one that it came
/// or drives off with; without any, the one that most of its frames have.
pub(super) fn recompute(scene: &mut Scene, clock: &Clock) {
    for track in &mut scene.tracks {
        recompute_track(track, clock);
    }
    scene.notes.push(Repair::TrustPositions.note("velocities and headings are those of the positions"));
}

fn recompute_track(track: &mut Track, clock: &Clock) {
    let frames = track.valid.len();
    let mut last: Option<f64> = None;
    let mut waiting: Vec<usize> = Vec::new();
    for frame in 0..frames {
        if !track.valid[frame] {
            continue;
        }
        let first = if frame > 0 && track.valid[frame - 1] { frame - 1 } else { frame };
        let end = if track.is_valid(frame + 1) { frame + 1 } else { frame };
        let elapsed = clock.between(first, end);
        let velocity: Point = match end - first {
            0 => track.velocity[frame],
            _ => sub(track.point(end), track.point(first)).map(|d| d / elapsed),
        };
        track.velocity[frame] = velocity;
        if end > first && norm(velocity) >= MOVING && !stands(track, frame, clock.step()) {
            let heading = velocity[1].atan2(velocity[0]);
            last = Some(heading);
            // Before it moved it stood as it then drives off.
            waiting.drain(..).for_each(|before| track.heading[before] = heading);
        }
        match last {
            Some(heading) => track.heading[frame] = heading,
            None => waiting.push(frame),
        }
    }
    if let Some(heading) = most_common(waiting.iter().map(|frame| track.heading[*frame])) {
        waiting.into_iter().for_each(|frame| track.heading[frame] = heading);
    }
}

/// The first of the headings in the tenth of a turn that holds most of them, with its neighbours.
fn most_common(headings: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    const BINS: usize = 10;
    let bin = |heading: f64| {
        let share = wrap_angle(heading) / std::f64::consts::TAU + 0.5;
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    let mut counts = [0usize; BINS];
    headings.clone().for_each(|heading| counts[bin(heading)] += 1);
    let around = |k: usize| counts[k] * 2 + counts[(k + 1) % BINS] + counts[(k + BINS - 1) % BINS];
    // The first of equals.
    let fullest = (0..BINS).rev().max_by_key(|k| around(*k))?;
    let mut all = headings;
    all.clone().find(|heading| bin(*heading) == fullest).or_else(|| all.next())
}
