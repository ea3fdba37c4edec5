//! Naturalness: how well a trajectory follows the lanes, which the realism penalties do not measure.
//!
//! `P_kin` and `P_beh` prefer a smooth shortcut across a junction to following the lane. These measures use
//! two lanes: the nearest one in the direction of motion (heading within 90°), and the nearest of all.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::{Candidate, Context};
use crate::geometry::{Nearest, Point, Segment, distance, wrap_angle};

/// Search radius for lanes, metres; distances are capped at it.
pub(super) const FARTHEST: f64 = 20.0;
/// Speed below which a heading is undefined, m/s.
const MOVING: f64 = 0.5;
/// A frame is against the lane if the headings differ by more than this, radians …
const AGAINST: f64 = 120.0 / 180.0 * PI;
/// … and no lane in the direction of motion is within this distance, metres.
const BESIDE: f64 = 2.0;
/// Segments of a lane that are tested before a search.
const AHEAD: usize = 8;
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
        let points = candidate.points();
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
                let limit = limit_of(ctx, segment);
                speeding += usize::from(limit.is_some_and(|limit| speed > TOLERANCE * limit));
            }
            if along.is_none_or(|n| n.distance > BESIDE) {
                against += usize::from(is_against_nearest(ctx, point, axis, speed));
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

/// Finds steps against the traffic: more than 120° off the nearest motor lane, without a lane in the direction of
/// motion within 2 m.
pub(super) struct AgainstTrafficTest<'a> {
    ctx: &'a Context,
    /// Segment of a lane along which the last step led.
    along: usize,
}

impl<'a> AgainstTrafficTest<'a> {
    pub(super) fn new(ctx: &'a Context) -> Self {
        Self { ctx, along: 0 }
    }

    /// Whether a car at `point` moves against the traffic along `axis` with a speed in m/s.
    pub(super) fn holds(&mut self, point: Point, axis: Point, speed: f64) -> bool {
        let lanes = self.ctx.index().motor_lanes();
        if speed <= MOVING {
            return false;
        }
        // A lane that led the way is likely to lead it on: the next few segments need no search.
        let is_along = is_along(axis);
        let mut next = self.along..(self.along + AHEAD).min(lanes.segments().len());
        let beside = |k: &usize| {
            let segment = &lanes.segments()[*k];
            distance(point, segment.at(segment.nearest_share(point))) <= BESIDE && is_along(segment)
        };
        let found = next.find(beside);
        let found = found.or_else(|| lanes.nearest(point, BESIDE, &is_along).map(|nearest| nearest.segment));
        self.along = found.unwrap_or(self.along);
        found.is_none() && is_against_nearest(self.ctx, point, axis, speed)
    }
}

fn is_against_nearest(ctx: &Context, point: Point, axis: Point, speed: f64) -> bool {
    let lanes = ctx.index().motor_lanes();
    let opposed = |nearest: Nearest| turn(&lanes.segments()[nearest.segment], axis).abs() > AGAINST;
    speed > MOVING && lanes.nearest(point, FARTHEST, |_| true).is_some_and(opposed)
}

/// Distance of a point to the nearest lane in the direction of motion, metres, at most [`FARTHEST`].
pub(super) fn lane_distance_at(ctx: &Context, point: Point, axis: Point) -> f64 {
    nearest_along(ctx, point, axis).map_or(FARTHEST, |nearest| nearest.distance)
}

/// Speed limit of the nearest lane in the direction of motion within [`FARTHEST`], m/s; `None` if it has none.
pub(super) fn speed_limit_at(ctx: &Context, point: Point, axis: Point) -> Option<f64> {
    let nearest = nearest_along(ctx, point, axis)?;
    limit_of(ctx, &ctx.index().motor_lanes().segments()[nearest.segment])
}

/// Speed limit of the lane that a car is on, within 2 m and along its axis, m/s; `None` if there is none or it has none.
pub(super) fn lane_limit_at(ctx: &Context, point: Point, axis: Point) -> Option<f64> {
    let lanes = ctx.index().motor_lanes();
    limit_of(ctx, &lanes.segments()[lanes.nearest(point, BESIDE, is_along(axis))?.segment])
}

/// Speed limit of a segment's lane, m/s.
fn limit_of(ctx: &Context, segment: &Segment) -> Option<f64> {
    let lane = ctx.index().map().features[segment.feature as usize].lane.as_ref();
    lane.and_then(|lane| lane.speed_limit).filter(|limit| *limit > 0.0)
}

fn nearest_along(ctx: &Context, point: Point, axis: Point) -> Option<Nearest> {
    ctx.index().motor_lanes().nearest(point, FARTHEST, is_along(axis))
}

/// Whether a segment's direction is within a quarter turn of an axis, without computing an angle.
fn is_along(axis: Point) -> impl Fn(&Segment) -> bool {
    move |segment| {
        let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
        (dx != 0.0 || dy != 0.0) && dx * axis[0] + dy * axis[1] >= 0.0
    }
}

/// Angle from a segment's direction to an axis, radians. A segment without length counts as opposed.
fn turn(segment: &Segment, axis: Point) -> f64 {
    let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
    if dx == 0.0 && dy == 0.0 { PI } else { wrap_angle(axis[1].atan2(axis[0]) - dy.atan2(dx)) }
}
