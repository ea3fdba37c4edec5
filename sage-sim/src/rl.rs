//! Reinforcement learning of a driving policy: TD3 (Fujimoto et al. 2018, arXiv 1802.09477).
//!
//! - [`Learner`]: actor, twin critics, their targets and optimisers; one [`update`](Learner::update) from a batch.
//! - [`ReplayBuffer`]: transitions in a ring, each observation once.
//! - [`Td3Options`]: every number of the algorithm, with the paper's defaults.
//!
//! Observation and action sizes are free. The update is written by hand: buffers are allocated once, products come
//! from `faer`, gradients are formulas, and Adam changes weights, moments and targets in one pass. It is generic
//! over `f32` (training) and `f64` (tests against candle's automatic differentiation).

mod adam;
mod kernels;
mod learner;
mod network;
mod options;
mod replay_buffer;

pub use kernels::Real;
pub use learner::{Learner, NamedTensor, TransitionBatch, UpdateReport};
pub use network::{Network, Shape, SingleRow};
pub use options::Td3Options;
pub use replay_buffer::{ReplayBuffer, Transition};
