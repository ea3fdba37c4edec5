//! The learned parts of SEAL (Stoler et al., 2025), a generator of adversarial scenes.
//!
//! - [`CriticalityNetwork`] predicts from two trajectories how critical a candidate of the adversary is.
//! - [`SkillEncoder`] and [`SkillDecoder`] compress windows of driving to skills: vectors of [`SKILL`] numbers.
//! - [`SkillPrior`] is the distribution of skills, given an observation.
//!
//! [`SealWeights`] holds the parts that a generator needs, read from one file. [`training`] trains the parts.

mod coupling;
mod criticality;
mod leaky_relu;
mod prior;
mod skill_windows;
mod skills;
pub mod training;
mod weights;

pub use criticality::{CriticalityNetwork, relative_path};
pub use prior::SkillPrior;
pub use skill_windows::{Posteriors, SkillWindows};
pub use skills::{SkillDecoder, SkillEncoder};
pub use weights::{SEAL_FILE, SealOptions, SealWeights};

/// Numbers of a driver's observation.
pub const OBSERVATION: usize = 101;
/// Numbers of an action: steering and throttle, each in [−1, 1].
pub const ACTION: usize = 2;
/// Numbers of a skill.
pub const SKILL: usize = 8;
/// Steps of a window of driving; one step is 0.1 s.
pub const WINDOW: usize = 10;
