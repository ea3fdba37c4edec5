//! What a trajectory of the adversary is scored by.

use super::{Candidate, Context, EgoPath, Encounter};

/// A candidate against one path of the ego: all that a reward may look at.
pub struct Situation<'a> {
    /// The adversary's trajectory with its profile and boxes.
    pub candidate: &'a Candidate,
    /// The ego's path.
    pub ego: &'a EgoPath,
    /// How the two meet, computed once for all rewards.
    pub encounter: Encounter,
    /// Map, other road users, sizes, convention.
    pub ctx: &'a Context,
}

impl<'a> Situation<'a> {
    /// A candidate against an ego path.
    pub fn new(candidate: &'a Candidate, ego: &'a EgoPath, ctx: &'a Context) -> Self {
        Self { candidate, ego, encounter: Encounter::of(candidate, ego), ctx }
    }
}

/// Scores a trajectory of the adversary. Larger means more of what the name says, penalties too: an
/// objective gives the sign.
///
/// Implementations are pure: the same situation gives the same bits.
pub trait Reward: Send + Sync {
    /// Value for one candidate and ego path, in the unit that the implementation states, finite; `None`
    /// where it cannot be measured.
    fn score(&self, situation: &Situation) -> Option<f64>;

    /// Whether the ego's path matters. If not, it is asked once, whatever the number of ego paths.
    fn depends_on_ego(&self) -> bool {
        true
    }

    /// Whether it needs [`Candidate::nll`]: who proposes computes that only where it is asked for.
    fn needs_prior(&self) -> bool {
        false
    }

    /// Least and greatest value of a reward that is slow to compute: a search over thousands of candidates
    /// asks it only of those that can still win. `None` for all others.
    fn slow_range(&self) -> Option<[f64; 2]> {
        None
    }
}
