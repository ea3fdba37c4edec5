//! The latest start of an evasive manoeuvre as a reward: how near it is to a target.

use sage_core::{
    objective::{Reward, Situation},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use super::{Avoidance, AvoidanceOptions};

/// Value of a trajectory that does not hit, or is not shown avoidable. Times that differ by more count no less.
const FARTHEST: f64 = -3.0;
/// Largest target, seconds.
const LONGEST: f64 = 8.0;

/// `−|time − target|` of the latest start, seconds before the contact, at least −3; −3 without an avoidable contact. The ego's first path counts.
#[derive(Clone, Copy, Debug, Default)]
pub struct LatestStart(LatestStartOptions);

/// Options of [`LatestStart`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LatestStartOptions {
    /// Latest start that is wanted, seconds before the contact.
    pub target: f64,
    /// The search.
    pub search: AvoidanceOptions,
}

impl Default for LatestStartOptions {
    fn default() -> Self {
        Self { target: 1.5, search: AvoidanceOptions::default() }
    }
}

impl Entry<dyn Reward> for LatestStart {
    const NAME: &'static str = "latest-start";
    const SUMMARY: &'static str =
        "minus the distance of the latest start of an evasive manoeuvre from a target, seconds; slow";
    const SOURCE: &'static str = "this project";
    type Options = LatestStartOptions;

    fn build(options: LatestStartOptions) -> Result<Box<dyn Reward>, String> {
        if !(0.0..=LONGEST).contains(&options.target) {
            return Err(format!("`target` is {}; expected 0 to {LONGEST} seconds", options.target));
        }
        options.search.check().map_err(|error| format!("`search`: {error}"))?;
        Ok(Box::new(Self(options)))
    }
}

impl Reward for LatestStart {
    fn score(&self, situation: &Situation) -> Option<f64> {
        if situation.encounter.contact.is_none() {
            return Some(FARTHEST);
        }
        let avoidance = Avoidance::new(situation.ctx, self.0.search).ok()?;
        let found = avoidance.of(situation.candidate);
        found.avoidable?;
        let gap = |time: f64| -(time - self.0.target).abs();
        Some(found.latest_start.map_or(FARTHEST, gap).max(FARTHEST))
    }

    fn slow_range(&self) -> Option<[f64; 2]> {
        Some([FARTHEST, 0.0])
    }

    fn is_costly(&self) -> bool {
        true
    }
}
