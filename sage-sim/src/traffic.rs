//! The other road users: replay of the log, a plan of the adversary, or reactive followers.
//!
//! A reactive vehicle follows its logged path and keeps its distance by the Intelligent Driver Model. Only
//! vehicles behind the ego react, chosen once as in MetaDrive; all others replay the log.

mod plan;
mod reactive;

use std::collections::BTreeMap;

use sage_core::{
    geometry::{OrientedBox, wrap_angle},
    motion::DT,
    scene::Track,
};
use serde::{Deserialize, Serialize};

use crate::{
    body::{Body, BodyClass, BodyKind, BodyShape},
    scene::SimScene,
};
use reactive::{Reactive, reacts_to};

pub use plan::Plan;

/// Desired speed of reactive vehicles without a speed limit, m/s.
pub(crate) const DESIRED_SPEED: f64 = 40.0 / 3.6;
/// Largest distance of the lane whose speed limit counts, metres.
const LIMIT_REACH: f64 = 3.0;
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

/// What one track does.
#[derive(Clone, Debug, PartialEq)]
enum Role {
    Absent,
    /// With the frame at which it appeared.
    Replay(BodyShape, usize),
    Reactive(Box<Reactive>),
    /// A reactive vehicle that has reached the end of its route. It does not come back.
    Finished,
    /// Moved by a policy: its body is set from outside.
    Driven,
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

    /// Frame at which a track that was absent before appeared; `None` if it is there since frame 0, or if its recording does not
    /// move it.
    pub fn appearance_of(&self, track: usize) -> Option<usize> {
        match self.roles[track] {
            Role::Replay(_, since) => Some(since).filter(|since| *since > 0),
            _ => None,
        }
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
                    && !vehicle.advance(scene, &self.before, k, ego)
                {
                    self.roles[k] = Role::Finished;
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
            let planned = plan.filter(|plan| plan.track == k);
            let is_left_out = !options.parked && planned.is_none() && scene.is_parked(k);
            if k == recording.ego || is_left_out {
                continue;
            }
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
                Role::Finished => continue,
                Role::Absent | Role::Replay(..) => {}
            }
            // The first row of a late plan is consumed at frame 1.
            let row = if planned.is_some() && options.late_plan { frame.saturating_sub(1) } else { frame };
            if frame >= recording.frames || !source.is_valid(row) {
                self.roles[k] = Role::Absent;
                continue;
            }
            if self.roles[k] == Role::Absent {
                if options.skip_close && is_close(source, row, ego) {
                    continue;
                }
                let new = Appearance { k, source, row, frame, is_planned: planned.is_some() };
                self.roles[k] = self.appear(scene, options, new, ego);
                if let Role::Reactive(vehicle) = &self.roles[k] {
                    self.bodies.push(vehicle.body(k));
                    continue;
                }
            }
            if let Role::Replay(shape, since) = &self.roles[k] {
                let is_falling = shape.class == Some(BodyClass::ExtraLarge) && frame < since + FALLING;
                let mut body = Body { is_falling, ..Body::of_track(k, source, row, *shape) };
                if options.dynamic && source.is_valid(row + 1) {
                    body.yaw_rate = wrap_angle(source.heading[row + 1] - source.heading[row]) / DT;
                }
                // A plan has no heights.
                if let Some(last) = self.before.iter().find(|last| planned.is_some() && last.track == k) {
                    body.ground = scene.follow_level(body.area.center, last.ground);
                }
                self.bodies.push(body);
            }
        }
    }

    /// Role of a track that becomes valid.
    fn appear(
        &mut self,
        scene: &SimScene,
        options: &TrafficOptions,
        new: Appearance,
        ego: &OrientedBox,
    ) -> Role {
        let Appearance { k, source, row, frame, is_planned } = new;
        let is_adversary = scene.scene().adversary == Some(k);
        let shape = if options.class_sizes {
            self.class(source, row, options).map_or(BodyShape::default(), BodyShape::of_class)
        } else if is_adversary || is_planned {
            BodyShape::at_now(source)
        } else {
            BodyShape::default()
        };
        let may_react = options.mode == TrafficMode::Reactive && !is_planned && !is_adversary;
        if may_react && !scene.is_parked(k) && reacts_to(source, row, ego) {
            let body = Body::of_track(k, source, row, shape);
            return Role::Reactive(Box::new(Reactive::new(scene, source, row, &body, shape)));
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

/// A track that becomes valid.
struct Appearance<'a> {
    k: usize,
    /// Its log or its plan, and the row that is shown.
    source: &'a Track,
    row: usize,
    frame: usize,
    is_planned: bool,
}

/// Whether a car would appear within [`CLOSE`] of the ego.
fn is_close(track: &Track, frame: usize, ego: &OrientedBox) -> bool {
    let [ahead, aside] = ego.box_from_world(track.point(frame));
    BodyKind::of(track) == BodyKind::Vehicle && ahead.abs() <= CLOSE[0] && aside.abs() <= CLOSE[1]
}

/// Speed limit of the lane at a point, m/s.
pub fn speed_limit(scene: &SimScene, p: [f64; 2]) -> Option<f64> {
    let lanes = scene.index().motor_lanes();
    let limit = |feature: u32| {
        let lane = scene.index().map().features[feature as usize].lane.as_ref()?;
        lane.speed_limit.filter(|limit| *limit > 0.0)
    };
    let near = lanes.nearest(p, LIMIT_REACH, |segment| limit(segment.feature).is_some())?;
    limit(lanes.segments()[near.segment].feature)
}
