//! Forecasts of other road users: constant speed and yaw rate, from their state now.

use std::cell::OnceCell;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point},
    motion::DT,
};

use crate::body::Body;

/// Yaw rates below this are taken as straight driving, rad/s.
const STRAIGHT: f64 = 0.02;
/// Distance by which bounds reach farther than the boxes, metres: far more than rounding.
const SLACK: f64 = 0.01;

/// Where a road user will be. Most are never near, so the boxes are worked out on first use.
pub(super) struct Forecast<'a> {
    /// Bounds of all boxes.
    pub(super) bounds: Aabb,
    source: Source<'a>,
    steps: usize,
    boxes: OnceCell<Vec<OrientedBox>>,
}

enum Source<'a> {
    Body(&'a Body),
    Standing(OrientedBox),
}

impl<'a> Forecast<'a> {
    /// The forecast of a body for `steps` steps.
    pub(super) fn of(body: &'a Body, steps: usize) -> Self {
        let time = DT * steps as f64;
        let ([x, y], [vx, vy]) = (body.area.center, body.velocity);
        let radius = body.area.radius() + SLACK;
        let bounds = if yaw_rate(body) == 0.0 {
            Aabb::of([[x, y], [x + time * vx, y + time * vy]]).grown(radius)
        } else {
            Aabb::around([x, y], body.speed() * time + radius)
        };
        Self { bounds, source: Source::Body(body), steps, boxes: OnceCell::new() }
    }

    /// The forecast of something that stands for `steps` steps.
    pub(super) fn standing(area: OrientedBox, steps: usize) -> Self {
        let bounds = area.aabb().grown(SLACK);
        Self { bounds, source: Source::Standing(area), steps, boxes: OnceCell::new() }
    }

    /// The box after 0, 1, …, `steps` steps.
    pub(super) fn at(&self, step: usize) -> &OrientedBox {
        match &self.source {
            Source::Body(body) => &self.boxes.get_or_init(|| boxes(body, self.steps))[step],
            Source::Standing(area) => area,
        }
    }
}

/// Yaw rate that counts, rad/s.
fn yaw_rate(body: &Body) -> f64 {
    // A slow body turns on the spot in recordings; its yaw rate is noise.
    if body.speed() < 0.5 || body.yaw_rate.abs() < STRAIGHT { 0.0 } else { body.yaw_rate }
}

/// Boxes of a body after 0, 1, …, `steps` steps.
fn boxes(body: &Body, steps: usize) -> Vec<OrientedBox> {
    let (speed, rate) = (body.speed(), yaw_rate(body));
    let course = body.velocity[1].atan2(body.velocity[0]);
    let mut center: Point = body.area.center;
    let size = [2.0 * body.area.half_length, 2.0 * body.area.half_width];
    // Direction in which the body moves to a step, and its box there but for the centre.
    let pose = |step: usize| {
        let turned = rate * DT * step as f64;
        let (sin, cos) = (course + turned - 0.5 * rate * DT).sin_cos();
        ([cos, sin], OrientedBox::new([0.0; 2], body.heading + turned, size[0], size[1]))
    };
    // Without a yaw rate it is the same at every step.
    let straight = (rate == 0.0).then(|| pose(1));
    let mut boxes = Vec::with_capacity(steps + 1);
    boxes.push(body.area);
    for step in 1..=steps {
        let ([cos, sin], area) = straight.unwrap_or_else(|| pose(step));
        center = [center[0] + speed * DT * cos, center[1] + speed * DT * sin];
        boxes.push(OrientedBox { center, ..area });
    }
    boxes
}

#[cfg(test)]
mod tests {
    use sage_core::seed::Rng;

    use super::*;
    use crate::body::BodyKind;

    #[test]
    fn bounds_hold_all_boxes_and_straight_drives_keep_their_axis() {
        let mut rng = Rng::new(0, "forecast", "bounds");
        for case in 0..500 {
            let heading = rng.uniform(-4.0, 4.0);
            let center = [rng.uniform(-1e4, 1e4), rng.uniform(-1e4, 1e4)];
            let body = Body {
                track: 0,
                kind: BodyKind::Vehicle,
                class: None,
                area: OrientedBox::new(center, heading, rng.uniform(0.5, 12.0), rng.uniform(0.5, 3.0)),
                heading,
                velocity: [rng.uniform(-20.0, 20.0), rng.uniform(-20.0, 20.0)],
                yaw_rate: if case % 2 == 0 { 0.0 } else { rng.uniform(-1.0, 1.0) },
                ground: 0.0,
                is_falling: false,
            };
            let forecast = Forecast::of(&body, 40);
            let all = (0..=40).fold(Aabb::EMPTY, |all, step| all.union(&forecast.at(step).aabb()));
            assert_eq!(forecast.bounds.union(&all), forecast.bounds);
            assert!(case % 2 == 1 || (0..=40).all(|step| forecast.at(step).axis == body.area.axis));
        }
    }
}
