//! Kinematic bicycle model: the path of a car's centre under steering and acceleration.
//!
//! Wheels roll without slip; the slip angle at the centre is β = atan(l_r / (l_f + l_r) · tan δ) and
//! the yaw rate v cos β tan δ / (l_f + l_r) (Kong et al., IV 2015). Steps are integrated exactly
//! for constant speed and steering within the step.

use super::State;

/// Axles of a car.
///
/// ```
/// use sage_core::motion::{State, bicycle::Bicycle};
///
/// let car = Bicycle { front: 1.2, rear: 1.6 };
/// let start = State { position: [0.0, 0.0], heading: 0.0, speed: 10.0 };
/// // Straight on it moves by v · dt. Braking at 8 m/s² it loses 0.8 m/s in a step of 0.1 s.
/// assert_eq!(car.step(&start, 0.0, 0.0, 0.1).position, [1.0, 0.0]);
/// assert!((car.step(&start, 0.0, -8.0, 0.1).speed - 9.2).abs() < 1e-12);
/// // Steering to the left turns counter-clockwise.
/// assert!(car.step(&start, 0.1, 0.0, 0.1).heading > 0.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bicycle {
    /// Distance from the centre to the front axle, m, > 0.
    pub front: f64,
    /// Distance from the centre to the rear axle, m, > 0.
    pub rear: f64,
}

impl Bicycle {
    /// Slip angle of the centre's velocity against the body, rad.
    pub fn slip(&self, steering: f64) -> f64 {
        self.slip_at(steering.tan())
    }

    /// The same, given the tangent of the steering angle.
    fn slip_at(&self, tan: f64) -> f64 {
        (self.rear / (self.front + self.rear) * tan).atan()
    }

    /// Yaw rate at a speed and steering angle, rad/s.
    pub fn yaw_rate(&self, speed: f64, steering: f64) -> f64 {
        self.yaw_rate_at(speed, steering.tan(), self.slip(steering))
    }

    /// The same, given the tangent of the steering angle and the slip angle (rad).
    fn yaw_rate_at(&self, speed: f64, tan: f64, slip: f64) -> f64 {
        speed * slip.cos() * tan / (self.front + self.rear)
    }

    /// The state after `dt` seconds of constant steering (rad, |δ| < π/2) and acceleration
    /// (m/s²). A braking car stops at 0 m/s; it does not roll back.
    pub fn step(&self, state: &State, steering: f64, acceleration: f64, dt: f64) -> State {
        let speed = (state.speed + acceleration * dt).max(0.0);
        // A car that stops within the step travels v² / (2 |a|), not half of v · dt.
        let length = if speed > 0.0 || acceleration >= 0.0 {
            0.5 * (state.speed + speed) * dt
        } else {
            0.5 * state.speed * state.speed / -acceleration
        };
        let tan = steering.tan();
        let slip = self.slip_at(tan);
        let turn = self.yaw_rate_at(length, tan, slip);
        let course = state.heading + slip + 0.5 * turn;
        // Chord of an arc of this length and turn.
        let half = 0.5 * turn;
        let chord = if half.abs() < 1e-6 { length } else { length * half.sin() / half };
        State {
            position: [state.position[0] + chord * course.cos(), state.position[1] + chord * course.sin()],
            heading: state.heading + turn,
            speed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const CAR: Bicycle = Bicycle { front: 1.05234, rear: 1.4166 };

    #[test]
    fn constant_steering_drives_a_circle_that_closes() {
        let steering = 0.2;
        let rate = CAR.yaw_rate(8.0, steering);
        let steps = 1000;
        let dt = std::f64::consts::TAU / rate / steps as f64;
        let mut state = State { position: [3.0, -2.0], heading: 0.4, speed: 8.0 };
        for _ in 0..steps {
            state = CAR.step(&state, steering, 0.0, dt);
        }
        assert_relative_eq!(state.position[0], 3.0, epsilon = 1e-9);
        assert_relative_eq!(state.position[1], -2.0, epsilon = 1e-9);
        assert_relative_eq!(state.heading, 0.4 + std::f64::consts::TAU, epsilon = 1e-9);
    }

    #[test]
    fn braking_stops_after_v_squared_over_two_a() {
        let mut state = State { position: [0.0, 0.0], heading: 0.0, speed: 10.0 };
        for _ in 0..40 {
            state = CAR.step(&state, 0.0, -4.0, 0.1);
        }
        assert_relative_eq!(state.position[0], 100.0 / 8.0, epsilon = 1e-9);
        assert_eq!(state.speed, 0.0);
    }

    #[test]
    fn acceleration_covers_the_parabola() {
        let state = State { position: [0.0, 0.0], heading: std::f64::consts::FRAC_PI_2, speed: 2.0 };
        let after = CAR.step(&state, 0.0, 3.0, 0.5);
        assert_relative_eq!(after.position[1], 2.0 * 0.5 + 0.5 * 3.0 * 0.25, epsilon = 1e-12);
        assert_relative_eq!(after.speed, 3.5);
    }
}
