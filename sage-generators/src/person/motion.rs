//! How a person moves: on as before, then towards a point, within human limits.

use sage_core::{
    Error,
    geometry::{Point, distance, norm, sub, wrap_angle},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::PersonLimits,
    scene::Track,
};

/// Largest turn rate, rad/s.
const TURN_RATE: f64 = 2.0;
/// Speed below which a person turns on the spot, m/s.
const STANDING: f64 = 0.3;
/// Distance of the aim from which the direction is kept, metres: a person walks on past it.
const PASSED: f64 = 1.0;

/// Where a person goes, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Intent {
    /// The point that it heads for, and walks on past.
    pub aim: Point,
    /// Seconds after *now* until which it goes on as before.
    pub delay: f64,
    /// The speed that it takes up, m/s.
    pub speed: f64,
    /// The acceleration to get there, m/s².
    pub acceleration: f64,
}

impl Intent {
    /// The 80 positions of a person with this intent.
    ///
    /// *Errors*: none for finite numbers.
    pub(super) fn trajectory(&self, track: &Track, limits: &PersonLimits) -> Result<Trajectory, Error> {
        let mut at = track.point(NOW);
        let [vx, vy] = track.velocity[NOW];
        let mut speed = norm([vx, vy]).min(limits.top_speed);
        let mut heading = if speed < STANDING { track.heading[NOW] } else { vy.atan2(vx) };
        let mut is_past = false;
        let step = |k: usize| {
            let time = k as f64 * DT;
            if time >= self.delay {
                is_past |= distance(at, self.aim) < PASSED;
                let [x, y] = sub(self.aim, at);
                let turn = if is_past { 0.0 } else { wrap_angle(y.atan2(x) - heading) };
                let rate = if speed < STANDING {
                    f64::INFINITY
                } else {
                    TURN_RATE.min(0.8 * limits.lateral / speed)
                };
                heading += turn.clamp(-rate * DT, rate * DT);
                let change = self.acceleration * DT;
                speed += (self.speed - speed).clamp(-change, change);
            }
            let (sin, cos) = heading.sin_cos();
            at = [at[0] + speed * DT * cos, at[1] + speed * DT * sin];
            at
        };
        Trajectory::new("person", (0..HORIZON).map(step).collect())
    }

    /// Seconds that somebody who stands takes for a distance.
    pub(super) fn time_for(&self, metres: f64) -> f64 {
        let starting = 0.5 * self.speed * self.speed / self.acceleration;
        if metres < starting {
            return (2.0 * metres / self.acceleration).sqrt();
        }
        self.speed / self.acceleration + (metres - starting) / self.speed
    }
}
