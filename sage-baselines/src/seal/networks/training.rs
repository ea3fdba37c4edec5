//! Training of SEAL's networks: [`train_criticality`], [`train_skills`] and [`train_prior`].
//!
//! A training runs on one thread. Equal data, options and seed give the same bits, also if the training was stopped after
//! any epoch and resumed from its checkpoint. The result is the network of the best validation epoch.

mod criticality;
mod epochs;
mod plateau;
mod prior;
mod skills;
mod split;

pub use criticality::{
    CriticalityData, CriticalityExample, CriticalityOptions, CriticalityRow, train_criticality,
};
pub use epochs::Trained;
pub use prior::{PriorOptions, PriorRow, PriorWindows, train_prior};
pub use skills::{SkillOptions, SkillRow, train_skills};
