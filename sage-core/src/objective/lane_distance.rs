//! Lane distance as a reward, metres: how far from the lanes the adversary drives.

use serde::{Deserialize, Serialize};

use super::{
    Phase, Reward, Situation,
    naturalness::{FARTHEST, lane_distance_at},
};
use crate::registry::Entry;

/// Steps between two measured ones: cheap enough for a selection among many candidates.
pub(super) const COARSE: usize = 4;

/// Mean distance to the nearest lane in the direction of motion over every fourth step of a part of the
/// trajectory, metres, at most 20; `None` if the part has no such step.
pub fn coarse_lane_distance(situation: &Situation, phase: Phase) -> Option<f64> {
    let Situation { candidate, ctx, .. } = situation;
    let (points, axes) = (candidate.trajectory().points(), &candidate.profile().axis);
    let steps = phase.steps(&situation.encounter).filter(|step| step % COARSE == 0);
    let (sum, count) = steps.fold((0.0, 0), |(sum, count), step| {
        (sum + lane_distance_at(ctx, points[step - 1], axes[step - 1]), count + 1)
    });
    (count > 0).then(|| sum / f64::from(count))
}

/// Lane distance as a reward.
#[derive(Clone, Copy, Debug, Default)]
pub struct LaneDistance(LaneDistanceOptions);

/// Options of [`LaneDistance`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LaneDistanceOptions {
    /// `whole`, `before` the first contact, or `after` it.
    pub phase: Phase,
}

impl Entry<dyn Reward> for LaneDistance {
    const NAME: &'static str = "lane-distance";
    const SUMMARY: &'static str =
        "mean distance to the nearest lane in the direction of motion, metres, at most 20";
    const SOURCE: &'static str = "this project";
    type Options = LaneDistanceOptions;

    fn build(options: LaneDistanceOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self(options)))
    }
}

impl Reward for LaneDistance {
    fn score(&self, situation: &Situation) -> Option<f64> {
        coarse_lane_distance(situation, self.0.phase)
    }

    fn depends_on_ego(&self) -> bool {
        self.0.phase != Phase::Whole
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([0.0, FARTHEST])
    }
}
