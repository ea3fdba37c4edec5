//! People who cross ahead, for car-following models, which see only what is on their path already.

use sage_core::geometry::dot;

use super::View;
use crate::{
    body::BodyKind,
    following::{Follower, MARGIN},
    route::Localization,
};

/// People whose centre is farther are not looked at, metres.
const REACH: f64 = 60.0;
/// Slowest walk towards the path, m/s, and longest time until it is reached, seconds.
const WALKS: f64 = 0.3;
const SOON: f64 = 4.0;
/// Time to spare before and after a person on the path, seconds.
const SPARE: f64 = 1.0;

/// Free distance to the nearest person, on foot or on a bicycle, who keeps its velocity and is on the path of the car's width when
/// the car gets there, or up to a second earlier or later, metres.
pub(super) fn crossing(view: &View, own: Follower) -> Option<f64> {
    let route = view.route();
    let speed = view.motion().body_velocity()[0].max(0.1);
    let people = view.others().filter(|body| matches!(body.kind, BodyKind::Pedestrian | BodyKind::Cyclist));
    let gaps = people.filter_map(|body| {
        let at = route.locate(body.area.center, Localization::Nearest);
        let gap = at.along - own.along - own.half[0] - body.area.radius();
        if at.along <= own.along || gap > REACH {
            return None;
        }
        let heading = route.heading(at.along);
        // Offsets are positive to the right.
        let right = dot(body.velocity, [heading.sin(), -heading.cos()]);
        let across = at.across - own.across;
        let half = own.half[1] + MARGIN + body.area.radius();
        let towards = -right * across.signum();
        if towards < WALKS || across.abs() <= half {
            return None;
        }
        let [enters, leaves] = [across.abs() - half, across.abs() + half].map(|way| way / towards);
        let arrives = gap.max(0.0) / speed;
        (enters < SOON && enters < arrives + SPARE && leaves > arrives - SPARE).then_some(gap)
    });
    gaps.reduce(f64::min)
}
