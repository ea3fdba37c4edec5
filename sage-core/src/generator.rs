//! What every generator of adversarial scenes offers.
//!
//! Most are a [`Proposer`], which sees an [`Observation`] and nothing after it, and a selection among its
//! proposals that may know the ego's path. Optimisers and rules implement [`Generator`] directly.

mod attack;
mod observation;
mod operating_point;

use std::fmt;

use crate::{Error, objective::Context};

pub use attack::{Attack, Note, Proposal};
pub use observation::Observation;
pub use operating_point::{Mixture, OperatingPoint, corner};

/// What a generator knows beyond what can be seen *now*.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Knowledge {
    /// The path that the ego will take.
    pub ego_future: bool,
    /// What was recorded of the others after *now*.
    pub others_future: bool,
    /// What was recorded of the adversary itself after *now*.
    pub own_future: bool,
}

impl Knowledge {
    /// Nothing but what can be seen *now*.
    pub const NOW: Self = Self { ego_future: false, others_future: false, own_future: false };

    /// What either knows.
    pub fn and(self, other: Self) -> Self {
        Self {
            ego_future: self.ego_future || other.ego_future,
            others_future: self.others_future || other.others_future,
            own_future: self.own_future || other.own_future,
        }
    }
}

impl fmt::Display for Knowledge {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let known = [
            (self.ego_future, "ego's path"),
            (self.others_future, "others' log"),
            (self.own_future, "adversary's log"),
        ];
        let known: Vec<&str> = known.into_iter().filter(|(known, _)| *known).map(|(_, what)| what).collect();
        f.write_str(if known.is_empty() { "now alone" } else { "" })?;
        f.write_str(&known.join(", "))
    }
}

/// Proposes trajectories for the adversary from what can be seen *now*.
///
/// Implementations are pure: the same observation, mixture and seed give the same bits on any thread.
pub trait Proposer: Send + Sync {
    /// Does once a scene whatever the mixture does not change.
    ///
    /// *Errors*: [`Error::Scene`] for a scene that it cannot work with.
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedScene>, Error>;
}

/// A scene that a proposer has prepared.
pub trait PreparedScene: Send + Sync {
    /// Proposals at a mixture of experts, at least one, the likeliest first where they have probabilities.
    ///
    /// *Errors*: [`Error::Scene`] for a network that gives no numbers.
    fn propose(&self, at: &Mixture, seed: u64) -> Result<Vec<Proposal>, Error>;
}

/// Makes the adversary of a scene do something else than it did.
///
/// Implementations are pure: the same context, operating points and seed give the same bits on any thread,
/// and an operating point's attack does not depend on those beside it.
pub trait Generator: Send + Sync {
    /// An attack for each operating point, in their order.
    ///
    /// *Errors*: [`Error::Scene`] for a scene that it cannot work with.
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error>;
}
