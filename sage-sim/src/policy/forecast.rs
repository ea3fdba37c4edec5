//! Forecasts of other road users: constant speed and yaw rate, from their state now.

use sage_core::{
    geometry::{OrientedBox, Point},
    motion::DT,
};

use crate::body::Body;

/// Yaw rates below this are taken as straight driving, rad/s.
const STRAIGHT: f64 = 0.02;

/// Boxes of a body after 0, 1, …, `steps` steps.
pub(super) fn boxes(body: &Body, steps: usize) -> Vec<OrientedBox> {
    let speed = body.speed();
    // A slow body turns on the spot in recordings; its yaw rate is noise.
    let rate = if speed < 0.5 || body.yaw_rate.abs() < STRAIGHT { 0.0 } else { body.yaw_rate };
    let course = body.velocity[1].atan2(body.velocity[0]);
    let mut center: Point = body.area.center;
    let (size, mut boxes) =
        ([2.0 * body.area.half_length, 2.0 * body.area.half_width], Vec::with_capacity(steps + 1));
    boxes.push(body.area);
    for step in 1..=steps {
        let turned = rate * DT * step as f64;
        let (sin, cos) = (course + turned - 0.5 * rate * DT).sin_cos();
        center = [center[0] + speed * DT * cos, center[1] + speed * DT * sin];
        boxes.push(OrientedBox::new(center, body.heading + turned, size[0], size[1]));
    }
    boxes
}
