//! The other road users: replay of the log, a plan of the adversary, or reactive followers.
//!
//! A reactive vehicle follows its logged path and keeps its distance by the Intelligent Driver Model. Only
//! vehicles behind the ego react, chosen once as in MetaDrive; all others replay the log.

use std::{collections::BTreeMap, sync::Arc};

use sage_core::{
    geometry::{OrientedBox, dot},
    motion::idm::Idm,
    scene::Track,
};
use serde::{Deserialize, Serialize};

use crate::{
    body::{Body, BodyClass, BodyKind, BodyShape},
    following::{Follower, areas, leader},
    route::{Coordinates, Localization, Route},
    scene::SimScene,
};

/// Time between frames, s.
const DT: f64 = 0.1;
/// Desired speed of reactive vehicles without a speed limit, m/s.
pub(crate) const DESIRED_SPEED: f64 = 40.0 / 3.6;
/// Largest distance of the lane whose speed limit counts, metres.
const LIMIT_REACH: f64 = 3.0;
/// A reactive vehicle starts at least this far behind the ego …
const BEHIND: f64 = 1.0;
/// … at most this far beside it, and has at least [`LEAST_ROUTE`] to go, metres.
const BESIDE: f64 = 15.0;
const LEAST_ROUTE: f64 = 5.0;
/// Distance to the end of its route at which a reactive vehicle is removed, metres.
const ROUTE_END: f64 = 2.0;
/// Limits of a reactive vehicle's acceleration, m/s².
const ACCELERATION: [f64; 2] = [-6.0, 1.0];
/// A car is not created while it is within these distances of the ego, ahead and aside, metres.
const CLOSE: [f64; 2] = [8.0, 2.0];

/// MetaDrive creates a truck in the air; for this many frames its floor is above the plane of the lidar.
const FALLING: usize = 2;

/// What the other road users do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrafficMode {
    /// Replay of the log.
    #[default]
    Replay,
    /// Vehicles behind the ego follow their logged path and keep their distance.
    Reactive,
}

/// Options of the traffic.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrafficOptions {
    /// What the other road users do.
    pub mode: TrafficMode,
    /// Whether parked vehicles are there.
    pub parked: bool,
    /// MetaDrive: sizes and masses of vehicle classes instead of logged sizes.
    pub class_sizes: bool,
    /// Classes of tracks by id; other tracks get theirs by a seeded cycle.
    pub classes: BTreeMap<String, BodyClass>,
    /// MetaDrive: a car does not appear while it would be within 8 m ahead or behind and 2 m aside of the ego.
    pub skip_close: bool,
    /// MetaDrive: the adversary's plan runs 0.1 s late.
    pub late_plan: bool,
    /// MetaDrive: bodies move freely within a step, from the logged velocity, and contacts push them.
    pub dynamic: bool,
}

impl Default for TrafficOptions {
    fn default() -> Self {
        Self {
            mode: TrafficMode::Replay,
            parked: true,
            class_sizes: false,
            classes: BTreeMap::new(),
            skip_close: false,
            late_plan: false,
            dynamic: false,
        }
    }
}

/// A trajectory for one track in place of its log.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Index of the track.
    pub track: usize,
    /// The recording that it follows, as long as the scene.
    pub motion: Track,
}

/// What one track does.
#[derive(Clone, Debug, PartialEq)]
enum Role {
    Absent,
    /// With the frame at which it appeared.
    Replay(BodyShape, usize),
    Reactive(Box<Reactive>),
    /// Moved by a policy: its body is set from outside.
    Driven,
}

/// A vehicle that follows its route.
#[derive(Clone, Debug, PartialEq)]
struct Reactive {
    route: Arc<Route>,
    shape: BodyShape,
    size: [f64; 2],
    at: Coordinates,
    speed: f64,
    ground: f64,
    idm: Idm,
}

/// State of the traffic: what each track does, and the bodies of the current frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Traffic {
    roles: Vec<Role>,
    bodies: Vec<Body>,
    /// Bodies of the frame before, kept to reuse their memory.
    before: Vec<Body>,
    /// Counters of the class cycles.
    counters: [u64; 2],
}

