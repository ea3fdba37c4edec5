//! What the realism penalties do not see: whether a path keeps to the lanes.
//!
//! `P_kin` and `P_beh` prefer a smooth cut across a junction to following the lane. These measures ask
//! where the lanes are: the nearest one *along* the driving (its heading within 90°), and the nearest of all.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::{Candidate, Context, Reward, Situation};
use crate::{
    geometry::{Nearest, Point, Segment, wrap_angle},
    registry::{Entry, NoOptions},
};

/// Lanes farther away than this are not looked for, metres; distances are capped at it.
const FARTHEST: f64 = 20.0;
/// Slower than this a heading means nothing, m/s.
const MOVING: f64 = 0.5;
/// A frame is against the lane if the headings differ by more than this, radians …
const AGAINST: f64 = 120.0 / 180.0 * PI;
/// … and no lane along the driving is within this distance, metres.
const BESIDE: f64 = 2.0;
/// Faster than this times the limit is speeding.
const TOLERANCE: f64 = 1.2;

/// How a path lies to the lanes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Naturalness {
    /// Mean distance to the nearest motor lane along the driving, metres, at most 20.
    pub lane_distance: f64,
    /// Mean difference from that lane's heading while moving, degrees; none if it never moves near one.
    pub heading_error: Option<f64>,
    /// Share of frames against the direction of the lane.
    pub against_lane: f64,
    /// Share of frames faster than 1.2 times the limit of the lane.
    pub speeding: f64,
}

impl Naturalness {
    /// Measures every step of a candidate.
    pub fn of(candidate: &Candidate, ctx: &Context) -> Self {
        let lanes = ctx.index().motor_lanes();
        let points = candidate.trajectory().points();
        let (mut distance, mut error, mut moving, mut against, mut speeding) = (0.0, 0.0, 0, 0, 0);
        for (step, &place) in points.iter().enumerate() {
            let axis = candidate.profile().axis[step];
            let speed = candidate.profile().speed[step];
            let along = nearest_along(ctx, place, axis);
            distance += along.map_or(FARTHEST, |n| n.distance);
            if let Some(nearest) = along {
                let segment = &lanes.segments()[nearest.segment];
                if speed > MOVING {
                    error += turn(segment, axis).abs();
                    moving += 1;
                }
                let lane = ctx.index().map().features[segment.feature as usize].lane.as_ref();
                let limit = lane.and_then(|lane| lane.speed_limit).filter(|limit| *limit > 0.0);
                speeding += usize::from(limit.is_some_and(|limit| speed > TOLERANCE * limit));
            }
            if along.is_none_or(|n| n.distance > BESIDE) && speed > MOVING {
                let any = lanes.nearest(place, FARTHEST, |_| true);
                let opposed = any.is_some_and(|n| turn(&lanes.segments()[n.segment], axis).abs() > AGAINST);
                against += usize::from(opposed);
            }
        }
        let steps = points.len() as f64;
        Self {
            lane_distance: distance / steps,
            heading_error: (moving > 0).then(|| (error / f64::from(moving)).to_degrees()),
            against_lane: against as f64 / steps,
            speeding: speeding as f64 / steps,
        }
    }
}

/// Mean distance to the nearest lane along the driving at every fourth step, metres: what a choice
/// among many candidates can afford.
pub fn coarse_lane_distance(candidate: &Candidate, ctx: &Context) -> f64 {
    let points = candidate.trajectory().points();
    let distance = |step: usize| {
        nearest_along(ctx, points[step], candidate.profile().axis[step]).map_or(FARTHEST, |n| n.distance)
    };
    let steps = (3..points.len()).step_by(4);
    let count = steps.clone().count();
    steps.map(distance).sum::<f64>() / count as f64
}

/// Lane distance as a reward.
pub struct LaneDistance;

impl Entry<dyn Reward> for LaneDistance {
    const NAME: &'static str = "lane-distance";
    const SUMMARY: &'static str = "mean distance to the nearest lane along the driving, metres, at most 20";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for LaneDistance {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(coarse_lane_distance(situation.candidate, situation.ctx))
    }

    fn depends_on_ego(&self) -> bool {
        false
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([0.0, FARTHEST])
    }
}

fn nearest_along(ctx: &Context, place: Point, axis: Point) -> Option<Nearest> {
    // Within a quarter turn, without the cost of an angle for every segment looked at.
    let along = |segment: &Segment| {
        let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
        (dx != 0.0 || dy != 0.0) && dx * axis[0] + dy * axis[1] >= 0.0
    };
    ctx.index().motor_lanes().nearest(place, FARTHEST, along)
}

/// Angle from a segment's direction to an axis, radians. A segment without length has none: it counts
/// as opposed.
fn turn(segment: &Segment, axis: Point) -> f64 {
    let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
    if dx == 0.0 && dy == 0.0 { PI } else { wrap_angle(axis[1].atan2(axis[0]) - dy.atan2(dx)) }
}
