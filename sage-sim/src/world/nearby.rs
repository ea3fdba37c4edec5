//! The bodies that the car may touch within a step. All others stay out of tests and physics.

use sage_core::{
    geometry::{OrientedBox, distance, sub, wrap_angle},
    motion::DT,
};

use crate::{
    body::Body,
    physics::Obstacle,
    traffic::Traffic,
    vehicle::{Motion, SUBSTEPS},
};

/// Largest distance that acceleration adds to a step, metres: 2 g for 0.1 s, doubled.
const ACCELERATION: f64 = 0.2;
/// Further distance within which bodies are kept, metres.
const MARGIN: f64 = 0.5;

/// Pairs of bodies that the car may touch, in the order of their tracks.
///
/// `radius` is that of the car's box, metres. `coasts`: bodies move freely from the start of the step. `all`
/// keeps every body.
pub(super) fn near(traffic: &Traffic, car: &Motion, radius: f64, coasts: bool, all: bool) -> Vec<Pair> {
    let reach = radius + car.speed() * DT + ACCELERATION + MARGIN;
    let mut near = within(traffic, car, reach, coasts, all);
    let close = near.iter().filter(|pair| pair.is_close);
    // A body that touches the car may push it, by no more than it moves itself.
    if let Some(push) = close.map(Pair::travel).reduce(f64::max) {
        near = within(traffic, car, reach + push, coasts, all);
    }
    near
}

fn within(traffic: &Traffic, car: &Motion, reach: f64, coasts: bool, all: bool) -> Vec<Pair> {
    let (before, after) = (traffic.bodies_before(), traffic.bodies());
    let mut pairs = Vec::new();
    let mut keep = |from: &Body, to: &Body, appears: bool| {
        let mut pair = Pair { from: *from, to: *to, appears, is_close: false };
        pair.is_close = pair.is_within(car, reach);
        if all || pair.is_close {
            pairs.push(pair);
        }
    };
    if coasts {
        // Bodies that move freely are still at the start of the step.
        after.iter().for_each(|body| keep(body, body, false));
        return pairs;
    }
    // Both lists are in the order of their tracks. Bodies that vanish were there until the last step.
    let mut earlier = before.iter().peekable();
    for to in after {
        while earlier.next_if(|body| body.track < to.track).is_some() {}
        match earlier.next_if(|body| body.track == to.track) {
            Some(from) => keep(from, to, false),
            None => keep(to, to, true),
        }
    }
    pairs
}

/// A body at both ends of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    /// At the start of the step; at its end if it appears.
    pub(super) from: Body,
    /// At the end of the step; at its start if it moves freely.
    pub(super) to: Body,
    /// Whether it is there only at the end.
    pub(super) appears: bool,
    /// Whether the car can touch it within the step.
    pub(super) is_close: bool,
}

impl Pair {
    /// Whether its centre comes within `reach` plus its radius of a car that moves less than that.
    fn is_within(&self, car: &Motion, reach: f64) -> bool {
        let d = sub(self.from.area.center, car.position);
        let reach = reach + self.travel() + self.from.area.radius().max(self.to.area.radius());
        d[0] * d[0] + d[1] * d[1] <= reach * reach
    }

    /// Distance that it moves in the step, metres.
    pub(super) fn travel(&self) -> f64 {
        distance(self.from.area.center, self.to.area.center).max(self.from.speed() * DT)
    }

    /// The area at a substep.
    pub(super) fn at(&self, substep: usize, coasts: bool) -> OrientedBox {
        let share = substep as f64 / SUBSTEPS as f64;
        if coasts {
            self.from.coasted(share * DT)
        } else if substep == SUBSTEPS {
            self.to.area
        } else {
            self.from.area.between(&self.to.area, share)
        }
    }

    /// The body at constant velocity from one end of the step to the other.
    pub(super) fn kinematic(&self) -> Obstacle {
        let moved = sub(self.to.area.center, self.from.area.center);
        let motion = Motion {
            position: self.from.area.center,
            heading: self.from.heading,
            velocity: moved.map(|d| d / DT),
            yaw_rate: wrap_angle(self.to.heading - self.from.heading) / DT,
        };
        Obstacle::kinematic(self.from.area, motion, self.from.disc())
    }
}
