//! Steering along a path by pure pursuit.
//!
//! The rear axle drives on the arc through a point of the path ahead: with that point at distance `d` and
//! angle `α` from the rear axle, the steering angle is `atan(2 (l_f + l_r) sin α / d)`.

use sage_core::{
    geometry::{Point, dot, sub, wrap_angle},
    motion::bicycle::Bicycle,
};

use crate::{
    route::{Coordinates, Route},
    vehicle::{Motion, Vehicle},
};

/// Look-ahead: a constant, metres, and a time, s.
const LOOK_AHEAD: [f64; 2] = [1.5, 0.25];
/// Largest look-ahead, metres.
const FARTHEST: f64 = 15.0;
/// Points ahead at which the curvature counts: number, distance between two, and half the length over which
/// the heading is compared, metres.
const CURVE_SAMPLES: usize = 30;
const CURVE_STEP: f64 = 2.0;
const CURVE_WINDOW: f64 = 4.0;

/// Steering in [−1, 1] that brings the car to a point ahead.
pub(super) fn towards(car: &Vehicle, motion: &Motion, target: Point) -> f64 {
    let (sin, cos) = motion.heading.sin_cos();
    from_pose(car, motion.position, [cos, sin], target)
}

/// Steering in [−1, 1] that brings the car from a position and direction to a point ahead.
pub(super) fn from_pose(car: &Vehicle, [x, y]: Point, [cos, sin]: Point, target: Point) -> f64 {
    let rear = [x - car.rear * cos, y - car.rear * sin];
    let d = sub(target, rear);
    let left = d[1] * cos - d[0] * sin;
    let squared = dot(d, d).max(1.0);
    let angle = (2.0 * (car.front + car.rear) * left / squared).atan();
    (angle / car.max_steering).clamp(-1.0, 1.0)
}

/// Look-ahead from the centre at a speed, metres.
pub(super) fn look_ahead(speed: f64) -> f64 {
    (LOOK_AHEAD[0] + LOOK_AHEAD[1] * speed).min(FARTHEST)
}

/// Steering in [−1, 1] along a route, at an offset across it (metres, positive to the right).
pub(super) fn along(car: &Vehicle, motion: &Motion, route: &Route, place: f64, across: f64) -> f64 {
    let ahead = Coordinates { along: place + look_ahead(motion.speed()), across };
    towards(car, motion, route.point(ahead))
}

/// Largest speed at which every curve ahead can be entered at a lateral acceleration (m/s²), after braking at
/// a deceleration (m/s²).
pub(super) fn curve_speed(route: &Route, along: f64, lateral: f64, braking: f64) -> f64 {
    let heading = |place: f64| route.heading(place.clamp(0.0, route.length()));
    let speeds = (0..CURVE_SAMPLES).map(|k| {
        let ahead = k as f64 * CURVE_STEP;
        let turn = wrap_angle(heading(along + ahead + CURVE_WINDOW) - heading(along + ahead - CURVE_WINDOW));
        let curvature = turn.abs() / (2.0 * CURVE_WINDOW);
        (lateral / curvature.max(1e-6) + 2.0 * braking * ahead).sqrt()
    });
    speeds.fold(f64::INFINITY, f64::min)
}

/// The car as a kinematic bicycle.
pub(super) fn bicycle(car: &Vehicle) -> Bicycle {
    Bicycle { front: car.front, rear: car.rear }
}
