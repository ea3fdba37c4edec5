//! Naturalness: how well a trajectory follows the lanes, which the realism penalties do not measure.
//!
//! `P_kin` and `P_beh` prefer a smooth shortcut across a junction to following the lane. These measures use
//! two lanes: the nearest one in the direction of motion (heading within 90°), and the nearest of all.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::{Candidate, Context, Reward, Situation};
use crate::{
    geometry::{Nearest, Point, Segment, wrap_angle},
    registry::{Entry, NoOptions},
};

/// Search radius for lanes, metres; distances are capped at it.
const FARTHEST: f64 = 20.0;
/// Speed below which a heading is undefined, m/s.
const MOVING: f64 = 0.5;
/// A frame is against the lane if the headings differ by more than this, radians …
const AGAINST: f64 = 120.0 / 180.0 * PI;
/// … and no lane in the direction of motion is within this distance, metres.
const BESIDE: f64 = 2.0;
/// Speeding starts at this multiple of the limit.
const TOLERANCE: f64 = 1.2;

/// Relation of a trajectory to the lanes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Naturalness {
    /// Mean distance to the nearest motor lane in the direction of motion, metres, at most 20.
    pub lane_distance: f64,
    /// Mean difference from that lane's heading while moving, degrees; `None` if it never moves near a
    /// lane.
    pub heading_error: Option<f64>,
    /// Fraction of frames against the direction of the lane.
    pub against_lane: f64,
    /// Fraction of frames above 1.2 times the lane's speed limit.
    pub speeding: f64,
}

impl Naturalness {
    /// Measures every step of a candidate.
    pub fn of(candidate: &Candidate, ctx: &Context) -> Self {
        let lanes = ctx.index().motor_lanes();
        let points = candidate.trajectory().points();
        let (mut distance, mut error, mut moving, mut against, mut speeding) = (0.0, 0.0, 0, 0, 0);
        for (step, &point) in points.iter().enumerate() {
            let axis = candidate.profile().axis[step];
            let speed = candidate.profile().speed[step];
            let along = nearest_along(ctx, point, axis);
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
                let any = lanes.nearest(point, FARTHEST, |_| true);
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

/// Mean distance to the nearest lane in the direction of motion at every fourth step, metres: cheap enough
/// for a selection among many candidates.
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
    const SUMMARY: &'static str =
        "mean distance to the nearest lane in the direction of motion, metres, at most 20";
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

fn nearest_along(ctx: &Context, point: Point, axis: Point) -> Option<Nearest> {
    // Within a quarter turn, without computing an angle for every tested segment.
    let along = |segment: &Segment| {
        let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
        (dx != 0.0 || dy != 0.0) && dx * axis[0] + dy * axis[1] >= 0.0
    };
    ctx.index().motor_lanes().nearest(point, FARTHEST, along)
}

/// Angle from a segment's direction to an axis, radians. A segment without length counts as opposed.
fn turn(segment: &Segment, axis: Point) -> f64 {
    let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
    if dx == 0.0 && dy == 0.0 { PI } else { wrap_angle(axis[1].atan2(axis[0]) - dy.atan2(dx)) }
}
