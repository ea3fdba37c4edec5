//! When a plan begins to be seen: its *onset*.
//!
//! The plan is compared with two predictions from *now*: that the adversary keeps its velocity, and that it follows the lane that
//! it is on at its speed. The onset is the first step at which it departs from both by more than recorded driving mostly does;
//! *now* if it never does. *Human time* goes from there to the latest start of an evasive manoeuvre: what a person who only
//! sees the plan happen has for a reaction. UN R157's careful and competent driver needs [`REACTION`].

use sage_core::{
    geometry::{Point, Segment, cross, dot, norm, sub},
    motion::DT,
    objective::{Candidate, Context},
};

/// Time of a reaction, seconds.
pub const REACTION: f64 = 0.75;
/// Departure that 95 % of recorded moving vehicles stay below after a time `t`: `AFTER_A_SECOND · t^GROWTH` metres (888
/// vehicles of the scenes of the choice; within 0.2 m of the measured quantiles from 0.3 to 5 s).
const AFTER_A_SECOND: f64 = 1.63;
const GROWTH: f64 = 1.75;
/// Distance of a lane that the adversary is on, metres, and least cosine of their angle.
const BESIDE: f64 = 2.0;
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Onset of a plan up to a step, seconds after *now*.
pub fn onset(plan: &Candidate, ctx: &Context, contact: usize) -> f64 {
    let (start, axis) = (plan.start().position, plan.box_now().axis);
    let velocity = ctx.adversary().velocity[sage_core::motion::NOW];
    let speed = norm(velocity);
    let mut lane = Follower::new(ctx, start, axis);
    let points = plan.points().iter().take(contact);
    let departs = points.enumerate().find(|(k, point)| {
        let time = (k + 1) as f64 * DT;
        let straight = [start[0] + time * velocity[0], start[1] + time * velocity[1]];
        let followed = lane.as_mut().map(|lane| lane.advance(speed * DT));
        let predicted = [Some(straight), followed];
        let departure =
            predicted.into_iter().flatten().map(|p| norm(sub(**point, p))).fold(f64::INFINITY, f64::min);
        departure > AFTER_A_SECOND * time.powf(GROWTH)
    });
    departs.map_or(0.0, |(k, _)| (k + 1) as f64 * DT)
}

/// A car that keeps its distance from the centre line of a lane.
struct Follower<'c> {
    segments: &'c [Segment],
    segment: usize,
    /// Distance along the segment, and to its left, metres.
    along: f64,
    left: f64,
}

impl<'c> Follower<'c> {
    /// `None` if no lane leads its way.
    fn new(ctx: &'c Context, start: Point, axis: Point) -> Option<Self> {
        let lanes = ctx.index().motor_lanes();
        let leads = |segment: &Segment| direction(segment).is_some_and(|way| dot(way, axis) >= ALONG);
        let nearest = lanes.nearest(start, BESIDE, leads)?;
        let segment = &lanes.segments()[nearest.segment];
        let (way, to) = (direction(segment)?, sub(start, segment.a));
        Some(Self {
            segments: lanes.segments(),
            segment: nearest.segment,
            along: dot(way, to),
            left: cross(way, to),
        })
    }

    /// Drives on, and where the lane ends straight on.
    fn advance(&mut self, metres: f64) -> Point {
        self.along += metres;
        loop {
            let segment = &self.segments[self.segment];
            let length = norm(sub(segment.b, segment.a));
            if self.along <= length || !segment.joined[1] || self.segment + 1 >= self.segments.len() {
                break;
            }
            self.along -= length;
            self.segment += 1;
        }
        let segment = &self.segments[self.segment];
        let way = direction(segment).unwrap_or([1.0, 0.0]);
        [
            segment.a[0] + self.along * way[0] - self.left * way[1],
            segment.a[1] + self.along * way[1] + self.left * way[0],
        ]
    }
}

/// Direction of a segment; `None` for one without length.
fn direction(segment: &Segment) -> Option<Point> {
    let way = sub(segment.b, segment.a);
    let length = norm(way);
    (length > 0.0).then(|| way.map(|x| x / length))
}
