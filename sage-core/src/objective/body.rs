//! The adversary's body: pose, size and convention that turn a trajectory into a candidate.

use super::{Candidate, Convention, Sizes, candidate::Car, ground::Ground};
use crate::{
    Error,
    geometry::distance,
    motion::{DT, HORIZON, NOW, Pose, Trajectory, kinematics::paper},
    scene::Scene,
};

/// Pose at *now*, size, and the convention for trajectories. If the adversary is valid *now* or earlier, it
/// holds no information about the future.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    start: Option<Pose>,
    /// Heading at the valid frame nearest to *now*, preferably in history.
    last_heading: f64,
    pub(super) car: Car,
}

impl Body {
    /// The adversary of a scene with its logged size, in the `paper` convention.
    ///
    /// *Errors*: [`Error::Scene`] if the scene has no adversary.
    pub fn of(scene: &Scene) -> Result<Self, Error> {
        let (_, size) = Sizes::Logged.of(scene, scene.adversary_index()?);
        Self::new(scene, size, Convention::Paper, false)
    }

    pub(super) fn new(
        scene: &Scene,
        size: [f64; 2],
        convention: Convention,
        mirrored: bool,
    ) -> Result<Self, Error> {
        let track = scene.adversary()?;
        let start =
            track.is_valid(NOW).then(|| Pose { position: track.point(NOW), heading: track.heading[NOW] });
        let valid = (0..track.valid.len()).filter(|&f| track.is_valid(f));
        let nearest = valid.min_by_key(|f| (*f > NOW, f.abs_diff(NOW)));
        let last_heading = nearest.map_or(0.0, |frame| track.heading[frame]);
        let car = Car { size, convention, mirrored, reverses: track.reverses(NOW) };
        Ok(Self { start, last_heading, car })
    }

    /// Prepares a trajectory for scoring. If the adversary is not valid *now*, its position is extrapolated
    /// from the first two planned points. So is its heading if these points move; otherwise it is the last
    /// valid heading.
    pub fn candidate(&self, trajectory: Trajectory) -> Candidate {
        self.candidate_on(trajectory, HORIZON, None)
    }

    /// As [`Body::candidate`], evaluated up to a step, on a map.
    pub(super) fn candidate_on(
        &self,
        trajectory: Trajectory,
        horizon: usize,
        ground: Option<Ground>,
    ) -> Candidate {
        let start = self.start.unwrap_or_else(|| {
            let [a, b] = [trajectory.points()[0], trajectory.points()[1]];
            let position = [2.0 * a[0] - b[0], 2.0 * a[1] - b[1]];
            let moves = distance(a, b) / DT >= paper::MOVING;
            let heading = if moves { (b[1] - a[1]).atan2(b[0] - a[0]) } else { self.last_heading };
            Pose { position, heading }
        });
        Candidate::new(trajectory, start, &self.car, horizon, ground)
    }
}
