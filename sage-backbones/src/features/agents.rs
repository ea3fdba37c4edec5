//! Rows of the agents: their states over the last second.

use sage_core::{
    motion::NOW,
    scene::{Scene, TrackKind},
};

use super::{Frame, Table, VECTOR_COLUMNS};

/// Maximum number of agents with rows, the target included.
const AGENTS: usize = 32;
/// Frames of the history with a row each.
const FRAMES: [usize; 6] = [0, 2, 4, 6, 8, NOW];

/// Appends the rows of the target, the ego and then the nearest other agents that are valid in one of the
/// frames; and the number of rows of each.
pub(super) fn append(
    scene: &Scene,
    target: usize,
    frame: &Frame,
    vectors: &mut Table,
    lengths: &mut Vec<usize>,
) {
    let mut order: Vec<(f64, usize)> = Vec::with_capacity(scene.tracks.len());
    for (k, track) in scene.tracks.iter().enumerate() {
        let Some(last) = FRAMES.into_iter().rev().find(|f| track.is_valid(*f)) else { continue };
        let [x, y] = frame.frame_from_world(track.point(last));
        let rank = if k == target {
            -2.0
        } else if k == scene.ego {
            -1.0
        } else {
            x * x + y * y
        };
        order.push((rank, k));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for &(_, k) in order.iter().take(AGENTS) {
        let track = &scene.tracks[k];
        let first = vectors.rows();
        for f in FRAMES.into_iter().filter(|f| track.is_valid(*f)) {
            let position = frame.frame_from_world(track.point(f));
            let velocity = frame.direction_from_world(track.velocity[f]);
            let (sin, cos) = (track.heading[f] - frame.heading()).sin_cos();
            let mut row = [0.0; VECTOR_COLUMNS];
            row[0] = (position[0] / 40.0) as f32;
            row[1] = (position[1] / 40.0) as f32;
            row[2] = cos as f32;
            row[3] = sin as f32;
            row[4] = (velocity[0] / 10.0).clamp(-8.0, 8.0) as f32;
            row[5] = (velocity[1] / 10.0).clamp(-8.0, 8.0) as f32;
            row[6] = (track.size[f][0] / 5.0).min(8.0) as f32;
            row[7] = (track.size[f][1] / 2.0).min(8.0) as f32;
            row[8] = (NOW - f) as f32 / NOW as f32;
            row[9] = f32::from(k == target);
            row[10] = f32::from(k == scene.ego);
            let kind = match track.kind {
                TrackKind::Vehicle => 11,
                TrackKind::Pedestrian => 12,
                TrackKind::Cyclist => 13,
                TrackKind::Other(_) => 14,
            };
            row[kind] = 1.0;
            vectors.values.extend_from_slice(&row);
        }
        lengths.push(vectors.rows() - first);
    }
}
