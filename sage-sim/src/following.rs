//! The road user ahead on a route, for car-following models.

use sage_core::{
    geometry::{OrientedBox, dot},
    motion::idm::Leader,
};

use crate::{
    body::Body,
    route::{Localization, Route},
};

/// Road users whose centre is farther than this are not looked at, metres.
const REACH: f64 = 80.0;
/// Space to each side of the follower's box that belongs to its path, metres.
pub(crate) const MARGIN: f64 = 0.3;

/// A follower on a route.
#[derive(Clone, Copy, Debug)]
pub struct Follower {
    /// Distance of its centre along the route, metres.
    pub along: f64,
    /// Offset of its path from the route, positive to the right, metres.
    pub across: f64,
    /// Half its length and half its width, metres.
    pub half: [f64; 2],
}

/// The nearest road user ahead on the path of a follower, with its index in `others`.
///
/// A road user is on the path if its box overlaps the strip of the follower's width around the route. Its
/// speed is the part along the route.
pub fn leader<'a>(
    route: &Route,
    follower: Follower,
    others: impl Iterator<Item = (usize, &'a OrientedBox, [f64; 2])>,
) -> Option<(usize, Leader)> {
    let own = route.point(crate::route::Coordinates { along: follower.along, across: follower.across });
    let mut first: Option<(usize, Leader)> = None;
    for (k, area, velocity) in others {
        let [dx, dy] = [area.center[0] - own[0], area.center[1] - own[1]];
        if dx * dx + dy * dy > REACH * REACH {
            continue;
        }
        let center = route.locate(area.center, Localization::Nearest);
        let half = follower.half[1] + MARGIN;
        if center.along <= follower.along || (center.across - follower.across).abs() > half + area.radius() {
            continue;
        }
        let corners = area.corners().map(|corner| route.locate(corner, Localization::Nearest));
        let across = corners.map(|c| c.across - follower.across);
        if across.iter().all(|a| *a < -half) || across.iter().all(|a| *a > half) {
            continue;
        }
        let rear = corners.iter().map(|c| c.along).fold(f64::INFINITY, f64::min);
        let gap = rear - (follower.along + follower.half[0]);
        let heading = route.heading(center.along);
        let speed = dot(velocity, [heading.cos(), heading.sin()]);
        if first.is_none_or(|(_, leader)| gap < leader.gap) {
            first = Some((k, Leader { gap, speed }));
        }
    }
    first
}

/// Bodies as [`leader`] takes them.
pub fn areas(bodies: &[Body]) -> impl Iterator<Item = (usize, &OrientedBox, [f64; 2])> {
    bodies.iter().enumerate().map(|(k, body)| (k, &body.area, body.velocity))
}
