//! Speed profiles: a trajectory retimed to be earlier or later in the middle, with the same end time.

use sage_backbones::features::EdgeKinds;
use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
};

/// Bends of the profiles. At the fraction u of the time the trajectory with bend b is at the original's
/// position of the fraction `u + b u² (1 − u)`: it starts the same, is ahead by b/8 of the whole time in the
/// middle, and ends at `1 − b` of the original end speed. The first bend, 0, is the trajectory itself.
const BENDS: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];

/// The speed profiles for a network. Networks that see road boundaries alone are those of the paper's
/// protocol, whose candidates have the first three.
pub(crate) fn speed_profiles(edges: EdgeKinds) -> Vec<SpeedProfile> {
    let count = match edges {
        EdgeKinds::Boundaries => 3,
        EdgeKinds::All => BENDS.len(),
    };
    BENDS[..count].iter().map(|bend| SpeedProfile::new(*bend)).collect()
}

/// A speed profile: for every step the original step that it maps to, and the fraction towards the next
/// one.
pub(crate) struct SpeedProfile {
    bend: f64,
    original_steps: Vec<(usize, f64)>,
}

/// A trajectory with its start point, extended straight by one point at either end.
pub(crate) struct Extended(Vec<Point>);

impl Extended {
    /// Extends a trajectory that starts at `start`.
    pub(crate) fn new(trajectory: &Trajectory, start: Point) -> Self {
        let points = trajectory.points();
        let beyond = |end: Point, other: Point| [2.0 * end[0] - other[0], 2.0 * end[1] - other[1]];
        let mut all = Vec::with_capacity(HORIZON + 3);
        all.push(beyond(start, points[0]));
        all.push(start);
        all.extend_from_slice(points);
        all.push(beyond(points[HORIZON - 1], points[HORIZON - 2]));
        Self(all)
    }
}

impl SpeedProfile {
    /// The profile with bend `bend`.
    pub(crate) fn new(bend: f64) -> Self {
        let original_step = |step: usize| {
            let u = step as f64 / HORIZON as f64;
            let along = HORIZON as f64 * (u + bend * u * u * (1.0 - u));
            let k = (along.max(0.0) as usize).min(HORIZON - 1);
            (k, along - k as f64)
        };
        Self { bend, original_steps: (1..=HORIZON).map(original_step).collect() }
    }

    /// Whether it leaves the trajectory unchanged.
    pub(crate) fn is_plain(&self) -> bool {
        self.bend == 0.0
    }

    /// Position at a step, 1 to 80, under this profile.
    pub(crate) fn at(&self, trajectory: &Extended, step: usize) -> Point {
        if self.is_plain() {
            return trajectory.0[step + 1];
        }
        let (k, t) = self.original_steps[step - 1];
        let [a, b, c, d] = [trajectory.0[k], trajectory.0[k + 1], trajectory.0[k + 2], trajectory.0[k + 3]];
        [catmull_rom([a[0], b[0], c[0], d[0]], t), catmull_rom([a[1], b[1], c[1], d[1]], t)]
    }

    /// The trajectory under this profile.
    ///
    /// *Errors*: a trajectory so close to the limit of coordinates that its cubic exceeds it.
    pub(crate) fn whole(&self, trajectory: &Extended) -> Result<Trajectory, sage_core::Error> {
        Trajectory::new("retimed trajectory", (1..=HORIZON).map(|step| self.at(trajectory, step)).collect())
    }
}

/// The Catmull-Rom cubic between the middle two of four evenly spaced values. Linear interpolation would
/// make the acceleration jump at every point.
fn catmull_rom([a, b, c, d]: [f64; 4], t: f64) -> f64 {
    b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn braking() -> Trajectory {
        let at = |k: usize| {
            let t = k as f64 / 10.0;
            [12.0 * t - 0.5 * t * t, 0.3 * t * t]
        };
        Trajectory::new("test", (1..=HORIZON).map(at).collect()).unwrap()
    }

    fn at_profile(trajectory: &Trajectory, start: Point, bend: f64) -> Result<Trajectory, sage_core::Error> {
        SpeedProfile::new(bend).whole(&Extended::new(trajectory, start))
    }

    #[test]
    fn the_plain_profile_changes_nothing_and_every_profile_preserves_the_end() {
        let trajectory = braking();
        assert_eq!(at_profile(&trajectory, [0.0, 0.0], 0.0).unwrap(), trajectory);
        for bend in [0.5, -0.5, 1.0] {
            let other = at_profile(&trajectory, [0.0, 0.0], bend).unwrap();
            let [x, y] = other.points()[HORIZON - 1];
            let [a, b] = trajectory.points()[HORIZON - 1];
            assert!((x - a).abs() < 1e-9 && (y - b).abs() < 1e-9);
        }
    }

    #[test]
    fn a_profile_gives_the_positions_at_the_mapped_times() {
        // In the middle it is half a second ahead; the trajectory is a polynomial, so its positions are
        // known.
        let other = at_profile(&braking(), [0.0, 0.0], 0.5).unwrap();
        let [x, y] = other.points()[HORIZON / 2 - 1];
        let t = 4.5;
        assert!((x - (12.0 * t - 0.5 * t * t)).abs() < 1e-9 && (y - 0.3 * t * t).abs() < 1e-9);
        // Smooth: the second differences of neighbouring steps are close.
        let points = other.points();
        let second = |k: usize| (points[k + 1][0] - 2.0 * points[k][0] + points[k - 1][0]) * 100.0;
        for k in 2..HORIZON - 2 {
            assert!((second(k + 1) - second(k)).abs() < 0.3, "step {k}: {} to {}", second(k), second(k + 1));
        }
    }
}
