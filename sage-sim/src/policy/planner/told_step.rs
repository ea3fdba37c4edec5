//! What a planner is told before a step.

use sage_core::{
    geometry::{Point, norm, sub},
    motion::DT,
    scene::Scene,
};
use serde::{Serialize, ser::SerializeStruct};

use super::{all_rounded, rounded};
use crate::{
    body::{Body, BodyKind},
    observation::LENGTH,
    policy::View,
    world::Control,
};

/// What a planner is told before a step, rounded to a billionth. The ids of road users and of the lights on the route are
/// those of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ToldStep {
    /// Seconds since frame 0.
    pub t: f64,
    /// Position of the car's centre, metres.
    pub position: Point,
    /// Its heading, rad.
    pub heading: f64,
    /// Its velocity, m/s.
    pub velocity: Point,
    /// Its yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Its acceleration in the step before, along the way it points, m/s²; 0 at the start.
    pub acceleration: f64,
    /// Angle of its front wheels in the step before, rad, positive to the left.
    pub steering_angle: f64,
    /// The nearest road users, the nearest first.
    pub agents: Vec<ToldAgent>,
    /// States of the lights on the route.
    pub lights: Vec<&'static str>,
    /// States of the other lights of the scene.
    pub other_lights: Vec<&'static str>,
}

/// What a car did in the step before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepBefore {
    /// Forward speed at its start, m/s; `None` before the first step.
    pub speed: Option<f64>,
    /// Angle of the front wheels, rad.
    pub steering_angle: f64,
}

impl StepBefore {
    /// The step that begins at a view, with the control that is given for it.
    pub fn of(view: &View, control: &Control) -> Self {
        let steering_angle = match control {
            Control::Drive(action) => action.limited().steer * view.car().max_steering,
            Control::Follow { .. } | Control::Pose { .. } => 0.0,
        };
        Self { speed: Some(view.motion().body_velocity()[0]), steering_angle }
    }
}

/// A road user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldAgent {
    /// Its track.
    pub track: usize,
    /// "vehicle", "pedestrian", "cyclist" or "object".
    pub kind: &'static str,
    /// Length and width, metres.
    pub size: [f64; 2],
    /// Centre, metres.
    pub position: Point,
    /// Heading, rad.
    pub heading: f64,
    /// Velocity, m/s.
    pub velocity: Point,
}

fn kind(body: &Body) -> &'static str {
    match body.kind {
        BodyKind::Vehicle => "vehicle",
        BodyKind::Pedestrian => "pedestrian",
        BodyKind::Cyclist => "cyclist",
        BodyKind::Object => "object",
    }
}

impl ToldStep {
    /// What is told of a view, with the nearest `most` road users.
    pub fn new(view: &View, most: usize, before: &StepBefore) -> Self {
        let motion = view.motion();
        let distance = |body: &Body| norm(sub(body.area.center, motion.position));
        let mut near: Vec<(f64, &Body)> = view.others().map(|body| (distance(body), body)).collect();
        // The nearest first; of equals the first track.
        near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let agents = near.into_iter().take(most).map(|(_, body)| ToldAgent {
            track: body.track,
            kind: kind(body),
            size: all_rounded([2.0 * body.area.half_length, 2.0 * body.area.half_width]),
            position: all_rounded(body.area.center),
            heading: rounded(body.heading),
            velocity: all_rounded(body.velocity),
        });
        let lights = view.route_lights();
        Self {
            t: rounded(view.step() as f64 * DT),
            position: all_rounded(motion.position),
            heading: rounded(motion.heading),
            velocity: all_rounded(motion.velocity),
            yaw_rate: rounded(motion.yaw_rate),
            acceleration: rounded(before.speed.map_or(0.0, |speed| (motion.body_velocity()[0] - speed) / DT)),
            steering_angle: rounded(before.steering_angle),
            agents: agents.collect(),
            lights: lights.stops().iter().map(|stop| view.light(stop.light).word()).collect(),
            other_lights: lights.elsewhere(view.scene().scene()).map(|k| view.light(k).word()).collect(),
        }
    }

    /// The message `step` of the protocol, with the 101 numbers of a learning driver, if they are asked for.
    pub fn message<'a>(&'a self, scene: &'a Scene, observation: Option<&'a [f32; LENGTH]>) -> impl Serialize {
        Message { step: self, scene, observation }
    }
}

struct Message<'a> {
    step: &'a ToldStep,
    scene: &'a Scene,
    observation: Option<&'a [f32; LENGTH]>,
}

impl Serialize for Message<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { step, scene, observation } = self;
        let agent = |agent: &ToldAgent| Agent {
            id: &scene.tracks[agent.track].id,
            kind: agent.kind,
            size: agent.size,
            position: agent.position,
            heading: agent.heading,
            velocity: agent.velocity,
        };
        let ego = Ego {
            position: step.position,
            heading: step.heading,
            velocity: step.velocity,
            yaw_rate: step.yaw_rate,
            acceleration: step.acceleration,
            steering_angle: step.steering_angle,
        };
        let mut message = serializer.serialize_struct("step", 6)?;
        message.serialize_field("t", &step.t)?;
        message.serialize_field("ego", &ego)?;
        message.serialize_field("agents", &step.agents.iter().map(agent).collect::<Vec<_>>())?;
        message.serialize_field("lights", &step.lights)?;
        message.serialize_field("other_lights", &step.other_lights)?;
        if let Some(numbers) = observation {
            message.serialize_field("observation", &numbers[..])?;
        }
        message.end()
    }
}

#[derive(Serialize)]
struct Ego {
    position: Point,
    heading: f64,
    velocity: Point,
    yaw_rate: f64,
    acceleration: f64,
    steering_angle: f64,
}

#[derive(Serialize)]
struct Agent<'a> {
    id: &'a str,
    #[serde(rename = "type")]
    kind: &'static str,
    size: [f64; 2],
    position: Point,
    heading: f64,
    velocity: Point,
}
