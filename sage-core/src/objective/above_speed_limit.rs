//! Speed above the limit of the lane, m/s.

use serde::{Deserialize, Serialize};

use super::{Phase, Reward, Situation, lane_distance::COARSE, naturalness::speed_limit_at};
use crate::registry::Entry;

/// Most that a step counts, m/s.
const MOST: f64 = 50.0;

/// Mean excess over the speed limit of the nearest lane in the direction of motion, over every fourth step of a
/// part of the trajectory, m/s, at most 50 a step; `None` if no such step has a lane with a limit.
pub fn above_speed_limit(situation: &Situation, phase: Phase) -> Option<f64> {
    let Situation { candidate, ctx, .. } = situation;
    let (points, profile) = (candidate.trajectory().points(), candidate.profile());
    let steps = phase.steps(&situation.encounter).filter(|step| step % COARSE == 0);
    let (sum, count) = steps.fold((0.0, 0), |(sum, count), step| {
        match speed_limit_at(ctx, points[step - 1], profile.axis[step - 1]) {
            Some(limit) => (sum + (profile.speed[step - 1] - limit).clamp(0.0, MOST), count + 1),
            None => (sum, count),
        }
    });
    (count > 0).then(|| sum / f64::from(count))
}

/// Speed above the limit as a reward.
#[derive(Clone, Copy, Debug, Default)]
pub struct AboveSpeedLimit(AboveSpeedLimitOptions);

/// Options of [`AboveSpeedLimit`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AboveSpeedLimitOptions {
    /// `whole`, `before` the first contact, or `after` it.
    pub phase: Phase,
}

impl Entry<dyn Reward> for AboveSpeedLimit {
    const NAME: &'static str = "above-speed-limit";
    const SUMMARY: &'static str = "mean speed above the limit of the lane, m/s";
    const SOURCE: &'static str = "this project";
    type Options = AboveSpeedLimitOptions;

    fn build(options: AboveSpeedLimitOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self(options)))
    }
}

impl Reward for AboveSpeedLimit {
    fn score(&self, situation: &Situation) -> Option<f64> {
        above_speed_limit(situation, self.0.phase)
    }

    fn depends_on_ego(&self) -> bool {
        self.0.phase != Phase::Whole
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([0.0, MOST])
    }
}
