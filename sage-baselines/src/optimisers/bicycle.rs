//! The kinematic bicycle of KING, and the gradient of its poses with respect to its controls.
//!
//! Controls are unbounded: `a = A(tanh u₀)` with at most 5 m/s² ahead and 8 m/s² of braking, `δ = 0.6 tanh u₁` rad. A step
//! is explicit: position and heading move with the old speed, which then becomes `softplus(v + a dt)` and stays above 0.

use sage_core::{
    geometry::Point,
    motion::{DT, Pose, State},
    objective::PoseGradient,
};

/// Largest acceleration and deceleration, m/s².
pub(crate) const ACCELERATION: f64 = 5.0;
pub(crate) const DECELERATION: f64 = 8.0;
/// Largest steering angle, rad.
pub(crate) const STEERING: f64 = 0.6;
/// Distance of the rear axle from the centre by the length of the car; the front axle has the same.
const REAR: f64 = 0.3;
/// Sharpness of the softplus that keeps the speed above 0, s/m.
const SHARPNESS: f64 = 7.0;
/// Speed of a car that stands, m/s.
const LEAST_SPEED: f64 = 1e-3;

/// A car as a bicycle with its axles at the same distance from the centre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bicycle {
    /// Distance of the axles from the centre, metres.
    pub(crate) rear: f64,
}

/// A rolled-out motion with what its gradient needs.
pub(crate) struct Motion {
    /// Poses at the steps 1 to T.
    pub(crate) poses: Vec<Pose>,
    steps: Vec<Step>,
}

/// What a step depends on.
#[derive(Clone, Copy)]
struct Step {
    speed: f64,
    /// Sine and cosine of the course, the heading plus the slip.
    course: [f64; 2],
    /// Sine and cosine of the slip.
    slip: [f64; 2],
    /// Derivatives of the slip by the second control, of the acceleration by the first one, and of the next speed by the
    /// speed that the acceleration leads to.
    slip_by_control: f64,
    acceleration_by_control: f64,
    speed_by_sum: f64,
}

impl Bicycle {
    pub(crate) fn of_length(length: f64) -> Self {
        Self { rear: REAR * length }
    }

    /// Poses under controls, from a state.
    pub(crate) fn motion(&self, start: &State, controls: &[[f64; 2]]) -> Motion {
        let mut state = *start;
        let (mut poses, mut steps) = (Vec::with_capacity(controls.len()), Vec::with_capacity(controls.len()));
        for [throttle, steer] in controls {
            let (t, s) = (throttle.tanh(), steer.tanh());
            let strength = if t > 0.0 { ACCELERATION } else { DECELERATION };
            let tangent = (STEERING * s).tan();
            // Both axles are equally far from the centre.
            let slip = (0.5 * tangent).atan();
            let (slip_sin, slip_cos) = slip.sin_cos();
            let (sin, cos) = (state.heading + slip).sin_cos();
            let sum = state.speed + DT * strength * t;
            let step = Step {
                speed: state.speed,
                course: [sin, cos],
                slip: [slip_sin, slip_cos],
                slip_by_control: 0.5 * (1.0 + tangent * tangent) / (1.0 + 0.25 * tangent * tangent)
                    * STEERING
                    * (1.0 - s * s),
                acceleration_by_control: strength * (1.0 - t * t),
                speed_by_sum: 1.0 / (1.0 + (-SHARPNESS * sum).exp()),
            };
            let [x, y] = state.position;
            let way = DT * state.speed;
            state = State {
                position: [x + way * cos, y + way * sin],
                heading: state.heading + way / self.rear * slip_sin,
                speed: softplus(sum),
            };
            poses.push(state.pose());
            steps.push(step);
        }
        Motion { poses, steps }
    }

