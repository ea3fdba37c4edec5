//! Role assignments: other pairs of ego and adversary in a recorded scene, as additional data for
//! fine-tuning.

use sage_core::{
    geometry::distance,
    motion::{HORIZON, NOW},
    scene::{Scene, Track, TrackKind},
};

/// Least number of valid future frames of an ego or adversary.
const VALID_FRAMES: usize = 60;
/// Least distance from the present position to the last valid one, metres.
const DISTANCE: f64 = 4.0;

/// The scene under other role assignments, at most `most`. The first has ego and adversary swapped. The next
/// ones have another vehicle as adversary, the nearest to the ego first. Vehicles that stand, or that are
/// valid in less than 6 s of the future, are neither ego nor adversary.
pub fn role_assignments(scene: &Scene, most: usize) -> Vec<Scene> {
    let Some(adversary) = scene.adversary else { return Vec::new() };
    // A network predicts what is seen *now*.
    let seen = scene.as_observed();
    let mut pairs = Vec::new();
    if is_eligible(&seen.tracks[adversary]) && is_eligible(seen.ego()) {
        pairs.push((adversary, scene.ego));
    }
    let mut others: Vec<(f64, usize)> = (0..scene.tracks.len())
        .filter(|&k| k != scene.ego && k != adversary && is_eligible(&seen.tracks[k]))
        .map(|k| (nearest(&seen.tracks[k], seen.ego()), k))
        .collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    pairs.extend(others.into_iter().map(|(_, k)| (scene.ego, k)));
    let assign = |(ego, adversary): (usize, usize)| {
        let ids = [ego, adversary].map(|k| scene.tracks[k].id.clone());
        scene.clone().with_roles(Some(&ids[0]), Some(&ids[1])).ok()
    };
    pairs.into_iter().take(most).filter_map(assign).collect()
}

/// Whether a track can be ego or adversary.
fn is_eligible(track: &Track) -> bool {
    let frames = NOW + 1..NOW + 1 + HORIZON;
    let Some(last) = frames.clone().rev().find(|&frame| track.is_valid(frame)) else { return false };
    track.kind == TrackKind::Vehicle
        && track.is_valid(NOW)
        && track.count_valid(frames) >= VALID_FRAMES
        && distance(track.point(NOW), track.point(last)) >= DISTANCE
}

/// Least distance of two tracks over the frames in which both are valid, metres.
fn nearest(a: &Track, b: &Track) -> f64 {
    let frames = (NOW..=NOW + HORIZON).filter(|&f| a.is_valid(f) && b.is_valid(f));
    frames.map(|f| distance(a.point(f), b.point(f))).fold(f64::INFINITY, f64::min)
}
