//! Kinematic penalty on high acceleration, high lateral acceleration and high yaw rate.
//!
//! `P_kin = mean over steps of 5 sp(|a| − 7) + 5 sp(|v ω| − 6) + 5 sp(|ω| − 0.8)` with
//! `sp(x) = ln(1 + e^x)`. Its floor, for a straight drive at constant speed or a standing car, is
//! 1.8724. Source: the paper's realism section.

use super::{Reward, Situation};
use crate::{
    motion::kinematics::Profile,
    registry::{Entry, NoOptions},
};

/// Weight of each term.
const WEIGHT: f64 = 5.0;
/// Threshold of the longitudinal acceleration, m/s².
const ACCELERATION: f64 = 7.0;
/// Threshold of the lateral acceleration, m/s².
const LATERAL: f64 = 6.0;
/// Threshold of the yaw rate, rad/s.
const YAW_RATE: f64 = 0.8;
/// Shorter trajectories are not penalised (published code).
pub(super) const LEAST_POINTS: usize = 5;

/// `ln(1 + e^x)` without overflow.
#[inline]
pub(super) fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Whether a profile stays within the penalty's thresholds at every step.
pub fn is_within_limits(profile: &Profile) -> bool {
    let mut steps = profile.speed.iter().zip(&profile.acceleration).zip(&profile.yaw_rate);
    steps.all(|((speed, acceleration), yaw_rate)| {
        acceleration.abs() <= ACCELERATION
            && (speed * yaw_rate).abs() <= LATERAL
            && yaw_rate.abs() <= YAW_RATE
    })
}

/// P_kin of a profile; 0 below five points.
///
/// ```
/// use sage_core::{
///     motion::{Pose, kinematics::paper},
///     objective::{is_within_limits, kinematic_penalty},
/// };
///
/// let start = Pose::new(0.0, 0.0, 0.0);
/// let steady: Vec<[f64; 2]> = (1..=80).map(|step| [0.8 * f64::from(step), 0.0]).collect();
/// let steady = paper::profile(&steady, &start);
/// // Straight on at 8 m/s: the floor of the formula.
/// assert!((kinematic_penalty(&steady) - 1.8724).abs() < 1e-4 && is_within_limits(&steady));
///
/// // From 8 m/s to a standstill in one step of 0.1 s is a deceleration of 80 m/s².
/// let mut stops = vec![[32.0, 0.0]; 80];
/// (0..40).for_each(|step| stops[step] = [0.8 * (step + 1) as f64, 0.0]);
/// let stops = paper::profile(&stops, &start);
/// assert!(kinematic_penalty(&stops) > 6.0 && !is_within_limits(&stops));
/// ```
pub fn kinematic_penalty(profile: &Profile) -> f64 {
    let n = profile.speed.len();
    if n < LEAST_POINTS {
        return 0.0;
    }
    let mut sum = 0.0;
    for step in 0..n {
        let yaw_rate = profile.yaw_rate[step].abs();
        sum += softplus(profile.acceleration[step].abs() - ACCELERATION)
            + softplus(profile.speed[step] * yaw_rate - LATERAL)
            + softplus(yaw_rate - YAW_RATE);
    }
    WEIGHT * sum / n as f64
}

/// The paper's P_kin.
pub struct KinematicPenalty;

impl Entry<dyn Reward> for KinematicPenalty {
    const NAME: &'static str = "kinematic";
    const SUMMARY: &'static str = "penalty on high acceleration, lateral acceleration and yaw rate";
    const SOURCE: &'static str = "SAGE (ICLR 2026), kinematic penalty";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for KinematicPenalty {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(kinematic_penalty(situation.candidate.profile()))
    }

    fn depends_on_ego(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn softplus_is_stable_at_both_ends() {
        assert_eq!(softplus(1000.0), 1000.0);
        assert_eq!(softplus(-1000.0), 0.0);
        assert_relative_eq!(softplus(0.0), 2f64.ln());
        assert_relative_eq!(5.0 * softplus(-0.8), 1.855503330, max_relative = 1e-9);
    }
}
