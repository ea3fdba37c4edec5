//! What makes a candidate trajectory of the adversary good, bad or impossible.
//!
//! Three measures of the paper: [`AdversarialReward`] (early contact with the ego, else closeness),
//! [`KinematicPenalty`] and [`BehaviorPenalty`] (driving unlike a car), one hard rule
//! ([`MapFeasibility`]: no road edge touched, nobody else hit), and a stricter rule
//! ([`StrictFeasibility`]). Each is a file and usable alone; a [`Context`] holds what they need of
//! a scene and is built once for all candidates.

mod adversarial;
mod behavior;
mod candidate;
mod collision_kind;
mod context;
mod convention;
pub mod criticality;
mod distribution;
mod kinematic;
mod map_feasibility;
mod naturalness;
mod others;
mod preference;
mod scores;
mod sizes;
mod strict;

pub use adversarial::{AdversarialReward, Encounter, release_reward};
pub use behavior::{BehaviorPenalty, behavior_penalty};
pub use candidate::Candidate;
pub use collision_kind::CollisionKind;
pub use context::{Context, ContextOptions, EgoPath};
pub use convention::Convention;
pub use criticality::{Criticality, SideHit};
pub use distribution::{DistributionDistances, LoggedProfile};
pub use kinematic::{KinematicPenalty, kinematic_penalty};
pub use map_feasibility::{AgentContact, EdgeContact, MapFeasibility, Violations, touches_boundary};
pub use naturalness::{Naturalness, coarse_lane_distance};
pub use others::OtherAgent;
pub use preference::{Preference, PreferenceOptions};
pub use scores::{Scorer, Scores};
pub use sizes::Sizes;
pub use strict::{StrictFeasibility, StrictOptions};

use crate::{Error, geometry::Point, registry::Registry};

/// Scores a candidate trajectory of the adversary. Larger is better for the one who asks;
/// penalties are rewards of their own and enter composites with a minus sign.
///
/// Implementations are pure: the same candidate and context give the same bits.
pub trait Reward: Send + Sync {
    /// Value of one candidate. Finite for every candidate that a context accepts.
    fn score(&self, candidate: &Candidate, ctx: &Context) -> f64;

    /// Values of many candidates; override it when work can be shared between them.
    fn score_all(&self, candidates: &[Candidate], ctx: &Context) -> Vec<f64> {
        candidates.iter().map(|c| self.score(c, ctx)).collect()
    }
}

/// Decides whether a candidate could be driven in its scene.
pub trait Feasibility: Send + Sync {
    /// All rules that a candidate breaks, the first step of each; none if it is feasible.
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Reason>;

    /// Whether no rule is broken.
    fn is_feasible(&self, candidate: &Candidate, ctx: &Context) -> bool {
        self.violations(candidate, ctx).is_empty()
    }
}

/// One broken rule: what, when and where.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Reason {
    /// The rule.
    pub rule: Rule,
    /// Step at which it is first broken, 1 to 80.
    pub step: usize,
    /// Where the adversary is then, metres.
    pub place: Point,
    /// Id of the map feature or track that was touched.
    pub with: String,
}

/// Rules that a candidate can break.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// The box touches a road boundary.
    RoadEdge,
    /// The box touches a median.
    Median,
    /// The box touches another road user than the ego.
    Agent,
    /// The centre is beyond the road's edge.
    OffRoad,
}

impl Rule {
    /// A few words for tables.
    pub fn words(self) -> &'static str {
        match self {
            Self::RoadEdge => "road edge",
            Self::Median => "median",
            Self::Agent => "agent",
            Self::OffRoad => "off road",
        }
    }
}

/// The rewards this crate ships. Add a line here to make a new one known everywhere.
///
/// *Errors*: [`Error::Duplicate`] if two of them bear one name.
pub fn rewards() -> Result<Registry<dyn Reward>, Error> {
    Registry::new("reward")
        .with::<AdversarialReward>()?
        .with::<KinematicPenalty>()?
        .with::<BehaviorPenalty>()?
        .with::<Preference>()?
        .with::<criticality::ImpactSpeed>()?
        .with::<criticality::RequiredDeceleration>()
}

/// The feasibility rules this crate ships.
///
/// *Errors*: [`Error::Duplicate`] if two of them bear one name.
pub fn feasibilities() -> Result<Registry<dyn Feasibility>, Error> {
    Registry::new("feasibility").with::<MapFeasibility>()?.with::<StrictFeasibility>()
}
