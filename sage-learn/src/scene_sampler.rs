//! Which scene the next training episode is in.

mod prioritised;
mod uniform;

use sage_core::{Error, registry::Registry, seed::Rng};
use serde::{Deserialize, Serialize};

pub use prioritised::Prioritised;
pub use uniform::Uniform;

/// All scene samplers of this crate. Add a line here to make a new one known everywhere.
///
/// *Errors*: two have the same name.
pub fn scene_samplers() -> Result<Registry<dyn SceneSampler>, Error> {
    Registry::new("scene sampler").with::<Uniform>()?.with::<Prioritised>()
}

/// Draws the scene of each training episode.
///
/// Implementations are pure: what they need to remember is in the records, which every run keeps and resumes.
pub trait SceneSampler: Send + Sync {
    /// Index of the scene of episode number `episode`, among at least one.
    fn draw(&self, scenes: &[SceneRecord], episode: u64, rng: &mut Rng) -> usize;
}

/// Outcomes of a scene that are kept.
const KEPT: u8 = 8;

/// What happened in a scene so far.
///
/// ```
/// use sage_learn::SceneRecord;
///
/// let mut record = SceneRecord::default();
/// // Nothing is known: one of two.
/// assert_eq!(record.success(), 0.5);
/// record.count(0, Some(true));
/// record.count(1, Some(true));
/// // An attack that nobody could have avoided shows neither success nor failure.
/// record.count(2, None);
/// assert_eq!((record.visits, record.success()), (3, 0.75));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Episodes in it.
    pub visits: u64,
    /// Number of the last one.
    pub last: u64,
    /// The last outcomes, a bit each, the newest lowest.
    outcomes: u8,
    /// How many of the bits are outcomes.
    counted: u8,
}

impl SceneRecord {
    /// Counts an episode; `success` is `None` if it shows neither success nor failure.
    pub fn count(&mut self, episode: u64, success: Option<bool>) {
        self.visits += 1;
        self.last = episode;
        if let Some(success) = success {
            self.outcomes = (self.outcomes << 1) | u8::from(success);
            self.counted = (self.counted + 1).min(KEPT);
        }
    }

    /// Estimate of the success rate, (successes + 1)/(outcomes + 2), over the last eight outcomes.
    pub fn success(&self) -> f64 {
        let known = if self.counted >= KEPT { u8::MAX } else { (1 << self.counted) - 1 };
        f64::from((self.outcomes & known).count_ones() + 1) / f64::from(self.counted + 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_success_rate_forgets_old_outcomes() {
        let mut record = SceneRecord::default();
        assert_eq!(record.success(), 0.5);
        record.count(1, Some(false));
        record.count(2, None);
        assert_eq!((record.success(), record.visits, record.last), (1.0 / 3.0, 2, 2));
        for episode in 3..11 {
            record.count(episode, Some(true));
        }
        assert_eq!(record.success(), 0.9);
    }

    #[test]
    fn scenes_that_sometimes_fail_come_back_most() {
        let outcomes = |all: &[bool]| {
            let mut record = SceneRecord::default();
            all.iter().for_each(|success| record.count(1, Some(*success)));
            record
        };
        let scenes = [outcomes(&[true; 8]), outcomes(&[true, false, true, false]), outcomes(&[false; 8])];
        let registry = scene_samplers().expect("names differ");
        let shares = |name: &str| {
            let sampler = registry.build_default(name).expect("registered");
            let mut rng = Rng::new(1, "scenes", "test");
            let mut counts = [0.0_f64; 3];
            (0..30_000).for_each(|_| counts[sampler.draw(&scenes, 2, &mut rng)] += 1.0 / 30_000.0);
            counts
        };
        assert!(shares("uniform").iter().all(|share| (share - 1.0 / 3.0).abs() < 0.02));
        let [sure, open, hopeless] = shares("prioritised");
        assert!(open > 0.45 && sure > 0.15 && (sure - hopeless).abs() < 0.02, "{sure} {open} {hopeless}");
    }
}
