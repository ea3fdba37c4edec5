//! How a plan is driven: by the tracker and the bicycle of `pdm`, or exactly, pose by pose.

use std::f64::consts::{FRAC_PI_2, PI};

use sage_core::{
    geometry::{Point, dot, norm, sub, wrap_angle},
    motion::{DT, Pose},
};

use super::answer::{Answer, PlannedPose};
use crate::{
    policy::{
        View,
        pdm::tracker::{Bicycle, Driven, Reference, track},
    },
    vehicle::{Action, GRAVITY, Vehicle},
    world::Control,
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

    /// The control of a step at which the planner is not asked; `None` if it is.
    ///
    /// *Errors*: in words, a pose of a plan that is followed exactly is beyond the limits of the car.
    pub fn kept(&mut self, view: &View) -> Result<Option<Control>, String> {
        let plan = self.plan.as_mut().filter(|plan| plan.is_kept());
        plan.map(|plan| plan.next(view, &mut self.memory)).transpose()
    }

    /// The control of a step at which the planner answers, and the positions of its plan in the world, the present one first;
    /// none for a control.
    ///
    /// *Errors*: as [`Follower::kept`].
    pub fn follow(&mut self, view: &View, answer: Answer) -> Result<(Control, Vec<Point>), String> {
        match answer {
            Answer::Control(action) => Ok((Control::Drive(action), Vec::new())),
            Answer::Plan { poses, again, is_exact } => {
                let plan = self.plan.insert(Followed::new(view, &poses, again, is_exact));
                Ok((plan.next(view, &mut self.memory)?, plan.centers.clone()))
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
    /// Heading and speed at each step, if it is followed exactly.
    exact: Option<Vec<(f64, Option<f64>)>>,
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
    fn new(view: &View, poses: &[PlannedPose], again: usize, is_exact: bool) -> Self {
        let motion = view.motion();
        let centers = centers(motion.position, motion.heading, poses);
        let references = references(&centers, motion.heading, view.car().rear, poses);
        let exact = is_exact.then(|| {
            let headings = headings(&centers, motion.heading, poses).into_iter().skip(1);
            headings.zip(poses).map(|(heading, pose)| (heading, pose.speed)).collect()
        });
        Self { references, centers, step: 0, again, exact }
    }

    /// Whether the planner need not be asked.
    fn is_kept(&self) -> bool {
        self.step < self.again
    }

    /// The control of the next step.
    fn next(&mut self, view: &View, memory: &mut Memory) -> Result<Control, String> {
        match &self.exact {
            Some(poses) => {
                // Behind its end a plan stands.
                let k = self.step.min(poses.len() - 1);
                let is_over = self.step > k;
                self.step += 1;
                let (heading, speed) = poses[k];
                let speed = if is_over { Some(0.0) } else { speed };
                posed(view, Pose { position: self.centers[k + 1], heading }, speed)
            }
            None => Ok(Control::Drive(self.tracked(view, memory))),
        }
    }

    /// The action of the tracker.
    fn tracked(&mut self, view: &View, memory: &mut Memory) -> Action {
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

/// The control that sets the car to a pose, with a speed along its heading, or that of the way there.
///
/// *Errors*: in words, the car cannot get there in a step.
fn posed(view: &View, pose: Pose, speed: Option<f64>) -> Result<Control, String> {
    let (motion, car) = (view.motion(), view.car());
    let (sin, cos) = pose.heading.sin_cos();
    let moved = sub(pose.position, motion.position);
    let turned = wrap_angle(pose.heading - motion.heading);
    let (middle_sin, middle_cos) = (motion.heading + 0.5 * turned).sin_cos();
    let [along, aside] = [[middle_cos, middle_sin], [-middle_sin, middle_cos]].map(|axis| dot(axis, moved));
    let now = motion.body_velocity()[0];
    let limits = Limits::of(car);
    let values = [
        (
            "speed along the way there",
            along / DT,
            [now - limits.braking * DT, now + limits.throttle * DT],
            "m/s",
        ),
        (
            "yaw rate",
            turned / DT,
            [-1.0, 1.0].map(|side| side * limits.yaw_rate(now.max(along / DT))),
            "rad/s",
        ),
        ("way sideways", aside, [-ASIDE, ASIDE], "m"),
    ];
    for (name, value, [low, high], unit) in values {
        if !(low..=high).contains(&value) {
            return Err(format!(
                "the pose that is due is beyond the car: {name} {value:.2} {unit}; from where it is expected {low:.2} to {high:.2}; \"follow\": \"tracked\" takes any plan"
            ));
        }
    }
    let speed = speed.unwrap_or(along / DT);
    Ok(Control::Follow { pose, velocity: [speed * cos, speed * sin] })
}

/// What a car can do in a step that follows a plan exactly, with some room for rounded poses.
struct Limits {
    /// m/s².
    throttle: f64,
    braking: f64,
    /// 1/m.
    curvature: f64,
    /// m/s².
    lateral: f64,
}

/// Room for rounded poses: acceleration, m/s²; sideways in a step, metres; yaw rate, rad/s.
const ROOM: f64 = 1.0;
const ASIDE: f64 = 0.2;
const ROOM_TO_TURN: f64 = 0.1;

impl Limits {
    fn of(car: &Vehicle) -> Self {
        Self {
            throttle: car.full_throttle() + ROOM,
            braking: car.full_brake(),
            curvature: car.max_steering.tan() / (car.front + car.rear),
            lateral: car.friction * GRAVITY,
        }
    }

    /// Largest yaw rate at a speed, by the wheels and by the tyres, rad/s.
    fn yaw_rate(&self, speed: f64) -> f64 {
        let speed = speed.max(0.0);
        ROOM_TO_TURN + (speed * self.curvature).min(self.lateral / speed.max(f64::MIN_POSITIVE))
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
