//! Time against the traffic, seconds: steps at which the adversary moves or looks against the nearest lane and no lane
//! leads its way.

use serde::{Deserialize, Serialize};

use super::{Phase, Reward, Situation, naturalness::AgainstTrafficTest};
use crate::{
    geometry::dot,
    motion::{DT, HORIZON},
    registry::Entry,
};

/// A count divided by it has no more digits than it needs; multiplied by [`DT`] it would.
const STEPS_PER_SECOND: f64 = 10.0;

/// Time against the traffic of a candidate over a part of it, seconds.
pub fn against_traffic(situation: &Situation, phase: Phase) -> f64 {
    let Situation { candidate, ctx, .. } = situation;
    let (points, profile) = (candidate.trajectory().points(), candidate.profile());
    let mut test = AgainstTrafficTest::new(ctx);
    let mut is_against = |&k: &usize| {
        let (p, axis, speed) = (points[k - 1], profile.axis[k - 1], profile.speed[k - 1]);
        // One that drives backwards goes against the traffic either by where it moves or by where it looks.
        let is_backwards = dot(candidate.velocity(k), axis) < 0.0;
        test.holds(p, axis, speed) || is_backwards && test.holds(p, axis.map(|x| -x), speed)
    };
    phase.steps(&situation.encounter).filter(&mut is_against).count() as f64 / STEPS_PER_SECOND
}

/// Time against the traffic as a reward.
#[derive(Clone, Copy, Debug, Default)]
pub struct AgainstTraffic(AgainstTrafficOptions);

/// Options of [`AgainstTraffic`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AgainstTrafficOptions {
    /// `whole`, `before` the first contact, or `after` it.
    pub phase: Phase,
}

impl Default for AgainstTrafficOptions {
    /// What leads to a contact matters more than what follows it.
    fn default() -> Self {
        Self { phase: Phase::Before }
    }
}

impl Entry<dyn Reward> for AgainstTraffic {
    const NAME: &'static str = "against-traffic";
    const SUMMARY: &'static str =
        "time more than 120 degrees off the nearest lane, no lane along within 2 m, before contact, seconds";
    const SOURCE: &'static str = "this project";
    type Options = AgainstTrafficOptions;

    fn build(options: AgainstTrafficOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self(options)))
    }
}

impl Reward for AgainstTraffic {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(against_traffic(situation, self.0.phase))
    }

    fn depends_on_ego(&self) -> bool {
        self.0.phase != Phase::Whole
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([0.0, HORIZON as f64 * DT])
    }
}
