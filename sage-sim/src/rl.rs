//! Reinforcement learning of a driving policy: TD3 (Fujimoto et al. 2018, arXiv 1802.09477), alone and in closed-loop
//! training against an adversary.
//!
//! - [`Learner`]: actor, twin critics, their targets and optimisers; one [`update`](Learner::update) from a batch.
//! - [`ReplayBuffer`]: transitions in a ring, each observation once.
//! - [`Training`]: the loop of episodes, updates and evaluations, with a [`Curriculum`], a [`SceneSampler`] and an
//!   [`Attacker`].
//! - [`ActorPolicy`]: the driving policy of an actor.
//!
//! Observation and action sizes of the learner are free. The update is written by hand: buffers are allocated once,
//! products come from `faer`, gradients are formulas, and Adam changes weights, moments and targets in one pass. It is
//! generic over `f32` (training) and `f64` (tests against candle's automatic differentiation).

mod adam;
mod attacker;
mod buffer_log;
mod checkpoint;
pub mod curriculum;
mod evaluation;
mod kernels;
mod learner;
mod network;
mod options;
mod policy;
mod policy_file;
mod replay_buffer;
pub mod scene_sampler;
mod success;
mod tensor_file;
mod training;
mod training_options;
mod training_state;

pub use attacker::{Attacker, plan_of_generator};
pub use buffer_log::BUFFER;
pub use checkpoint::CHECKPOINT;
pub use curriculum::{Curriculum, Progress, SuccessRates};
pub(crate) use evaluation::SHORTEST_DRIVE;
pub use evaluation::{EpisodeRow, attack_episode, drive_episode, drive_scene, evaluation_rules};
pub use kernels::Real;
pub use learner::{Learner, NamedTensor, TransitionBatch, UpdateReport};
pub use network::{Network, Shape, SingleRow};
pub use options::Td3Options;
pub use policy::ActorPolicy;
pub use policy_file::{PolicyCard, parse_policy, read_policy, write_policy};
pub use replay_buffer::{ReplayBuffer, Transition};
pub use scene_sampler::{SceneRecord, SceneSampler};
pub(crate) use success::success;
pub use training::{KEPT_ACTORS, Setting, Stop, Training};
pub use training_options::TrainingOptions;
pub use training_state::{Counters, Evaluation, TrainingState};
