//! Behavioural penalty on reversing direction and on rotating without moving.
//!
//! `P_beh = 5 sp(|Δψ| − π) + 3 mean over steps of |ω| / (v + 0.01)` with the total rotation Δψ. Its floor
//! is 0.2115. Source: the paper's realism section. The paper does not specify ε; 0.01 is the value of the
//! published code.

use super::{
    Reward, Situation,
    kinematic::{LEAST_POINTS, softplus},
};
use crate::{
    motion::kinematics::Profile,
    registry::{Entry, NoOptions},
};

/// Weight of the total rotation.
const TURN_WEIGHT: f64 = 5.0;
/// Weight of rotation without motion.
const SPIN_WEIGHT: f64 = 3.0;
/// Prevents a division by zero for a standing car, m/s.
const EPSILON: f64 = 0.01;

/// P_beh of a profile; 0 below five points.
pub fn behavior_penalty(profile: &Profile) -> f64 {
    let n = profile.speed.len();
    if n < LEAST_POINTS {
        return 0.0;
    }
    let spin: f64 = profile.yaw_rate.iter().zip(&profile.speed).map(|(w, v)| w.abs() / (v + EPSILON)).sum();
    TURN_WEIGHT * softplus(profile.total_turn.abs() - std::f64::consts::PI) + SPIN_WEIGHT * spin / n as f64
}

/// The paper's P_beh.
pub struct BehaviorPenalty;

impl Entry<dyn Reward> for BehaviorPenalty {
    const NAME: &'static str = "behavior";
    const SUMMARY: &'static str = "penalty on reversing direction and on rotating without moving";
    const SOURCE: &'static str = "SAGE (ICLR 2026), behavioural penalty";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for BehaviorPenalty {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(behavior_penalty(situation.candidate.profile()))
    }

    fn depends_on_ego(&self) -> bool {
        false
    }
}
