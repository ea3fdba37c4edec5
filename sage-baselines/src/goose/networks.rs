//! The networks of GOOSE, a generator of adversarial scenes by reinforcement learning: in each round of an attack, an
//! actor changes weights and control points of a spline, after an encoder has read the drive of the round before.
//!
//! - [`GooseWeights`] holds encoder and actor, read from one file, and gives the actor's action.
//! - [`training`] trains the encoder by the gradient that the training of the actor passes on.

pub mod training;
mod weights;

pub use weights::{GOOSE_FILE, GooseOptions, GooseWeights};

/// Numbers of one step of a drive: 5 agents times 8.
pub const FEATURES: usize = 40;
/// Units of the encoder.
pub const HIDDEN: usize = 128;
/// Numbers of the state beside the encoding: curve 12, achieved goal 3, desired goal 3.
pub const REST: usize = 18;
/// Numbers of the state: the encoding, then the rest.
pub const STATE: usize = HIDDEN + REST;
/// Numbers of an action: changes of weights and control points, each in [−1, 1].
pub const ACTION: usize = 12;
/// Units of each of the two hidden layers of the actor.
pub const ACTOR_HIDDEN: usize = 256;

/// One step of a drive.
pub type Features = [f32; FEATURES];
