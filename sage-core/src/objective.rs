//! Rewards, feasibility rules and objectives for candidate trajectories of the adversary.
//!
//! A [`Reward`] measures a candidate. A [`Feasibility`] rule lists its violations. An [`Objective`] is a
//! weighted sum of rewards under one rule; fine-tuning, selection, search and tables use it. The paper's
//! parts are [`AdversarialReward`] (early contact with the ego, else closeness), [`RealismPenalty`] (motion
//! unlike a car's) and [`MapFeasibility`] (no road edge touched, no other agent hit). [`DrivableFeasibility`]
//! is stricter, and [`doubts`] lists why a person would not believe an attack. Each part has its own file and is usable alone. A [`Context`] holds the scene data that
//! they need and is built once for all candidates.

mod above_speed_limit;
mod adversarial;
pub mod against_lanes;
mod against_traffic;
mod behavior;
mod believable;
mod body;
mod candidate;
mod clearance;
mod collision_type;
mod composite;
mod contact_depth;
mod context;
mod convention;
pub mod criticality;
mod differentiable;
mod distribution;
mod drivable;
pub mod dynamics;
mod ego;
mod encounter;
mod evaluation;
mod goal_distance;
mod ground;
mod kinematic;
mod lane_distance;
mod map_feasibility;
mod naturalness;
mod nll;
mod others;
pub mod person;
mod phase;
mod realism;
mod reason;
mod reward;
mod scores;
mod sizes;
mod smooth_adversarial;
mod smooth_realism;
mod spec;
pub mod turning;
pub mod violation;

pub use above_speed_limit::{AboveSpeedLimit, above_speed_limit};
pub use adversarial::{AdversarialOptions, AdversarialReward, release_reward};
pub use against_traffic::{AgainstTraffic, against_traffic};
pub use behavior::{BehaviorPenalty, behavior_penalty};
pub use believable::{MAX_ACROSS, MAX_AGAINST, doubts, drives_believably, is_believable, is_believable_1};
pub use body::Body;
pub use candidate::Candidate;
pub use clearance::Clearance;
pub use collision_type::CollisionType;
pub use composite::Objective;
pub use contact_depth::{ContactDepth, contact_depth};
pub use context::{Context, ContextOptions};
pub use convention::Convention;
pub use criticality::{Criticality, SideHit};
pub use differentiable::{DifferentiableReward, PoseGradient, SmoothObjective};
pub use distribution::{DistributionDistances, LoggedProfile};
pub use drivable::{DrivableFeasibility, DrivableOptions};
pub use ego::{EgoPath, EgoPaths};
pub use encounter::Encounter;
pub use evaluation::Evaluation;
pub use goal_distance::{GoalDistance, GoalDistanceOptions};
pub use kinematic::{KinematicPenalty, is_within_limits, kinematic_penalty};
pub use lane_distance::{LaneDistance, coarse_lane_distance};
pub use map_feasibility::{AgentContact, EdgeContact, MapFeasibility, Violations, touches_edge};
pub use naturalness::Naturalness;
pub use nll::NegativeLogLikelihood;
pub use others::OtherAgent;
pub use person::{PersonContact, PersonFeasibility, PersonLimits, PersonMet};
pub use phase::Phase;
pub use realism::{RealismPenalty, realism_penalty};
pub use reason::{MIN_DEPTH, Reason, verdict};
pub use reward::{Reward, Situation};
pub use scores::{FurtherMeasures, Scorer, Scores};
pub use sizes::Sizes;
pub use smooth_adversarial::SmoothAdversarial;
pub use smooth_realism::SmoothRealism;
pub use spec::{MAX_WEIGHT, MOST_TERMS, ObjectiveSpec, PRESETS, PartSpec, TermSpec, Weight};
pub use violation::{Feasibility, Violation};

use crate::{Error, registry::Registry};

/// The rewards of this crate. Add a line here to register a new one.
///
/// *Errors*: [`Error::Duplicate`] if two rewards have the same name.
pub fn rewards() -> Result<Registry<dyn Reward>, Error> {
    Registry::new("reward")
        .with::<AdversarialReward>()?
        .with::<KinematicPenalty>()?
        .with::<BehaviorPenalty>()?
        .with::<RealismPenalty>()?
        .with::<LaneDistance>()?
        .with::<AgainstTraffic>()?
        .with::<AboveSpeedLimit>()?
        .with::<ContactDepth>()?
        .with::<GoalDistance>()?
        .with::<NegativeLogLikelihood>()?
        .with::<criticality::ImpactSpeed>()?
        .with::<criticality::RequiredDeceleration>()
}

/// The feasibility rules of this crate.
///
/// *Errors*: [`Error::Duplicate`] if two rules have the same name.
pub fn feasibilities() -> Result<Registry<dyn Feasibility>, Error> {
    Registry::new("feasibility")
        .with::<MapFeasibility>()?
        .with::<DrivableFeasibility>()?
        .with::<PersonFeasibility>()
}
