//! Trailers of the ego, and of an adversary that does not repeat its recording, are towed along.

use sage_core::{
    geometry::{OrientedBox, sub, wrap_angle},
    motion::{DT, NOW},
    scene::Hitch,
};

use super::World;
use crate::body::Body;

impl World {
    /// Moves the trailer of an adversary that does not repeat its recording.
    pub(super) fn tow_of_adversary(&mut self) {
        let [_, Some(hitch)] = self.scene.hitches() else { return };
        let has_plan =
            self.plan.as_ref().is_some_and(|plan| plan.track == hitch.car) && self.state.step > NOW;
        let car = self.bodies().iter().find(|body| body.track == hitch.car).map(|body| body.area);
        if let Some(car) = car.filter(|_| has_plan || self.state.driven.is_some()) {
            self.tow(&hitch, car);
        }
    }

    /// Moves the trailer of the ego.
    pub(super) fn tow_of_ego(&mut self) {
        if let [Some(hitch), _] = self.scene.hitches() {
            self.tow(&hitch, self.area());
        }
    }

    /// Moves a trailer behind a car that has moved.
    fn tow(&mut self, hitch: &Hitch, car: OrientedBox) {
        let find = |bodies: &[Body]| bodies.iter().find(|body| body.track == hitch.trailer).copied();
        let (Some(now), Some(before)) = (find(self.bodies()), find(self.bodies_before())) else { return };
        let (center, heading) = hitch.follow(&car, before.area.center);
        let [length, width] = [2.0 * now.area.half_length, 2.0 * now.area.half_width];
        self.state.traffic.set_body(Body {
            area: OrientedBox::new(center, heading, length, width),
            heading,
            velocity: sub(center, before.area.center).map(|d| d / DT),
            yaw_rate: wrap_angle(heading - before.heading) / DT,
            ground: self.scene.follow_level(center, before.ground),
            ..now
        });
    }
}
