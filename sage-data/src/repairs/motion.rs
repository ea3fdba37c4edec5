//! Velocities and headings from positions.

use sage_core::{
    geometry::{Point, norm, sub},
    motion::kinematics::paper::MOVING,
    scene::{Scene, Track},
};

use super::{clock::Clock, note};

/// Speed from which a displacement says how long a frame lasts, m/s.
const FAST: f64 = 2.0;
/// Largest number of pairs of frames that are looked at.
const MOST: usize = 20_000;

/// Replaces velocities and headings of valid frames by those of the positions: central
/// differences, at the ends of a run of valid frames one-sided. A heading is kept while a road user stands.
pub(super) fn recompute(scene: &mut Scene, clock: &Clock) {
    for track in &mut scene.tracks {
        recompute_track(track, clock);
    }
    scene.notes.push(note("trust-positions", "velocities and headings are those of the positions"));
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
        if end > first && norm(velocity) >= MOVING {
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
}

/// Median time between frames that the displacements of moving road users have at their velocities, seconds; `None`
/// if nobody moves.
pub fn implied_step(tracks: &[Track]) -> Option<f64> {
    let mut steps = Vec::new();
    for track in tracks {
        for frame in 1..track.valid.len() {
            if !(track.valid[frame] && track.valid[frame - 1]) {
                continue;
            }
            let [a, b] = [frame - 1, frame].map(|f| track.velocity[f]);
            let speed = norm([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
            if speed > FAST {
                steps.push(norm(sub(track.point(frame), track.point(frame - 1))) / speed);
            }
        }
        if steps.len() > MOST {
            break;
        }
    }
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}
