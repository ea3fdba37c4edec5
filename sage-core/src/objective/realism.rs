//! Realism penalty `P_real = P_kin + P_beh`. Source: the paper's realism section.

use super::{Reward, Situation, behavior_penalty, kinematic_penalty};
use crate::{
    motion::kinematics::Profile,
    registry::{Entry, NoOptions},
};

/// P_real of a profile.
pub fn realism_penalty(profile: &Profile) -> f64 {
    kinematic_penalty(profile) + behavior_penalty(profile)
}

/// The paper's P_real.
pub struct RealismPenalty;

impl Entry<dyn Reward> for RealismPenalty {
    const NAME: &'static str = "realism";
    const SUMMARY: &'static str = "penalty on motion unlike a car's: kinematic + behavior";
    const SOURCE: &'static str = "SAGE (ICLR 2026), realism penalty";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for RealismPenalty {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(realism_penalty(situation.candidate.profile()))
    }

    fn depends_on_ego(&self) -> bool {
        false
    }
}
