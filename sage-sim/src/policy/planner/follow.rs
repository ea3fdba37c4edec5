//! How a plan is driven: by the tracker and the bicycle of `pdm`.

use std::f64::consts::{FRAC_PI_2, PI};

use sage_core::{
    geometry::{Point, dot, norm, sub, wrap_angle},
    motion::DT,
};

use super::answer::{Answer, PlannedPose};
use crate::{
    policy::{
        View,
        pdm::tracker::{Bicycle, Driven, Reference, track},
    },
    vehicle::Action,
};

/// Distance of two positions below which they give no heading, metres.
const SHORTEST: f64 = 0.01;

/// Turns the answers of a planner into actions. A plan is followed until the planner is to be asked again.
#[derive(Default)]
pub struct Follower {
    plan: Option<Followed>,
    memory: Memory,
}

impl Follower {
    /// Whether the planner is asked at the next step.
    pub fn asks(&self) -> bool {
        self.plan.as_ref().is_none_or(|plan| !plan.is_kept())
    }

    /// The action of a step at which the planner is not asked; `None` if it is.
    pub fn kept_action(&mut self, view: &View) -> Option<Action> {
        let plan = self.plan.as_mut().filter(|plan| plan.is_kept())?;
        Some(plan.next(view, &mut self.memory))
    }

    /// The action of a step at which the planner answers, and the positions of its plan in the world, the present one first;
    /// none for a control.
    pub fn follow(&mut self, view: &View, answer: Answer) -> (Action, Vec<Point>) {
        match answer {
            Answer::Control(action) => (action, Vec::new()),
            Answer::Plan { poses, again } => {
                let plan = self.plan.insert(Followed::new(view, &poses, again));
                (plan.next(view, &mut self.memory), plan.centers.clone())
            }
        }
    }
}

/// A plan that is followed.
struct Followed {
    /// Where the rear axle should be at each step since the plan was made.
    references: Vec<Reference>,
    /// Where the centre should be.
    centers: Vec<Point>,
    /// Steps since then.
    step: usize,
    /// Steps that it is followed for.
    again: usize,
}

/// What a car remembers from step to step while it follows plans.
#[derive(Default)]
struct Memory {
    /// Angle of the front wheels, rad.
    steering: f64,
    /// Speed at the step before, m/s.
    speed: Option<f64>,
}

impl Followed {
    /// A plan that begins at the present pose.
    fn new(view: &View, poses: &[PlannedPose], again: usize) -> Self {
        let motion = view.motion();
        let centers = centers(motion.position, motion.heading, poses);
        let references = references(&centers, motion.heading, view.car().rear, poses);
        Self { references, centers, step: 0, again }
    }

    /// Whether the planner need not be asked.
    fn is_kept(&self) -> bool {
        self.step < self.again
    }

    /// The command of the next step.
    fn next(&mut self, view: &View, memory: &mut Memory) -> Action {
        let car = view.car();
        let bicycle = Bicycle { wheelbase: car.front + car.rear, max_steering: car.max_steering };
        let state = memory.state(view);
        let command = track(&bicycle, &state, &self.references, self.step);
        let after = state.after(&bicycle, &command);
        self.step += 1;
        *memory = Memory { steering: after.steering, speed: Some(state.speed) };
        Action { steer: after.steering / car.max_steering, throttle: car.throttle_for(command.acceleration) }
    }
}

impl Memory {
    /// The state of the car. Its acceleration is that of the last step.
    fn state(&self, view: &View) -> Driven {
        let (motion, rear) = (view.motion(), view.car().rear);
        let speed = motion.body_velocity()[0].max(0.0);
        Driven {
            axle: behind(motion.position, motion.heading, rear),
            heading: motion.heading,
            speed,
            acceleration: self.speed.map_or(0.0, |before| (speed - before) / DT),
            steering: self.steering,
        }
    }
}

fn behind([x, y]: Point, heading: f64, distance: f64) -> Point {
    let (sin, cos) = heading.sin_cos();
    [x - distance * cos, y - distance * sin]
}

/// Positions of a plan in the world, the present one first.
fn centers(position: Point, heading: f64, poses: &[PlannedPose]) -> Vec<Point> {
    let (sin, cos) = heading.sin_cos();
    let world_from_car = |[x, y]: Point| [position[0] + x * cos - y * sin, position[1] + x * sin + y * cos];
    std::iter::once(position).chain(poses.iter().map(|pose| world_from_car(pose.position))).collect()
}

/// References of the rear axle in the world, the first for now. Headings and speeds that a plan does not give are those
/// between its positions.
///
/// The reference for now lies on the plan, which is continued backwards: a plan beside the car leads it there.
fn references(centers: &[Point], heading: f64, rear: f64, poses: &[PlannedPose]) -> Vec<Reference> {
    let headings = headings(centers, heading, poses);
    let axles: Vec<Point> =
        centers.iter().zip(&headings).map(|(center, heading)| behind(*center, *heading, rear)).collect();
    let now = behind(centers[0], heading, rear);
    let count = axles.len();
    // Distance from each reference to the next along its heading; negative if the plan leads backwards.
    let along = |k: usize| {
        let from = if k == 0 { now } else { axles[k] };
        let (sin, cos) = headings[k + 1].sin_cos();
        dot(sub(axles[k + 1], from), [cos, sin])
    };
    let curvature = |k: usize| {
        let length = norm(sub(axles[k + 1], axles[k]));
        let turn = wrap_angle(headings[k + 1] - headings[k]);
        if length > SHORTEST { turn / length } else { 0.0 }
    };
    let reference = |k: usize| Reference {
        position: axles[k],
        heading: headings[k],
        speed: poses[k - 1].speed.unwrap_or_else(|| along(k - 1) / DT),
        curvature: if k + 1 < count { curvature(k) } else { 0.0 },
    };
    let mut all: Vec<Reference> = (1..count).map(reference).collect();
    let first = all[0];
    let distance = along(0).max(0.0);
    let heading = first.heading - first.curvature * distance;
    let (sin, cos) = (0.5 * (heading + first.heading)).sin_cos();
    let back = dot(sub(first.position, now), [cos, sin]);
    let position = [first.position[0] - back * cos, first.position[1] - back * sin];
    all.insert(0, Reference { position, heading, ..first });
    all
}

/// Headings at the positions of a plan, the present one first.
fn headings(centers: &[Point], heading: f64, poses: &[PlannedPose]) -> Vec<f64> {
    let mut all = vec![heading];
    for (k, pose) in poses.iter().enumerate() {
        // From the position before to the one after. The car need not be on the plan, so the first is left out.
        let last = centers.len() - 1;
        let from = if poses.len() == 1 { 0 } else { k.max(1) };
        let displacement = sub(centers[(k + 2).min(last)], centers[from]);
        let before = all[k];
        let along = if norm(displacement) > SHORTEST {
            let turn = wrap_angle(displacement[1].atan2(displacement[0]) - before);
            // A plan that leads back would be driven backwards, so the car stops.
            if turn.abs() > FRAC_PI_2 { before + wrap_angle(turn + PI) } else { before + turn }
        } else {
            before
        };
        all.push(pose.heading.map_or(along, |own| heading + own));
    }
    all
}
