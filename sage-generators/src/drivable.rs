//! Drivability of trajectories: proposers prefer trajectories that a car can follow.

use sage_core::{
    Error,
    geometry::SegmentIndex,
    motion::Trajectory,
    objective::{
        Body, Candidate, is_within_limits, touches_edge,
        turning::{TURN, tight_turn},
    },
};

/// Whether a car can follow a candidate: at every step it is within the thresholds of the kinematic penalty, it turns no
/// more tightly than a car can, and touches none of the edges. The map is part of the observation.
///
/// ```
/// use sage_core::{motion::Trajectory, objective::Body, scene::SceneIndex};
/// use sage_data::procedural::{Kind, generate};
/// use sage_generators::{is_drivable, logged_future};
///
/// let scene = generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?;
/// let (body, index) = (Body::of(&scene)?, SceneIndex::new(scene.map.clone()));
/// assert!(is_drivable(&body.candidate(logged_future(&scene)?), index.edges()));
/// // From the same start at 90 m/s, which no car reaches in a step.
/// let [x, y] = scene.adversary()?.point(10);
/// let leap = (1..=80).map(|step| [x + 9.0 * f64::from(step), y]).collect();
/// assert!(!is_drivable(&body.candidate(Trajectory::new("leap", leap)?), index.edges()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn is_drivable(candidate: &Candidate, edges: &SegmentIndex) -> bool {
    is_within_limits(candidate.profile())
        && tight_turn(candidate, TURN).is_none()
        && !touches_edge(candidate, edges)
}

/// The first `most` drivable trajectories, with their indices and in their order. If there are fewer, other
/// trajectories follow. Trajectories beyond those needed are not computed.
///
/// *Errors*: the first error of a trajectory.
pub fn drivable(
    trajectories: impl IntoIterator<Item = Result<Trajectory, Error>>,
    most: usize,
    body: &Body,
    edges: &SegmentIndex,
) -> Result<Vec<(usize, Trajectory)>, Error> {
    let (mut accepted, mut others) = (Vec::with_capacity(most), Vec::new());
    let mut trajectories = trajectories.into_iter().enumerate();
    while accepted.len() < most
        && let Some((number, trajectory)) = trajectories.next()
    {
        let candidate = body.candidate(trajectory?);
        let is_drivable = is_drivable(&candidate, edges);
        let found = (number, candidate.into_trajectory());
        if is_drivable {
            accepted.push(found);
        } else if others.len() < most {
            others.push(found);
        }
    }
    let missing = most - accepted.len();
    accepted.extend(others.into_iter().take(missing));
    Ok(accepted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::{
        motion::{HORIZON, NOW},
        scene::SceneIndex,
    };

    #[test]
    fn trajectories_that_no_car_can_follow_come_last() {
        let scene = sage_data::procedural::generate(sage_data::procedural::Kind::Straight, 1, 0).unwrap();
        let index = SceneIndex::new(scene.map.clone());
        let edges = index.edges();
        let body = Body::of(&scene).unwrap();
        let logged = crate::logged_future(&scene).unwrap();
        // From the logged position at 90 m/s along x.
        let start = scene.adversary().unwrap().point(NOW);
        let leap = (1..=HORIZON).map(|t| [start[0] + 9.0 * t as f64, start[1]]).collect();
        let leap = Trajectory::new("leap", leap).unwrap();
        let is_followable = |trajectory: &Trajectory| is_drivable(&body.candidate(trajectory.clone()), edges);
        assert!(is_followable(&logged) && !is_followable(&leap));
        let trajectories = [leap.clone(), logged.clone(), leap, logged];
        let accepted = |most| -> Vec<usize> {
            let accepted = drivable(trajectories.iter().cloned().map(Ok), most, &body, edges).unwrap();
            accepted.into_iter().map(|(number, _)| number).collect()
        };
        assert_eq!(accepted(2), [1, 3]);
        assert_eq!(accepted(3), [1, 3, 0]);
    }
}
