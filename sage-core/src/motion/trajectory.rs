//! Planned positions of one car.

use super::{DT, HORIZON, MAX_COORDINATE, path_limits::check_path};
use crate::{Error, geometry::Point};

/// [`HORIZON`] planned positions, finite, world frame, 10 Hz: frames 11 to 90.
///
/// ```
/// use sage_core::motion::{HORIZON, Trajectory};
///
/// // 8 s at 10 m/s: step t is 0.1 t seconds after *now*.
/// let points: Vec<[f64; 2]> = (1..=HORIZON).map(|step| [step as f64, 0.0]).collect();
/// let trajectory = Trajectory::new("plan", points.clone())?;
/// assert_eq!(trajectory.points()[79], [80.0, 0.0]);
/// // Anything else than 80 finite positions is refused, with the name that you gave.
/// let error = Trajectory::new("plan", points[..79].to_vec()).err().map(|error| error.to_string());
/// assert_eq!(error.as_deref(), Some("plan: 79 points, expected 80"));
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Vec<Point>", into = "Vec<Point>")]
pub struct Trajectory(Vec<Point>);

impl Trajectory {
    /// Checks and takes the points; `what` names them in errors.
    ///
    /// *Errors*: [`Error::Length`] for another number than [`HORIZON`], [`Error::NotFinite`] for a
    /// coordinate that is NaN, infinite or beyond [`MAX_COORDINATE`], [`Error::TooLong`] for a step beyond
    /// [`super::MAX_STEP`].
    pub fn new(what: &str, points: Vec<Point>) -> Result<Self, Error> {
        if points.len() != HORIZON {
            return Err(Error::Length { what: what.to_owned(), found: points.len(), expected: HORIZON });
        }
        check_points(what, &points)?;
        Ok(Self(points))
    }

    /// The points, step 1 first.
    pub fn points(&self) -> &[Point] {
        &self.0
    }
}

impl TryFrom<Vec<Point>> for Trajectory {
    type Error = Error;

    fn try_from(points: Vec<Point>) -> Result<Self, Error> {
        Self::new("trajectory", points)
    }
}

impl From<Trajectory> for Vec<Point> {
    fn from(trajectory: Trajectory) -> Self {
        trajectory.0
    }
}

/// Checks that all coordinates are finite and within [`MAX_COORDINATE`], and the limits of a path.
///
/// *Errors*: [`Error::NotFinite`] or [`Error::TooLong`] for the first point that is not.
pub(crate) fn check_points(what: &str, points: &[Point]) -> Result<(), Error> {
    // NaN fails the comparison as well.
    let bad = |p: &Point| !(p[0].abs() <= MAX_COORDINATE && p[1].abs() <= MAX_COORDINATE);
    match points.iter().position(bad) {
        Some(index) => Err(Error::NotFinite { what: what.to_owned(), index, point: points[index] }),
        None => check_path(points.iter().copied().enumerate())
            .map_err(|problem| Error::TooLong { what: what.to_owned(), problem }),
    }
}

/// Velocity at a step, 1 to the trajectory's length, by backward difference, m/s.
pub fn backward_velocity(points: &[Point], start: Point, step: usize) -> Point {
    let before = if step == 1 { start } else { points[step - 2] };
    let now = points[step - 1];
    [(now[0] - before[0]) / DT, (now[1] - before[1]) / DT]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_and_non_finite_trajectories_are_refused_by_name() {
        let short = Trajectory::new("candidate `a`", vec![[0.0, 0.0]; 79]).unwrap_err();
        assert_eq!(short.to_string(), "candidate `a`: 79 points, expected 80");
        for bad in [f64::NAN, f64::INFINITY, 1e9] {
            let mut points = vec![[0.0, 0.0]; 80];
            points[3][1] = bad;
            let error = Trajectory::new("candidate `a`", points).unwrap_err().to_string();
            assert!(error.starts_with("candidate `a`: point 3 is [0.0, "), "{error}");
        }
        let mut points = vec![[9e7, 0.0]; 80];
        points[3][0] -= 101.0;
        let error = Trajectory::new("candidate `a`", points).unwrap_err().to_string();
        assert!(error.starts_with("candidate `a`: point 3 is 101 m from the position before"), "{error}");
    }
}
