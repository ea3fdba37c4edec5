//! How the car, and an adversary that a policy drives, move within a step.

use sage_core::{
    geometry::{OrientedBox, Point, sub, wrap_angle},
    motion::{DT, Pose},
};

use super::{
    Contact, Control, World,
    control::posed,
    nearby::{Pair, near},
};
use crate::{
    physics::{Obstacle, Physics},
    vehicle::{Action, Motion, SUBSTEP, SUBSTEPS, Tyres, Wheels},
};

/// Substeps at the start in which MetaDrive's car is still in the air.
const AIRBORNE: usize = 4;
/// Speed that a car gains by its own tyres in a step, at most, m/s.
const STEP_GAIN: f64 = 0.5;

impl World {
    /// Drives the car through the tyres, and through contacts.
    pub(super) fn drive(&mut self, action: Action) {
        let car = self.car;
        let mut motion = self.state.physical;
        let wheels = Wheels::set(&car, action.limited(), motion.speed());
        let near = self.near(&motion);
        let mut physics = (!near.is_empty()).then(|| self.physics(&motion, &near));
        let most = self.fastest(&motion, &near);
        let mut tyres = self.state.tyres;
        let mut shown = motion;
        for substep in 1..=SUBSTEPS {
            shown = motion;
            let has_grip = !(self.options.airborne_start && self.state.step == 1 && substep <= AIRBORNE);
            let mut impulses = |motion: &mut Motion| {
                if has_grip {
                    tyres.apply(&car, &wheels, motion);
                }
            };
            let free = motion.coasted(SUBSTEP);
            if let Some(physics) = &mut physics {
                physics.step(|motion| {
                    limit(motion, most);
                    impulses(motion);
                });
                motion = physics.car();
            } else {
                motion = free;
                impulses(&mut motion);
            }
            // The physics keeps bodies apart, so the test is at the pose that the car would have reached.
            self.note_contacts(&near, &self.area_at(&free), substep);
        }
        self.state.tyres = tyres;
        self.state.physical = motion;
        let late = Motion { velocity: motion.velocity, yaw_rate: motion.yaw_rate, ..shown };
        self.state.motion = if self.options.late_pose { late } else { motion };
    }

    /// Moves the car to a pose along a straight line.
    pub(super) fn place(&mut self, pose: Pose, velocity: Option<Point>) {
        let start = self.state.motion;
        let end = posed(&start, pose, velocity);
        let moved = sub(end.position, start.position);
        let turned = wrap_angle(end.heading - start.heading);
        // The physical pose is ahead of a late one.
        let lead = if self.options.late_pose { SUBSTEP } else { 0.0 };
        let near = self.near(&Motion { velocity: [moved[0] / DT, moved[1] / DT], ..start });
        for substep in 1..=SUBSTEPS {
            let share = substep as f64 / SUBSTEPS as f64;
            let at = Motion {
                position: [0, 1].map(|k| start.position[k] + share * moved[k] + lead * end.velocity[k]),
                heading: start.heading + share * turned + lead * end.yaw_rate,
                ..end
            };
            self.note_contacts(&near, &self.area_at(&at), substep);
        }
        self.state.motion = end;
        self.state.physical = end.coasted(lead);
        self.state.tyres = Tyres::default();
    }

    /// Moves an adversary that a policy drives; nothing pushes it.
    pub(super) fn move_adversary(&mut self, control: Option<Control>) {
        let (Some(driven), Some(control)) = (&mut self.state.driven, control) else { return };
        let start = driven.motion;
        match control {
            Control::Drive(action) => {
                let wheels = Wheels::set(&self.car, action.limited(), start.speed());
                for _ in 0..SUBSTEPS {
                    driven.motion = driven.motion.coasted(SUBSTEP);
                    driven.tyres.apply(&self.car, &wheels, &mut driven.motion);
                }
            }
            Control::Pose { pose, velocity } => driven.motion = posed(&start, pose, velocity),
            Control::Follow { pose, velocity } => driven.motion = posed(&start, pose, Some(velocity)),
        }
        let motion = driven.motion;
        let [length, width] = [2.0 * driven.body.area.half_length, 2.0 * driven.body.area.half_width];
        driven.body.area = OrientedBox::new(motion.position, motion.heading, length, width);
        (driven.body.heading, driven.body.velocity) = (motion.heading, motion.velocity);
        driven.body.yaw_rate = motion.yaw_rate;
        driven.body.ground = self.scene.follow_level(motion.position, driven.body.ground);
        self.state.traffic.set_body(driven.body);
    }

    fn near(&self, motion: &Motion) -> Vec<Pair> {
        let radius = 0.5 * self.size[0].hypot(self.size[1]);
        let (traffic, options) = (&self.state.traffic, &self.options);
        let mut near = near(traffic, motion, radius, options.traffic.dynamic, options.whole_physics);
        near.retain(|pair| self.may_meet(&pair.from));
        near
    }

    /// Largest speed, m/s, and yaw rate, rad/s, that contacts can give the car. Bodies that nothing pushes
    /// would throw out a car that they squeeze between them.
    fn fastest(&self, motion: &Motion, near: &[Pair]) -> Option<[f64; 2]> {
        if self.options.traffic.dynamic {
            return None;
        }
        let close = near.iter().filter(|pair| pair.is_close);
        let speeds = close.map(|pair| pair.from.speed().max(pair.to.speed()).max(pair.travel() / DT));
        // A braked or driven car gains less than this in a step.
        let speed = speeds.fold(motion.speed(), f64::max) + STEP_GAIN;
        Some([speed, motion.yaw_rate.abs().max(2.0 * speed / self.size[0])])
    }

    fn physics(&self, motion: &Motion, near: &[Pair]) -> Physics {
        let present = near.iter().filter(|pair| !pair.appears);
        let obstacles = present.map(|pair| {
            if self.options.traffic.dynamic { Obstacle::dynamic(&pair.from) } else { pair.kinematic() }
        });
        Physics::new(&self.car, motion, &self.area_at(motion), obstacles.collect())
    }

    fn note_contacts(&mut self, near: &[Pair], car: &OrientedBox, substep: usize) {
        let is_dynamic = self.options.traffic.dynamic;
        for pair in near {
            let track = pair.to.track;
            if pair.appears && substep < SUBSTEPS {
                continue;
            }
            let is_known = self.state.events.contacts.iter().any(|contact| contact.track == track);
            let other = pair.at(substep, is_dynamic);
            if !is_known && pair.from.touches(&other, car) {
                self.state.events.contacts.push(Contact { track, substep, own: *car, other });
            }
        }
    }
}

/// Limits speed and yaw rate.
fn limit(motion: &mut Motion, most: Option<[f64; 2]>) {
    let Some([speed, yaw_rate]) = most else { return };
    let found = motion.speed();
    if found > speed {
        motion.velocity = motion.velocity.map(|v| v * speed / found);
    }
    motion.yaw_rate = motion.yaw_rate.clamp(-yaw_rate, yaw_rate);
}
