//! Vehicles that follow their logged path and keep their distance by the Intelligent Driver Model.

use std::sync::Arc;

use sage_core::{
    geometry::{OrientedBox, distance, dot},
    motion::{DT, idm::Idm},
    scene::Track,
};

use super::{DESIRED_SPEED, EgoBody, speed_limit};
use crate::{
    body::{Body, BodyKind, BodyShape},
    following::{Follower, areas, leader},
    route::{Coordinates, Localization, Route},
    scene::SimScene,
};

/// A reactive vehicle starts at least this far behind the ego …
const BEHIND: f64 = 1.0;
/// … at most this far beside it, and has at least [`LEAST_ROUTE`] to go, metres.
const BESIDE: f64 = 15.0;
const LEAST_ROUTE: f64 = 5.0;
/// Distance to the end of its route at which a reactive vehicle is removed, metres.
const ROUTE_END: f64 = 2.0;
/// Limits of a reactive vehicle's acceleration, m/s².
const ACCELERATION: [f64; 2] = [-6.0, 1.0];

/// A vehicle that follows its route.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reactive {
    route: Arc<Route>,
    shape: BodyShape,
    size: [f64; 2],
    at: Coordinates,
    speed: f64,
    ground: f64,
    idm: Idm,
}

/// MetaDrive's choice of the vehicles that react.
pub(super) fn reacts_to(track: &Track, frame: usize, ego: &OrientedBox) -> bool {
    let [ahead, aside] = ego.box_from_world(track.point(frame));
    let heading = track.heading[frame];
    let last = (frame..track.valid.len()).take_while(|&f| track.valid[f]).last().unwrap_or(frame);
    BodyKind::of(track) == BodyKind::Vehicle
        && ahead < -BEHIND
        && aside.abs() <= BESIDE
        && dot([heading.cos(), heading.sin()], ego.axis) > 0.0
        && distance(track.point(frame), track.point(last)) > LEAST_ROUTE
}

impl Reactive {
    pub(super) fn new(scene: &SimScene, track: &Track, frame: usize, body: &Body, shape: BodyShape) -> Self {
        let route = Arc::new(Route::of_track(track, frame, true));
        Self {
            at: route.locate(body.area.center, Localization::Nearest),
            speed: body.speed(),
            size: [2.0 * body.area.half_length, 2.0 * body.area.half_width],
            ground: body.ground,
            idm: Idm {
                desired_speed: speed_limit(scene, body.area.center).unwrap_or(DESIRED_SPEED),
                ..Idm::default()
            },
            route,
            shape,
        }
    }

    /// Moves by one step; `false` at the end of the route.
    pub(super) fn advance(&mut self, scene: &SimScene, others: &[Body], own: usize, ego: &EgoBody) -> bool {
        let follower =
            Follower { along: self.at.along, across: self.at.across, half: self.size.map(|size| 0.5 * size) };
        let ego_last = others.len();
        let others = areas(others).filter(|(k, ..)| others[*k].track != own);
        let all = others.chain(std::iter::once((ego_last, &ego.area, ego.velocity)));
        let leader = leader(&self.route, follower, all).map(|(_, leader)| leader);
        let acceleration = self.idm.acceleration(self.speed, leader).clamp(ACCELERATION[0], ACCELERATION[1]);
        let speed = (self.speed + acceleration * DT).max(0.0);
        self.at.along += 0.5 * (self.speed + speed) * DT;
        self.speed = speed;
        self.ground = scene.follow_level(self.route.point(self.at), self.ground);
        self.at.along < self.route.length() - ROUTE_END
    }

    pub(super) fn body(&self, track: usize) -> Body {
        let heading = self.route.heading(self.at.along);
        Body {
            track,
            kind: BodyKind::Vehicle,
            class: self.shape.class,
            area: OrientedBox::new(self.route.point(self.at), heading, self.size[0], self.size[1]),
            heading,
            velocity: [self.speed * heading.cos(), self.speed * heading.sin()],
            yaw_rate: 0.0,
            ground: self.ground,
            is_falling: false,
        }
    }
}
