//! An adversary that reacts: a policy that drives its car from a frame of its plan on.
//!
//! Most attacks are a plan that the adversary follows whatever the ego does. A learned adversary can instead see what
//! is around it. What it sees and does is given in numbers, so a generator needs no simulation: the simulation
//! (`sage-sim`) computes the observation and moves the car.

use std::{fmt, sync::Arc};

use crate::Error;

/// What drives the adversary from a frame of its plan on.
#[derive(Clone)]
pub struct Reaction {
    /// Frame at which the policy takes over: its first action is for the step from this frame to the next.
    pub from: usize,
    /// The policy.
    pub policy: Arc<dyn ReactivePolicy>,
    /// Seed of its random numbers.
    pub seed: u64,
}

/// A policy in the adversary's seat.
///
/// Implementations are pure: the same scene, seed and observations give the same actions.
pub trait ReactivePolicy: Send + Sync {
    /// A driver for one drive in a scene.
    fn start(&self, scene: &str, seed: u64) -> Box<dyn ReactiveDriver>;
}

/// A policy in the middle of a drive.
pub trait ReactiveDriver: Send + Sync {
    /// Steering (1 is full left) and throttle (−1 is full brake), each in [−1, 1], for the step that begins at a frame.
    /// `observation` holds the 101 numbers of a learning driver (`sage_sim::observation`), seen from the adversary's car.
    ///
    /// *Errors*: [`Error::Scene`] if its output is not finite.
    fn action(&mut self, frame: usize, observation: &[f32]) -> Result<[f64; 2], Error>;

    /// A copy in the same state.
    fn boxed_clone(&self) -> Box<dyn ReactiveDriver>;
}

impl fmt::Debug for Reaction {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("Reaction").field("from", &self.from).field("seed", &self.seed).finish_non_exhaustive()
    }
}

/// Reactions are equal if they begin at the same frame with the same seed, by the same policy.
impl PartialEq for Reaction {
    fn eq(&self, other: &Self) -> bool {
        (self.from, self.seed) == (other.from, other.seed) && Arc::ptr_eq(&self.policy, &other.policy)
    }
}
