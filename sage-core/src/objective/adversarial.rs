//! Adversarial reward: early contact with the ego, else closeness; see [`Encounter::reward`].

use serde::{Deserialize, Serialize};

use super::{Convention, Encounter, Reward, Situation};
use crate::{
    geometry::{OrientedBox, Point},
    motion::kinematics::release,
    registry::Entry,
};

/// The published reward of two trajectories of any lengths, with headings from the positions alone. Returns
/// the reward and whether they touch; 0 and `false` below two common points.
pub fn release_reward(adversary: &[Point], size: [f64; 2], ego: &[Point], ego_size: [f64; 2]) -> (f64, bool) {
    let n = adversary.len().min(ego.len());
    if n < 2 {
        return (0.0, false);
    }
    let boxes = |points: &[Point], [length, width]: [f64; 2]| -> Vec<OrientedBox> {
        let headings = release::headings(points);
        points.iter().zip(headings).map(|(&p, h)| OrientedBox::new(p, h, length, width)).collect()
    };
    let ego = boxes(&ego[..n], ego_size);
    let encounter = Encounter::follow(&boxes(&adversary[..n], size), ego.iter().map(Some));
    (encounter.reward_within(n, Convention::Release), encounter.contact.is_some())
}

/// The paper's R_adv.
#[derive(Clone, Copy, Debug, Default)]
pub struct AdversarialReward(AdversarialOptions);

/// Options of [`AdversarialReward`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdversarialOptions {
    /// Overlap depth from which on a contact counts, metres; the paper's 0 counts every contact.
    pub min_depth: f64,
}

impl Entry<dyn Reward> for AdversarialReward {
    const NAME: &'static str = "adversarial";
    const SUMMARY: &'static str = "early contact with the ego, else closeness";
    const SOURCE: &'static str = "SAGE (ICLR 2026), adversarial reward";
    type Options = AdversarialOptions;

    fn build(options: AdversarialOptions) -> Result<Box<dyn Reward>, String> {
        if !(0.0..=10.0).contains(&options.min_depth) {
            return Err(format!("`min_depth` is {}; expected 0 to 10 metres", options.min_depth));
        }
        Ok(Box::new(Self(options)))
    }
}

impl Reward for AdversarialReward {
    fn score(&self, situation: &Situation) -> Option<f64> {
        let Situation { candidate, ego, encounter, ctx } = situation;
        Some(encounter.from_depth(candidate, ego, self.0.min_depth).reward(ctx.convention()))
    }
}
