//! What a finished seed leaves for reports.

use sage_learn::{Counters, Evaluation};

/// A trained seed.
pub(super) struct Trained {
    pub(super) seed: u64,
    pub(super) evaluations: Vec<Evaluation>,
    pub(super) losses: Vec<[f64; 3]>,
    pub(super) counters: Counters,
    pub(super) updates: u64,
}
