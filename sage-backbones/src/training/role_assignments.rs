//! Role assignments: other pairs of ego and adversary in a recorded scene, as more data for fine-tuning.

use sage_core::{
    geometry::distance,
    motion::{HORIZON, NOW},
    scene::{Scene, Track, TrackKind},
};

/// Valid frames of the future that a role needs.
const SEEN: usize = 60;
/// Least distance that it must drive in them, metres.
const MOVES: f64 = 4.0;

/// The scene under other role assignments, at most `most`: first ego and adversary swapped, then the other
/// vehicles as adversary, the nearest to the ego first. Vehicles that stand, or that are valid for less than 6 s
/// of the future, take no role.
pub fn role_assignments(scene: &Scene, most: usize) -> Vec<Scene> {
    let Some(adversary) = scene.adversary else { return Vec::new() };
    let mut pairs = Vec::new();
    if can_take_role(&scene.tracks[adversary]) && can_take_role(scene.ego()) {
        pairs.push((adversary, scene.ego));
    }
    let mut near: Vec<(f64, usize)> = (0..scene.tracks.len())
        .filter(|&k| k != scene.ego && k != adversary && can_take_role(&scene.tracks[k]))
        .map(|k| (nearest(&scene.tracks[k], scene.ego()), k))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    pairs.extend(near.into_iter().map(|(_, k)| (scene.ego, k)));
    let assign = |(ego, adversary): (usize, usize)| {
        let ids = [ego, adversary].map(|k| scene.tracks[k].id.clone());
        scene.clone().with_roles(Some(&ids[0]), Some(&ids[1])).ok()
    };
    pairs.into_iter().take(most).filter_map(assign).collect()
}

fn can_take_role(track: &Track) -> bool {
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
