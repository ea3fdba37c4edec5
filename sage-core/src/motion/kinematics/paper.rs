//! Kinematics as the paper defines them: backward differences, heading held while standing.
//!
//! Step t = 1…T starts at step t − 1, step 1 at the pose at *now*. A step slower than [`MOVING`] keeps the
//! heading of the previous step. Steps before the first moving step take the heading of that step. A car
//! that never moves keeps its logged heading. Yaw rate and acceleration of step 1 are 0. Below 0.5 m/s the
//! jitter of recorded tracks dominates the direction of motion.

use super::Profile;
use crate::{
    geometry::{dot, norm, sub, wrap_angle},
    motion::{DT, Pose},
};

/// Speed from which the displacement of a step defines the heading, m/s.
pub const MOVING: f64 = 0.5;

/// Profile of `points` with the start pose `start`, of a car that does not drive backwards.
pub fn profile(points: &[[f64; 2]], start: &Pose) -> Profile {
    profile_from(points, start, false)
}

/// As [`profile`]; a car that drives backwards at the start keeps its direction of travel opposite to its heading until it
/// first moves forwards, or turns to the side of its front.
pub fn profile_from(points: &[[f64; 2]], start: &Pose, mut reverses: bool) -> Profile {
    let n = points.len();
    let mut p = Profile {
        speed: Vec::with_capacity(n),
        heading: Vec::with_capacity(n),
        axis: Vec::with_capacity(n),
        yaw_rate: Vec::with_capacity(n),
        acceleration: Vec::with_capacity(n),
        ..Profile::default()
    };
    let (sin, cos) = start.heading.sin_cos();
    let (mut heading, mut axis) = (start.heading, [cos, sin]);
    let mut previous = start.position;
    let mut first_moving = None;
    for (step, &point) in points.iter().enumerate() {
        let displacement = sub(point, previous);
        let length = norm(displacement);
        let speed = length / DT;
        if speed >= MOVING {
            let ahead = [displacement[0] / length, displacement[1] / length];
            reverses &= dot(ahead, axis) < 0.0;
            axis = if reverses { ahead.map(|x| -x) } else { ahead };
            heading = if reverses { axis[1].atan2(axis[0]) } else { displacement[1].atan2(displacement[0]) };
            first_moving.get_or_insert(step);
        }
        p.speed.push(speed);
        p.heading.push(heading);
        p.axis.push(axis);
        previous = point;
    }
    let standing = first_moving.unwrap_or(0);
    for step in 0..standing {
        p.heading[step] = p.heading[standing];
        p.axis[step] = p.axis[standing];
    }
    for step in 0..n {
        let (turn, gain) = if step == 0 {
            (0.0, 0.0)
        } else {
            let turn = p.heading[step] - p.heading[step - 1];
            (wrap_angle(turn), p.speed[step] - p.speed[step - 1])
        };
        p.total_turn += turn;
        p.yaw_rate.push(turn / DT);
        p.acceleration.push(gain / DT);
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_circle_turns_at_speed_over_radius() {
        // 10 m/s on a radius of 20 m; chords of 1 m turn by 2 asin(1 / 40) a step.
        let turn = 2.0 * (1.0f64 / 40.0).asin();
        let at = |k: f64| [20.0 * (k * turn).sin(), 20.0 - 20.0 * (k * turn).cos()];
        let points: Vec<_> = (1..=80).map(|k| at(k as f64)).collect();
        let p = profile(&points, &Pose { position: at(0.0), heading: 0.0 });
        assert_relative_eq!(p.speed[50], 10.0, max_relative = 1e-12);
        assert_relative_eq!(p.yaw_rate[50], turn / DT, max_relative = 1e-9);
        assert_relative_eq!(p.total_turn, 79.0 * turn, max_relative = 1e-9);
        assert_eq!((p.yaw_rate[0], p.acceleration[0]), (0.0, 0.0));
    }

    #[test]
    fn standing_car_keeps_its_logged_heading_and_has_no_yaw_rate() {
        let p = profile(&[[3.0, 4.0]; 80], &Pose { position: [3.0, 4.0], heading: 2.5 });
        assert!(p.heading.iter().all(|&h| h == 2.5) && p.yaw_rate.iter().all(|&w| w == 0.0));
    }

    #[test]
    fn steps_before_the_first_moving_one_take_its_heading() {
        let points: Vec<_> =
            (0..80).map(|k| [0.0, if k < 30 { 0.0 } else { -0.2 * (k - 29) as f64 }]).collect();
        let p = profile(&points, &Pose { position: [0.0, 0.0], heading: 1.0 });
        assert!(p.heading.iter().all(|&h| (h + std::f64::consts::FRAC_PI_2).abs() < 1e-12));
        assert_relative_eq!(p.axis[0][1], -1.0);
    }

    #[test]
    fn a_stop_within_a_trajectory_holds_the_heading_through_jitter() {
        let mut x = 0.0;
        let points: Vec<_> = (0..80)
            .map(|k| {
                x += if (30..50).contains(&k) { 0.0 } else { 0.5 };
                let jitter = if (30..50).contains(&k) { 0.01 * f64::from(k % 2) } else { 0.0 };
                [x, jitter]
            })
            .collect();
        let p = profile(&points, &Pose { position: [-0.5, 0.0], heading: 0.0 });
        assert!(p.yaw_rate.iter().all(|w| w.abs() < 0.5), "{:?}", p.yaw_rate);
    }
}
