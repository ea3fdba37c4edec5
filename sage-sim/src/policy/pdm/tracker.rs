//! How a proposal is driven: nuPlan's tracker, and a bicycle with first-order lags.
//!
//! The tracker looks one second ahead. Along the path it takes the acceleration that brings the speed there to the
//! reference; across it takes the steering rate, held for that second, that minimises
//! `1 · e_y² + 10 · e_ψ² + rate²` at its end.

use sage_core::{
    geometry::{Point, cross, sub, wrap_angle},
    motion::DT,
};

/// Steps that the tracker looks ahead.
pub(in crate::policy) const LOOK_AHEAD: usize = 10;
/// Weights of the distance across, of the heading, and of the error of the speed against the acceleration.
const ACROSS: f64 = 1.0;
const HEADING: f64 = 10.0;
const SPEED: f64 = 10.0;
/// Speed below which the car is brought to a stop, m/s, and the gain there, 1/s.
const STOPPING: f64 = 0.2;
const STOPPING_GAIN: f64 = 0.5;
/// Time constants of the acceleration and of the steering angle, seconds.
const LAGS: [f64; 2] = [0.2, 0.05];

/// Size of the car as a bicycle.
#[derive(Clone, Copy, Debug)]
pub(in crate::policy) struct Bicycle {
    /// Distance of the axles, metres.
    pub(in crate::policy) wheelbase: f64,
    /// Largest steering angle, rad.
    pub(in crate::policy) max_steering: f64,
}

/// State of a car that is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::policy) struct Driven {
    /// Centre of the rear axle, metres.
    pub(in crate::policy) axle: Point,
    /// Heading, rad.
    pub(in crate::policy) heading: f64,
    /// Speed, m/s.
    pub(in crate::policy) speed: f64,
    /// Acceleration, m/s².
    pub(in crate::policy) acceleration: f64,
    /// Steering angle, rad.
    pub(in crate::policy) steering: f64,
}

/// Where the car should be at a step.
#[derive(Clone, Copy, Debug)]
pub(in crate::policy) struct Reference {
    pub(in crate::policy) position: Point,
    pub(in crate::policy) heading: f64,
    pub(in crate::policy) speed: f64,
    /// 1/m, positive to the left.
    pub(in crate::policy) curvature: f64,
}

/// What the tracker asks for.
#[derive(Clone, Copy, Debug)]
pub(in crate::policy) struct Command {
    /// Acceleration, m/s².
    pub(in crate::policy) acceleration: f64,
    /// Rate of the steering angle, rad/s.
    pub(in crate::policy) rate: f64,
}

/// The command at a step of a proposal. The reference after its last step is that of the last step.
pub(in crate::policy) fn track(
    car: &Bicycle,
    state: &Driven,
    reference: &[Reference],
    step: usize,
) -> Command {
    let at = |k: usize| &reference[k.min(reference.len() - 1)];
    let target = at(step + LOOK_AHEAD).speed;
    if state.speed <= STOPPING && target <= STOPPING {
        return Command { acceleration: -STOPPING_GAIN * (state.speed - target), rate: 0.0 };
    }
    let acceleration = SPEED / (SPEED + 1.0) * (target - state.speed);
    let here = at(step);
    let (sin, cos) = here.heading.sin_cos();
    let across = cross([cos, sin], sub(state.axle, here.position));
    let turned = wrap_angle(state.heading - here.heading);
    let curvatures = std::array::from_fn(|k| at(step + k).curvature);
    let rate = steering_rate(
        car.wheelbase,
        [across, turned, state.steering],
        [state.speed, acceleration],
        &curvatures,
    );
    Command { acceleration, rate }
}

/// The steering rate (rad/s) for errors across (metres) and of the heading (rad), a steering angle (rad), a speed
/// (m/s) that changes with an acceleration (m/s²), and the curvatures ahead (1/m).
fn steering_rate(
    wheelbase: f64,
    [across, turned, angle]: [f64; 3],
    [speed, acceleration]: [f64; 2],
    curvatures: &[f64; LOOK_AHEAD],
) -> f64 {
    // The state after the look-ahead is `free + rate · gain`.
    let (mut free, mut gain) = ([across, turned, angle], [0.0; 3]);
    for (k, curvature) in curvatures.iter().enumerate() {
        let travel = DT * (speed + DT * k as f64 * acceleration);
        free = [free[0] + travel * free[1], free[1] + travel * (free[2] / wheelbase - curvature), free[2]];
        gain = [gain[0] + travel * gain[1], gain[1] + travel * gain[2] / wheelbase, gain[2] + DT];
    }
    let cost = |a: [f64; 3], b: [f64; 3]| ACROSS * a[0] * b[0] + HEADING * a[1] * b[1];
    -cost(gain, free) / (cost(gain, gain) + 1.0)
}

