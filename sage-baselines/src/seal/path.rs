//! The input of the learned score: where the ego is, seen from the adversary, at frames 0 to 90.

use sage_core::{
    geometry::Point,
    motion::{NOW, Pose, kinematics::release},
    objective::EgoPath,
    scene::{Scene, Track},
};

use crate::seal::networks::relative_path;

/// The ego's undisturbed paths seen from an adversary that follows a plan after its history: for each path of the ego one
/// triple (forward, left, both are there) a frame. Headings of the adversary are those of its polyline.
pub fn relative_paths(
    scene: &Scene,
    adversary: &Track,
    plan: &[Point],
    egos: &[EgoPath],
) -> Vec<Vec<[f32; 3]>> {
    let first =
        (0..=NOW).find(|&frame| (frame..=NOW).all(|frame| adversary.is_valid(frame))).unwrap_or(NOW + 1);
    let history = (first..=NOW).map(|frame| adversary.point(frame));
    let points: Vec<Point> = history.chain(plan.iter().copied()).collect();
    let poses = points.iter().zip(release::headings(&points));
    let poses = poses.map(|(position, heading)| Some(Pose { position: *position, heading }));
    let poses: Vec<Option<Pose>> = std::iter::repeat_n(None, first).chain(poses).collect();
    let ego = scene.ego();
    let seen = |path: &EgoPath| {
        let before = (0..=NOW).map(|frame| ego.is_valid(frame).then(|| ego.point(frame)));
        let after = path.positions().iter().copied().map(Some);
        relative_path(&before.chain(after).collect::<Vec<_>>(), &poses)
    };
    egos.iter().map(seen).collect()
}
