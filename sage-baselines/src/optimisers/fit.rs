//! Controls of the bicycle that follow given positions: first by inverting the motion step by step, then by Adam.

use sage_core::{
    geometry::{Point, distance, norm, sub, wrap_angle},
    motion::{DT, Pose, State},
    objective::PoseGradient,
};

use super::{
    adam::Adam,
    bicycle::{ACCELERATION, Bicycle, DECELERATION, Motion, STEERING, inverse_softplus},
};

/// Steps and rate of the refinement, and the weight of changes of the controls.
const STEPS: usize = 200;
const RATE: f64 = 0.02;
const CHANGES: f64 = 0.01;
const BETAS: [f64; 2] = [0.9, 0.999];
/// Speed below which no steering is inferred, m/s.
const SLOW: f64 = 0.5;
/// Largest sine of the slip, and largest control by its limit, that are inferred.
const MOST_SLIP: f64 = 0.5;
const MOST_CONTROL: f64 = 0.95;

/// Controls that follow the poses of the steps 1 to T, from a state, with the mean distance to them, metres.
pub(crate) fn controls(bicycle: &Bicycle, start: &State, poses: &[Pose]) -> (Vec<[f64; 2]>, f64) {
    let mut controls = inverse(bicycle, start, poses);
    let mut adam = Adam::new(controls.len(), RATE, BETAS);
    let mut best = (f64::INFINITY, controls.clone());
    for step in 0..=STEPS {
        let motion = bicycle.motion(start, &controls);
        let loss = loss(&motion, poses, &controls);
        if loss < best.0 {
            best = (loss, controls.clone());
        }
        if step < STEPS {
            let gradient = gradient(bicycle, &motion, poses, &controls);
            adam.step(&mut controls, &gradient, -1.0);
        }
    }
    let motion = bicycle.motion(start, &best.1);
    let distances = motion.poses.iter().zip(poses).map(|(a, b)| distance(a.position, b.position));
    let error = distances.sum::<f64>() / poses.len().max(1) as f64;
    (best.1, error)
}

/// Mean squared distance to the poses, and squared changes of the controls.
fn loss(motion: &Motion, poses: &[Pose], controls: &[[f64; 2]]) -> f64 {
    let squared = motion.poses.iter().zip(poses).map(|(a, b)| distance(a.position, b.position).powi(2));
    let changes = controls.windows(2).map(|pair| norm(sub(pair[1], pair[0])).powi(2));
    squared.sum::<f64>() / poses.len() as f64 + CHANGES * changes.sum::<f64>()
}

fn gradient(bicycle: &Bicycle, motion: &Motion, poses: &[Pose], controls: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut by_pose = PoseGradient::zeros(poses.len());
    let scale = 2.0 / poses.len() as f64;
    for (k, (found, wanted)) in motion.poses.iter().zip(poses).enumerate() {
        by_pose.position[k] = sub(found.position, wanted.position).map(|x| scale * x);
    }
    let mut gradient = bicycle.gradient(motion, &by_pose);
    for k in 1..controls.len() {
        let change = sub(controls[k], controls[k - 1]).map(|x| 2.0 * CHANGES * x);
        for (i, by) in change.into_iter().enumerate() {
            gradient[k][i] += by;
            gradient[k - 1][i] -= by;
        }
    }
    gradient
}

/// Controls that give speeds and turns of the poses, as far as they are within the limits.
fn inverse(bicycle: &Bicycle, start: &State, poses: &[Pose]) -> Vec<[f64; 2]> {
    let positions: Vec<Point> =
        std::iter::once(start.position).chain(poses.iter().map(|pose| pose.position)).collect();
    let headings: Vec<f64> =
        std::iter::once(start.heading).chain(poses.iter().map(|pose| pose.heading)).collect();
    let last = positions.len() - 1;
    let speed = |k: usize| match k {
        0 => start.speed,
        k => {
            let (a, b) = (k - 1, (k + 1).min(last));
            distance(positions[a], positions[b]) / (DT * (b - a) as f64)
        }
    };
    let control = |k: usize| {
        let (v, next) = (speed(k), speed(k + 1));
        let acceleration = (inverse_softplus(next) - v) / DT;
        let strength = if acceleration > 0.0 { ACCELERATION } else { DECELERATION };
        let turn = wrap_angle(headings[k + 1] - headings[k]) / DT;
        let slip = (turn * bicycle.rear / v.max(SLOW)).clamp(-MOST_SLIP, MOST_SLIP).asin();
        let steering = if v < SLOW { 0.0 } else { (2.0 * slip.tan()).atan() };
        [acceleration / strength, steering / STEERING].map(|x| x.clamp(-MOST_CONTROL, MOST_CONTROL).atanh())
    };
    (0..last).map(control).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bicycles_own_motion_is_followed_to_centimetres() {
        let bicycle = Bicycle::of_length(4.8);
        let start = State { position: [3.0, -2.0], heading: 1.0, speed: 8.0 };
        let wave = |k: usize| [0.3 * (k as f64 / 9.0).sin(), 0.2 * (k as f64 / 15.0).cos()];
        let wanted: Vec<[f64; 2]> = (0..80).map(wave).collect();
        let poses = bicycle.motion(&start, &wanted).poses;
        let (_, error) = controls(&bicycle, &start, &poses);
        assert!(error < 0.02, "{error}");
    }

    #[test]
    fn a_standing_car_stays() {
        let bicycle = Bicycle::of_length(4.8);
        let start = State { position: [3.0, -2.0], heading: 1.0, speed: 0.0 };
        let (controls, error) = controls(&bicycle, &start, &[start.pose(); 80]);
        assert!(error < 0.05 && controls.iter().flatten().all(|u| u.is_finite()), "{error}");
    }
}