impl Driven {
    /// The state after one step under a command. The speed never falls below 0.
    pub(in crate::policy) fn after(&self, car: &Bicycle, command: &Command) -> Self {
        self.after_along(car, command, self.axis())
    }

    /// Unit vector of the heading.
    pub(in crate::policy) fn axis(&self) -> Point {
        let (sin, cos) = self.heading.sin_cos();
        [cos, sin]
    }

    /// The state after one step, given [`Driven::axis`].
    pub(in crate::policy) fn after_along(&self, car: &Bicycle, command: &Command, [cos, sin]: Point) -> Self {
        let [quick, slow] = [LAGS[1], LAGS[0]].map(|lag| DT / (DT + lag));
        let acceleration = self.acceleration + slow * (command.acceleration - self.acceleration);
        let most = car.max_steering;
        let steering = (self.steering + quick * DT * command.rate).clamp(-most, most);
        Self {
            axle: [self.axle[0] + DT * self.speed * cos, self.axle[1] + DT * self.speed * sin],
            heading: self.heading + DT * self.speed * self.steering.tan() / car.wheelbase,
            speed: (self.speed + DT * acceleration).max(0.0),
            acceleration,
            steering,
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    const WHEELBASE: f64 = 3.089;

    #[test]
    fn steering_rates_are_those_of_the_published_tracker() {
        let rate =
            |state, speed, curvature| steering_rate(WHEELBASE, state, [speed, 0.0], &[curvature; LOOK_AHEAD]);
        assert_relative_eq!(rate([0.5, 0.0, 0.0], 10.0, 0.0), -0.052056, epsilon = 1e-6);
        assert_relative_eq!(rate([0.0, 0.05, 0.0], 10.0, 0.0), -0.071577, epsilon = 1e-6);
        assert_relative_eq!(rate([0.0, 0.0, 0.0], 10.0, 0.01), 0.085892, epsilon = 1e-6);
        assert_relative_eq!(rate([0.5, 0.0, 0.0], 5.0, 0.0), -0.066990, epsilon = 1e-6);
    }

    #[test]
    fn a_slower_reference_is_approached_with_the_published_lag() {
        let car = Bicycle { wheelbase: WHEELBASE, max_steering: 1.0 };
        let reference = [Reference { position: [0.0; 2], heading: 0.0, speed: 7.0, curvature: 0.0 }];
        let mut state =
            Driven { axle: [0.0; 2], heading: 0.0, speed: 10.0, acceleration: 0.0, steering: 0.0 };
        for (command, acceleration, speed) in [(-2.7273, -0.9091, 9.9091), (-2.6446, -1.4876, 9.7603)] {
            let found = track(&car, &state, &reference, 0);
            state = state.after(&car, &found);
            assert_relative_eq!(found.acceleration, command, epsilon = 1e-4);
            assert_relative_eq!(state.acceleration, acceleration, epsilon = 1e-4);
            assert_relative_eq!(state.speed, speed, epsilon = 1e-4);
        }
    }

    #[test]
    fn a_car_beside_its_path_comes_back_to_it_and_stays() {
        let car = Bicycle { wheelbase: WHEELBASE, max_steering: 1.0 };
        let along =
            |k: usize| Reference { position: [k as f64, 0.0], heading: 0.0, speed: 10.0, curvature: 0.0 };
        let reference: Vec<Reference> = (0..=80).map(along).collect();
        let mut state =
            Driven { axle: [0.0, 1.0], heading: 0.0, speed: 10.0, acceleration: 0.0, steering: 0.0 };
        for step in 0..80 {
            state = state.after(&car, &track(&car, &state, &reference, step));
        }
        assert!(state.axle[1].abs() < 0.05 && state.heading.abs() < 0.01, "{state:?}");
        assert_relative_eq!(state.axle[0], 80.0, epsilon = 0.3);
    }
}