impl Traffic {
    /// Traffic at frame 0. `cycle` starts the cycle of classes.
    pub fn start(
        scene: &SimScene,
        options: &TrafficOptions,
        plan: Option<&Plan>,
        ego: &OrientedBox,
        cycle: u64,
    ) -> Self {
        let roles = vec![Role::Absent; scene.scene().tracks.len()];
        let mut traffic = Self { roles, bodies: Vec::new(), before: Vec::new(), counters: [cycle; 2] };
        traffic.place(scene, options, plan, ego, 0);
        traffic
    }

    /// Number of tracks of the scene.
    pub(crate) fn track_count(&self) -> usize {
        self.roles.len()
    }

    /// Bodies of the current frame, in the order of their tracks.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    /// Bodies of the frame before.
    pub fn bodies_before(&self) -> &[Body] {
        &self.before
    }

    /// Hands a track over to a policy. Its body then comes from [`Traffic::set_body`]. `None` if it is
    /// absent.
    pub fn take_over(&mut self, track: usize) -> Option<Body> {
        let body = self.bodies.iter().find(|body| body.track == track)?;
        self.roles[track] = Role::Driven;
        Some(*body)
    }

    /// Sets the body of a track that was handed over.
    pub fn set_body(&mut self, body: Body) {
        if let Some(slot) = self.bodies.iter_mut().find(|slot| slot.track == body.track) {
            *slot = body;
        }
    }

    /// Moves everything to a frame. Reactive vehicles see the bodies of the frame before.
    pub fn advance(
        &mut self,
        scene: &SimScene,
        options: &TrafficOptions,
        plan: Option<&Plan>,
        ego: &EgoBody,
        frame: usize,
    ) {
        std::mem::swap(&mut self.bodies, &mut self.before);
        if options.mode == TrafficMode::Reactive {
            for k in 0..self.roles.len() {
                if let Role::Reactive(vehicle) = &mut self.roles[k]
                    && !vehicle.advance(&self.before, k, ego)
                {
                    self.roles[k] = Role::Absent;
                }
            }
        }
        self.place(scene, options, plan, &ego.area, frame);
    }

    fn place(
        &mut self,
        scene: &SimScene,
        options: &TrafficOptions,
        plan: Option<&Plan>,
        ego: &OrientedBox,
        frame: usize,
    ) {
        let recording = scene.scene();
        self.bodies.clear();
        for (k, track) in recording.tracks.iter().enumerate() {
            if k == recording.ego || (!options.parked && scene.is_parked(k)) {
                continue;
            }
            let planned = plan.filter(|plan| plan.track == k);
            let source = planned.map_or(track, |plan| &plan.motion);
            match &self.roles[k] {
                Role::Reactive(vehicle) => {
                    self.bodies.push(vehicle.body(k));
                    continue;
                }
                Role::Driven => {
                    self.bodies.extend(self.before.iter().find(|body| body.track == k));
                    continue;
                }
                Role::Absent | Role::Replay(..) => {}
            }
            // The first row of a late plan is consumed at frame 1.
            let row = if planned.is_some() && options.late_plan { frame.saturating_sub(1) } else { frame };
            if !source.is_valid(row) {
                self.roles[k] = Role::Absent;
                continue;
            }
            if self.roles[k] == Role::Absent {
                if options.skip_close && is_close(track, row, ego) {
                    continue;
                }
                self.roles[k] = self.appear(scene, options, k, frame, ego, planned.is_some());
                if let Role::Reactive(vehicle) = &self.roles[k] {
                    self.bodies.push(vehicle.body(k));
                    continue;
                }
            }
            if let Role::Replay(shape, since) = &self.roles[k] {
                let is_falling = shape.class == Some(BodyClass::ExtraLarge) && frame < since + FALLING;
                self.bodies.push(Body { is_falling, ..Body::of_track(k, source, row, *shape) });
            }
        }
    }