    /// Gradient with respect to the controls, from that with respect to the poses.
    pub(crate) fn gradient(&self, motion: &Motion, by_pose: &PoseGradient) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; motion.steps.len()];
        // With respect to the state after the step.
        let (mut position, mut heading, mut speed): (Point, f64, f64) = ([0.0; 2], 0.0, 0.0);
        for (k, step) in motion.steps.iter().enumerate().rev() {
            position = [0, 1].map(|i| position[i] + by_pose.position[k][i]);
            heading += by_pose.heading[k];
            let ([sin, cos], [slip_sin, slip_cos]) = (step.course, step.slip);
            let way = DT * step.speed;
            let by_course = way * (position[1] * cos - position[0] * sin);
            let by_slip = by_course + heading * way / self.rear * slip_cos;
            let by_sum = speed * step.speed_by_sum;
            out[k] = [by_sum * DT * step.acceleration_by_control, by_slip * step.slip_by_control];
            speed = DT * (position[0] * cos + position[1] * sin + heading * slip_sin / self.rear) + by_sum;
            heading += by_course;
        }
        out
    }
}

/// `ln(1 + e^(7x)) / 7`.
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-(SHARPNESS * x).abs()).exp().ln_1p() / SHARPNESS
}

/// The speed that [`softplus`] turns into a given one, m/s; far below 0 for a standing car.
pub(crate) fn inverse_softplus(speed: f64) -> f64 {
    let x = SHARPNESS * speed.max(LEAST_SPEED);
    (x + (-(-x).exp()).ln_1p()) / SHARPNESS
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use sage_core::seed::Rng;

    use super::*;

    const START: State = State { position: [0.0; 2], heading: 0.3, speed: 5.0 };

    #[test]
    fn steps_are_those_of_the_reference() {
        let bicycle = Bicycle::of_length(4.8);
        for (control, [x, y, heading, speed]) in [
            ([0.5, 0.2], [0.468050329, 0.175866114, 0.320620129, 5.231058579]),
            ([-0.5, -0.2], [0.485600083, 0.119132528, 0.279379871, 4.630306274]),
        ] {
            let motion = bicycle.motion(&START, &[control, [0.0; 2]]);
            let pose = motion.poses[0];
            assert_relative_eq!(pose.position[0], x, epsilon = 1e-9);
            assert_relative_eq!(pose.position[1], y, epsilon = 1e-9);
            assert_relative_eq!(pose.heading, heading, epsilon = 1e-9);
            assert_relative_eq!(motion.steps[1].speed, speed, epsilon = 1e-9);
        }
    }

    #[test]
    fn the_inverse_of_the_softplus_is_one() {
        for speed in [0.002, 0.1, 1.0, 20.0] {
            assert_relative_eq!(softplus(inverse_softplus(speed)), speed, max_relative = 1e-9);
        }
        assert!(softplus(inverse_softplus(0.0)) < 0.002);
    }

    #[test]
    fn the_gradient_is_that_of_differences() {
        let bicycle = Bicycle::of_length(4.3);
        let mut rng = Rng::new(3, "bicycle", "gradient");
        let mut number = |r: f64| rng.uniform(-r, r);
        let controls: Vec<[f64; 2]> = (0..40).map(|_| [number(1.0), number(1.0)]).collect();
        let mut weights = PoseGradient::zeros(40);
        for k in 0..40 {
            weights.position[k] = [number(1.0), number(1.0)];
            weights.heading[k] = number(3.0);
        }
        let value = |controls: &[[f64; 2]]| -> f64 {
            let poses = bicycle.motion(&START, controls).poses;
            (0..40)
                .map(|k| {
                    let ([x, y], [a, b]) = (poses[k].position, weights.position[k]);
                    a * x + b * y + weights.heading[k] * poses[k].heading
                })
                .sum()
        };
        let found = bicycle.gradient(&bicycle.motion(&START, &controls), &weights);
        for k in 0..40 {
            for i in 0..2 {
                let at = |by: f64| {
                    let mut controls = controls.clone();
                    controls[k][i] += by;
                    value(&controls)
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert_relative_eq!(found[k][i], slope, epsilon = 1e-6, max_relative = 1e-6);
            }
        }
    }
}
