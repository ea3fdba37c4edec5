//! Velocities and headings from positions.

use sage_core::{
    geometry::{Point, norm, sub},
    motion::kinematics::paper::MOVING,
    scene::{Scene, Track},
};

use super::{Repair, clock::Clock};

/// Replaces velocities and headings of valid frames by those of the positions: central
/// differences, at the ends of a run of valid frames one-sided. A heading is kept while a road user stands.
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