    /// Role of a track that becomes valid.
    fn appear(
        &mut self,
        scene: &SimScene,
        options: &TrafficOptions,
        k: usize,
        frame: usize,
        ego: &OrientedBox,
        is_planned: bool,
    ) -> Role {
        let recording = scene.scene();
        let track = &recording.tracks[k];
        let shape = if options.class_sizes {
            self.class(track, frame, options).map_or(BodyShape::default(), BodyShape::of_class)
        } else if recording.adversary == Some(k) {
            BodyShape::at_now(track)
        } else {
            BodyShape::default()
        };
        let reacts = options.mode == TrafficMode::Reactive && !is_planned && recording.adversary != Some(k);
        if reacts && !scene.is_parked(k) && reacts_to(track, frame, ego) {
            let body = Body::of_track(k, track, frame, shape);
            return Role::Reactive(Box::new(Reactive::new(scene, track, frame, &body, shape)));
        }
        Role::Replay(shape, frame)
    }

    /// MetaDrive's class of a track that appears at a frame.
    fn class(&mut self, track: &Track, frame: usize, options: &TrafficOptions) -> Option<BodyClass> {
        use BodyClass::{ExtraLarge, Large, Medium, Small};
        let mut next = |group: usize, classes: &[BodyClass]| {
            self.counters[group] += 1;
            classes[(self.counters[group] % classes.len() as u64) as usize]
        };
        let class = match BodyKind::of(track) {
            BodyKind::Pedestrian => BodyClass::Pedestrian,
            BodyKind::Cyclist => BodyClass::Cyclist,
            BodyKind::Object => return None,
            BodyKind::Vehicle => match track.size[frame][0] {
                length if length <= 4.0 => Small,
                length if length <= 5.5 => next(0, &[Medium, Large, Small]),
                _ => next(1, &[Large, ExtraLarge]),
            },
        };
        Some(options.classes.get(&track.id).copied().unwrap_or(class))
    }
}

/// The ego as the traffic sees it.
#[derive(Clone, Copy, Debug)]
pub struct EgoBody {
    /// Area that it covers.
    pub area: OrientedBox,
    /// Velocity, m/s.
    pub velocity: [f64; 2],
}

/// Whether a car would appear within [`CLOSE`] of the ego.
fn is_close(track: &Track, frame: usize, ego: &OrientedBox) -> bool {
    let [ahead, aside] = ego.to_local(track.point(frame));
    BodyKind::of(track) == BodyKind::Vehicle && ahead.abs() <= CLOSE[0] && aside.abs() <= CLOSE[1]
}

/// MetaDrive's choice of the vehicles that react.
fn reacts_to(track: &Track, frame: usize, ego: &OrientedBox) -> bool {
    let [ahead, aside] = ego.to_local(track.point(frame));
    let heading = track.heading[frame];
    let last = (frame..track.valid.len()).take_while(|&f| track.valid[f]).last().unwrap_or(frame);
    BodyKind::of(track) == BodyKind::Vehicle
        && ahead < -BEHIND
        && aside.abs() <= BESIDE
        && dot([heading.cos(), heading.sin()], ego.axis) > 0.0
        && sage_core::geometry::distance(track.point(frame), track.point(last)) > LEAST_ROUTE
}

impl Reactive {
    fn new(scene: &SimScene, track: &Track, frame: usize, body: &Body, shape: BodyShape) -> Self {
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
    fn advance(&mut self, others: &[Body], own: usize, ego: &EgoBody) -> bool {
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
        self.at.along < self.route.length() - ROUTE_END
    }

    fn body(&self, track: usize) -> Body {
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

/// Speed limit of the lane at a point, m/s.
pub fn speed_limit(scene: &SimScene, p: [f64; 2]) -> Option<f64> {
    let lanes = scene.index().motor_lanes();
    let limit = |feature: u32| {
        let lane = scene.scene().map.features[feature as usize].lane.as_ref()?;
        lane.speed_limit.filter(|limit| *limit > 0.0)
    };
    let near = lanes.nearest(p, LIMIT_REACH, |segment| limit(segment.feature).is_some())?;
    limit(lanes.segments()[near.segment].feature)
}
