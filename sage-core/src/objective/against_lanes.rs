//! Driving that no lane offers: across the lanes for long, turns from the wrong lane, and U-turns.
//!
//! A step is *across the lanes* if the car moves, is more than 60° off the nearest motor lane, and has no lane within 45° of its
//! heading within 2 m. A turn at a junction mostly has one; an overtaking car passes in 1 to 2 s. A *U-turn* is a turn by more
//! than 135° since *now*; the map offers it if a lane is along the heading, as above, at half of the steps at which it is 45°
//! to 135° off that of *now*.
//!
//! A car *turns from the wrong lane* where it crosses the centre line of a lane that leads its way, within 30° of its heading at
//! *now*, more than 30° off that lane, and no lane is within 30° of its heading within 2 m: a left turn from the right of two
//! lanes. A turn from the lane that leads there crosses none.

use std::ops::RangeInclusive;

use super::{Candidate, Context};
use crate::{
    geometry::{Aabb, Point, Segment, dot, norm},
    motion::DT,
};

/// Speed below which a heading says nothing, m/s.
const MOVING: f64 = 0.5;
/// Distance of a lane that a car follows, metres.
const BESIDE: f64 = 2.0;
/// Distance of a lane that it crosses, metres.
const NEAR: f64 = 20.0;
/// Cosines of 60°, of 45° and of 30°.
const OFF: f64 = 0.5;
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;
const CLOSELY: f64 = 0.866_025_403_784_438_6;

/// Time across the lanes in some steps of a candidate, seconds.
pub fn across_lanes(candidate: &Candidate, ctx: &Context, steps: RangeInclusive<usize>) -> f64 {
    let lanes = ctx.index().motor_lanes();
    let is_across = |step: &usize| {
        let (point, axis) = at(candidate, *step);
        is_moving(candidate, *step)
            && lanes
                .nearest(point, NEAR, |_| true)
                .is_some_and(|near| cosine(&lanes.segments()[near.segment], axis) < OFF)
            && !has_lane(ctx, point, axis, ALONG)
    };
    steps.filter(is_across).count() as f64 * DT
}

/// First of some steps of a candidate at which it has made a U-turn that no lane offers.
pub fn u_turn(candidate: &Candidate, ctx: &Context, steps: RangeInclusive<usize>) -> Option<usize> {
    let now = candidate.box_now().axis;
    let turned = steps
        .clone()
        .find(|step| is_moving(candidate, *step) && dot(candidate.profile().axis[step - 1], now) < -ALONG)?;
    let (mut on_lane, mut all) = (0, 0);
    for step in *steps.start()..=turned {
        let (point, axis) = at(candidate, step);
        if is_moving(candidate, step) && dot(axis, now).abs() < ALONG {
            all += 1;
            on_lane += usize::from(has_lane(ctx, point, axis, ALONG));
        }
    }
    (2 * on_lane < all || all == 0).then_some(turned)
}

/// First step of a candidate at which it turns from the wrong lane.
pub fn turn_from_wrong_lane(candidate: &Candidate, ctx: &Context) -> Option<usize> {
    let lanes = ctx.index().motor_lanes();
    let now = candidate.box_now().axis;
    let crosses_lane = |step: usize, axis: Point| {
        let from = if step == 1 { candidate.start().position } else { candidate.points()[step - 2] };
        let to = candidate.points()[step - 1];
        let bounds = Aabb::of([from, to]);
        lanes.near(&bounds).flatten().any(|k| {
            let lane = &lanes.segments()[k];
            cosine(lane, now) > CLOSELY && cosine(lane, axis) < CLOSELY && lane.meets([from, to])
        })
    };
    candidate.steps().find(|step| {
        let (point, axis) = at(candidate, *step);
        is_moving(candidate, *step) && crosses_lane(*step, axis) && !has_lane(ctx, point, axis, CLOSELY)
    })
}

fn at(candidate: &Candidate, step: usize) -> (Point, Point) {
    (candidate.points()[step - 1], candidate.profile().axis[step - 1])
}

fn is_moving(candidate: &Candidate, step: usize) -> bool {
    candidate.profile().speed[step - 1] > MOVING
}

/// Whether a lane leads along an axis, by the least cosine of their angle.
fn has_lane(ctx: &Context, point: Point, axis: Point, least: f64) -> bool {
    let is_along = |segment: &Segment| cosine(segment, axis) >= least;
    ctx.index().motor_lanes().nearest(point, BESIDE, is_along).is_some()
}

/// Cosine of the angle between a segment's direction and an axis; −1 for a segment without length.
fn cosine(segment: &Segment, axis: Point) -> f64 {
    let way = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
    let length = norm(way);
    if length > 0.0 { dot(way, axis) / length } else { -1.0 }
}
