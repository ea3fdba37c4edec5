//! Size and seed of an experiment.

use rayon::prelude::*;
use sage_core::seed::Rng;

use crate::Tally;

/// Size at which an experiment has the numbers of instances that it states.
pub(crate) const FULL: usize = 1000;

/// Size and seed of an experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// Seed of the instances.
    pub seed: u64,
    /// Instances for every 1000 that a check states: at 100 each experiment has a tenth of its size.
    pub instances: usize,
}

impl Default for Setup {
    fn default() -> Self {
        Self { seed: 0, instances: FULL }
    }
}

impl Setup {
    /// Number of instances for a stated number of them, at least 1.
    pub fn scaled(&self, stated: usize) -> usize {
        (stated * self.instances).div_ceil(FULL).max(1)
    }

    /// The same at its whole size or more: for experiments that show nothing with a few instances, and cost little.
    #[must_use]
    pub fn whole(self) -> Self {
        Self { instances: self.instances.max(FULL), ..self }
    }

    /// Whether the experiment has its whole size, where the slowest instances are included.
    pub fn is_full(&self) -> bool {
        self.instances >= FULL
    }

    /// Runs numbered instances on all threads and merges what they count, in their order.
    ///
    /// Each instance has random numbers of its own, which depend on the seed, the purpose and its number alone, so threads do
    /// not change the bits.
    pub fn each(
        &self,
        purpose: &str,
        stated: usize,
        one: impl Fn(usize, &mut Rng, &mut Tally) + Sync,
    ) -> Tally {
        let run = |instance: usize| {
            let mut rng = Rng::new(self.seed, purpose, &instance.to_string());
            let mut tally = Tally::instance();
            one(instance, &mut rng, &mut tally);
            tally
        };
        let tallies: Vec<Tally> = (0..self.scaled(stated)).into_par_iter().map(run).collect();
        tallies.into_iter().fold(Tally::default(), Tally::and)
    }
}
