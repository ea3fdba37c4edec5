//! How a plan differs from what the adversary was recorded to do.

use sage_core::{
    geometry::{OrientedBox, Point, cross, distance, dot, norm, sub, wrap_angle},
    motion::{DT, NOW, Trajectory},
    objective::{Candidate, Context},
};
use serde::{Deserialize, Serialize};

/// Steps over which a difference of accelerations is averaged.
const AVERAGED: usize = 5;
/// Steps over which speeds are measured.
pub(super) const SPEED: usize = 3;

/// How a plan differs from the recording of the adversary, up to the contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Largest difference of the accelerations, mean over 0.5 s, m/s²: how differently the car is driven.
    pub acceleration: f64,
    /// How much further along the recorded direction it is at the contact, metres.
    pub along: f64,
    /// How much further to the left of it, metres.
    pub left: f64,
    /// Speed in the first 0.3 s, m/s.
    pub speed_now: f64,
    /// Speed in the last 0.3 s before the contact, m/s.
    pub speed: f64,
    /// The lowest and the highest speed up to there, m/s.
    pub speeds: [f64; 2],
    /// The same of the recording.
    pub recorded_speed: f64,
    /// Its lowest and highest speed up to there, m/s.
    pub recorded_speeds: [f64; 2],
    /// Change of its heading up to the contact, rad, positive to the left.
    pub turned: f64,
    /// The same of the recording.
    pub recorded_turned: f64,
    /// The same of all that is recorded.
    pub turned_later: f64,
}

impl Deviation {
    /// The difference of a plan up to a contact at a step, 1 or later; `None` if the adversary is not recorded up to there.
    pub fn of(ctx: &Context, plan: &Candidate, contact: usize) -> Option<Self> {
        let recorded = recorded(ctx);
        let end = *recorded.get(contact.checked_sub(1)?)?;
        let track = ctx.adversary();
        let (axis, points) = (track.oriented_box(NOW + contact).axis, plan.points().get(..contact)?);
        let apart = sub(points[contact - 1], end);
        let start = track.point(NOW);
        let recorded_turn = |until: usize| {
            let headings = track.heading[NOW..=NOW + until].windows(2);
            headings.map(|w| wrap_angle(w[1] - w[0])).sum::<f64>()
        };
        let heading = |area: &OrientedBox| area.axis[1].atan2(area.axis[0]);
        let boxes: Vec<OrientedBox> =
            std::iter::once(plan.box_now()).chain(plan.boxes()[..contact].iter().copied()).collect();
        let turned = boxes.windows(2).map(|w| wrap_angle(heading(&w[1]) - heading(&w[0]))).sum();
        Some(Self {
            acceleration: difference_of_accelerations(plan.trajectory(), &recorded[..contact]),
            along: dot(axis, apart),
            left: cross(axis, apart),
            speed_now: last_speed(start, &points[..SPEED.min(contact)]),
            speed: last_speed(start, points),
            speeds: range_of_speeds(start, points),
            recorded_speed: last_speed(start, &recorded[..contact]),
            recorded_speeds: range_of_speeds(start, &recorded[..contact]),
            turned,
            recorded_turned: recorded_turn(contact),
            turned_later: recorded_turn(recorded.len()),
        })
    }
}

/// Lowest and highest speed of a path over some steps, m/s.
pub(super) fn range_of_speeds(start: Point, points: &[Point]) -> [f64; 2] {
    let speeds = (SPEED.min(points.len())..=points.len()).map(|until| last_speed(start, &points[..until]));
    speeds.fold([f64::INFINITY, 0.0], |[low, high], speed| [low.min(speed), high.max(speed)])
}

/// Speed of a path in its last steps, m/s.
pub(super) fn last_speed(start: Point, points: &[Point]) -> f64 {
    let steps = SPEED.min(points.len()).max(1);
    let from = points.len().checked_sub(steps + 1).map_or(start, |k| points[k]);
    points.last().map_or(0.0, |end| distance(from, *end) / (steps as f64 * DT))
}

