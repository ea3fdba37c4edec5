//! Other pairs of ego and adversary in a recorded scene: more to tune on from the same recordings.

use sage_core::{
    geometry::distance,
    motion::{HORIZON, NOW},
    scene::{Scene, Track, TrackKind},
};

/// Frames of the future that a vehicle must be seen in to play a role.
const SEEN: usize = 60;
/// Least way that it must go in them, metres.
const MOVES: f64 = 4.0;

/// The scene with other vehicles as adversary, at most so many of them: first ego and adversary change
/// places, then those follow that come nearest to the ego. Who stands or is soon out of sight plays
/// no role.
pub fn other_roles(scene: &Scene, most: usize) -> Vec<Scene> {
    let Some(adversary) = scene.adversary else { return Vec::new() };
    let mut pairs = Vec::new();
    if plays(&scene.tracks[adversary]) && plays(scene.ego()) {
        pairs.push((adversary, scene.ego));
    }
    let mut near: Vec<(f64, usize)> = (0..scene.tracks.len())
        .filter(|&k| k != scene.ego && k != adversary && plays(&scene.tracks[k]))
        .map(|k| (nearest(&scene.tracks[k], scene.ego()), k))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    pairs.extend(near.into_iter().map(|(_, k)| (scene.ego, k)));
    let cast = |(ego, adversary): (usize, usize)| {
        let ids = [ego, adversary].map(|k| scene.tracks[k].id.clone());
        scene.clone().with_roles(Some(&ids[0]), Some(&ids[1])).ok()
    };
    pairs.into_iter().take(most).filter_map(cast).collect()
}

fn plays(track: &Track) -> bool {
    let frames = NOW + 1..NOW + 1 + HORIZON;
    let Some(last) = frames.clone().rev().find(|&frame| track.is_valid(frame)) else { return false };
    track.kind == TrackKind::Vehicle
        && track.is_valid(NOW)
        && track.count_valid(frames) >= SEEN
        && distance(track.point(NOW), track.point(last)) >= MOVES
}

/// Least distance of two tracks at one time, metres.
fn nearest(a: &Track, b: &Track) -> f64 {
    let frames = (NOW..=NOW + HORIZON).filter(|&f| a.is_valid(f) && b.is_valid(f));
    frames.map(|f| distance(a.point(f), b.point(f))).fold(f64::INFINITY, f64::min)
}
