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
    /// The nearest road users, the nearest first.
    pub agents: Vec<ToldAgent>,
    /// States of the lights on the route.
    pub lights: Vec<&'static str>,
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
    pub fn new(view: &View, most: usize) -> Self {
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
        Self {
            t: rounded(view.step() as f64 * DT),
            position: all_rounded(motion.position),
            heading: rounded(motion.heading),
            velocity: all_rounded(motion.velocity),
            yaw_rate: rounded(motion.yaw_rate),
            agents: agents.collect(),
            lights: view.route_lights().stops().iter().map(|stop| view.light(stop.light).word()).collect(),
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
        };
        let mut message = serializer.serialize_struct("step", 5)?;
        message.serialize_field("t", &step.t)?;
        message.serialize_field("ego", &ego)?;
        message.serialize_field("agents", &step.agents.iter().map(agent).collect::<Vec<_>>())?;
        message.serialize_field("lights", &step.lights)?;
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
