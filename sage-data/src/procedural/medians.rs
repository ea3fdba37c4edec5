//! Raised medians: nobody drives over them, and they separate an ego from its adversary. Scenes without a
//! median are left as they are.

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, cross, sub},
    motion::{HORIZON, NOW},
    objective::Candidate,
    scene::{Scene, SceneIndex, Track, TrackKind},
};

/// Largest distance of a median from the path of the ego or the adversary, metres.
const NEAR: f64 = 10.0;

/// Whether a vehicle of a scene touches a median at any frame.
pub(super) fn any_vehicle_touches(scene: &Scene, index: &SceneIndex) -> bool {
    let mut cars = scene.tracks.iter().filter(|t| t.kind == TrackKind::Vehicle);
    cars.any(|t| (0..scene.frames).any(|f| t.is_valid(f) && touches(&t.oriented_box(f), index)))
}

/// Whether a candidate touches a median.
pub(super) fn touched_by(candidate: &Candidate, index: &SceneIndex) -> bool {
    candidate.map_boxes().iter().any(|b| touches(b, index))
}

fn touches(b: &OrientedBox, index: &SceneIndex) -> bool {
    let medians = index.medians();
    medians.near(&b.aabb()).flatten().any(|k| {
        let segment = &medians.segments()[k];
        b.intersects_segment(segment.a, segment.b)
    })
}

/// Whether a median separates two vehicles: it is between them now, and near the path of one of them. True
/// in a scene without medians.
pub(super) fn separate(a: &Track, b: &Track, index: &SceneIndex) -> bool {
    index.medians().segments().is_empty()
        || is_between(a, b, index) && [a, b].into_iter().any(|track| is_near(track, index))
}

fn is_between(a: &Track, b: &Track, index: &SceneIndex) -> bool {
    let (a, b) = (a.point(NOW), b.point(NOW));
    let medians = index.medians();
    medians.near(&Aabb::of([a, b])).flatten().any(|k| {
        let segment = &medians.segments()[k];
        are_on_both_sides([a, b], [segment.a, segment.b]) && are_on_both_sides([segment.a, segment.b], [a, b])
    })
}

/// Whether the line through the second pair of points separates the first pair.
fn are_on_both_sides(points: [Point; 2], line: [Point; 2]) -> bool {
    let side = |p: Point| cross(sub(line[1], line[0]), sub(p, line[0]));
    side(points[0]) * side(points[1]) < 0.0
}

/// Whether a median is near a vehicle's future path.
fn is_near(track: &Track, index: &SceneIndex) -> bool {
    (NOW + 1..=NOW + HORIZON).any(|f| index.medians().nearest(track.point(f), NEAR, |_| true).is_some())
}
