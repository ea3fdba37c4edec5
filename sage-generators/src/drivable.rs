//! Which trajectories a car could drive: proposers pass over the others.

use sage_core::{
    Error,
    motion::Trajectory,
    objective::{Body, Candidate, is_within_limits, touches_boundary},
    scene::SceneIndex,
};

/// Whether a car could drive a candidate: at every step within the limits at which the kinematic penalty
/// begins to bite, and over no road edge, which the driver knows as well as we do.
pub fn is_drivable(candidate: &Candidate, index: &SceneIndex) -> bool {
    is_within_limits(candidate.profile()) && !touches_boundary(candidate, index)
}

/// The first `most` of some trajectories that a car could drive, with their numbers and in their order; if they
/// are fewer, the others follow. What comes after the last of them is not asked for.
///
/// *Errors*: the first of a trajectory.
pub fn drivable(
    trajectories: impl IntoIterator<Item = Result<Trajectory, Error>>,
    most: usize,
    body: &Body,
    index: &SceneIndex,
) -> Result<Vec<(usize, Trajectory)>, Error> {
    let (mut kept, mut others) = (Vec::with_capacity(most), Vec::new());
    let mut trajectories = trajectories.into_iter().enumerate();
    while kept.len() < most
        && let Some((number, trajectory)) = trajectories.next()
    {
        let candidate = body.candidate(trajectory?);
        let is_drivable = is_drivable(&candidate, index);
        let found = (number, candidate.into_trajectory());
        if is_drivable {
            kept.push(found);
        } else if others.len() < most {
            others.push(found);
        }
    }
    let missing = most - kept.len();
    kept.extend(others.into_iter().take(missing));
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::motion::{HORIZON, NOW};

    #[test]
    fn what_no_car_can_do_comes_last() {
        let scene = sage_data::procedural::generate(sage_data::procedural::Kind::Straight, 1, 0).unwrap();
        let index = SceneIndex::new(scene.map.clone());
        let body = Body::of(&scene).unwrap();
        let logged = crate::logged_future(&scene).unwrap();
        // From the log's own place at 90 m/s along x.
        let start = scene.adversary().unwrap().point(NOW);
        let leap = (1..=HORIZON).map(|t| [start[0] + 9.0 * t as f64, start[1]]).collect();
        let leap = Trajectory::new("leap", leap).unwrap();
        let could = |path: &Trajectory| is_drivable(&body.candidate(path.clone()), &index);
        assert!(could(&logged) && !could(&leap));
        let paths = [leap.clone(), logged.clone(), leap, logged];
        let kept = |most| -> Vec<usize> {
            let kept = drivable(paths.iter().cloned().map(Ok), most, &body, &index).unwrap();
            kept.into_iter().map(|(number, _)| number).collect()
        };
        assert_eq!(kept(2), [1, 3]);
        assert_eq!(kept(3), [1, 3, 0]);
    }
}
