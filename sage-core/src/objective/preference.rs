//! Weighted preference composite `w_adv R_adv − w_real (P_kin + P_beh)`: an expert's taste.

use serde::{Deserialize, Serialize};

use super::{Candidate, Context, Encounter, Reward, behavior_penalty, kinematic_penalty};
use crate::registry::Entry;

/// Weights of [`Preference`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreferenceOptions {
    /// Weight of the adversarial reward, ≥ 0.
    pub w_adv: f64,
    /// Weight of the two penalties, ≥ 0.
    pub w_real: f64,
}

impl Default for PreferenceOptions {
    /// The adversarial expert's.
    fn default() -> Self {
        Self { w_adv: 0.9, w_real: 0.1 }
    }
}

/// The preference reward.
pub struct Preference(PreferenceOptions);

impl Entry<dyn Reward> for Preference {
    const NAME: &'static str = "preference";
    const SUMMARY: &'static str = "w_adv · adversarial − w_real · (kinematic + behavior)";
    const SOURCE: &'static str = "SAGE (ICLR 2026), preference reward";
    type Options = PreferenceOptions;

    fn build(options: PreferenceOptions) -> Result<Box<dyn Reward>, String> {
        for (key, weight) in [("w_adv", options.w_adv), ("w_real", options.w_real)] {
            if !(weight.is_finite() && weight >= 0.0) {
                return Err(format!("`{key}` is {weight}; expected a finite weight of at least 0"));
            }
        }
        Ok(Box::new(Self(options)))
    }
}

impl Reward for Preference {
    fn score(&self, candidate: &Candidate, ctx: &Context) -> f64 {
        let adversarial = Encounter::of(candidate, ctx).reward(ctx.convention());
        let realism = kinematic_penalty(candidate.profile()) + behavior_penalty(candidate.profile());
        self.0.w_adv * adversarial - self.0.w_real * realism
    }
}