/// Recorded positions of the adversary from step 1 on, up to the first gap; none if it is not valid *now*.
pub(super) fn recorded(ctx: &Context) -> Vec<Point> {
    let track = ctx.adversary();
    let frames = (NOW..track.valid.len()).take_while(|frame| track.valid[*frame]);
    frames.skip(1).map(|frame| track.point(frame)).collect()
}

/// Largest length of the second differences of two paths that part *now*, as accelerations, mean over [`AVERAGED`] steps.
pub(super) fn difference_of_accelerations(plan: &Trajectory, recorded: &[Point]) -> f64 {
    // Up to *now* both are the same.
    let apart = plan.points().iter().zip(recorded).map(|(a, b)| sub(*a, *b));
    let apart: Vec<Point> = [[0.0; 2]; 2].into_iter().chain(apart).collect();
    let second = |w: &[Point]| [0, 1].map(|k| (w[2][k] - 2.0 * w[1][k] + w[0][k]) / (DT * DT));
    let accelerations: Vec<Point> = apart.windows(3).map(second).collect();
    let mean = |w: &[Point]| norm([0, 1].map(|k| w.iter().map(|a| a[k]).sum::<f64>() / w.len() as f64));
    accelerations.windows(AVERAGED.min(accelerations.len()).max(1)).map(mean).fold(0.0, f64::max)
}

/// The plan with a share of its difference from the recording. Beyond the recording its difference stays what it is there; `None`
/// if it does not reach the contact.
pub(super) fn blended(
    plan: &Trajectory,
    recorded: &[Point],
    share: f64,
    contact: usize,
) -> Option<Trajectory> {
    if recorded.len() < contact {
        return None;
    }
    let mut moved = [0.0; 2];
    let point = |(k, planned): (usize, &Point)| {
        if let Some(recorded) = recorded.get(k) {
            moved = [0, 1].map(|axis| (1.0 - share) * (recorded[axis] - planned[axis]));
        }
        [planned[0] + moved[0], planned[1] + moved[1]]
    };
    Trajectory::new("shrunk", plan.points().iter().enumerate().map(point).collect()).ok()
}

#[cfg(test)]
mod tests {
    use sage_core::motion::HORIZON;

    use super::*;

    fn path(x: impl Fn(f64) -> f64) -> Vec<Point> {
        (1..=HORIZON).map(|k| [x(k as f64 * DT), 0.0]).collect()
    }

    #[test]
    fn the_difference_of_accelerations_is_that_of_the_driving_and_not_of_the_distance() {
        let recorded = path(|t| 8.0 * t);
        let plan = |x: &dyn Fn(f64) -> f64| Trajectory::new("plan", path(x)).unwrap();
        assert_eq!(difference_of_accelerations(&plan(&|t| 8.0 * t), &recorded), 0.0);
        // 2 m/s² less, all the time: 64 m apart in the end.
        let brakes = plan(&|t| 8.0 * t - t * t);
        assert!((difference_of_accelerations(&brakes, &recorded) - 2.0).abs() < 1e-9);
        assert!((difference_of_accelerations(&brakes, &recorded[..3]) - 2.0).abs() < 0.7, "a short one");
        assert_eq!(difference_of_accelerations(&brakes, &[]), 0.0);
    }

    #[test]
    fn a_blend_leads_from_the_recording_to_the_plan_and_goes_on_where_the_recording_ends() {
        let recorded = &path(|t| 8.0 * t)[..40];
        let plan = Trajectory::new("plan", path(|t| 6.0 * t)).unwrap();
        let at = |share| blended(&plan, recorded, share, 30).unwrap();
        assert_eq!(&at(0.0).points()[..40], recorded);
        assert_eq!(at(1.0).points(), plan.points());
        let half = at(0.5);
        assert!((half.points()[39][0] - 7.0 * 4.0).abs() < 1e-9);
        assert!((half.points()[59][0] - (6.0 * 6.0 + 4.0)).abs() < 1e-9, "beside the plan by what it was");
        assert_eq!(blended(&plan, recorded, 0.5, 41), None);
    }
}
