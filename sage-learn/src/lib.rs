//! Reinforcement learning of a driving policy, alone and in closed-loop training against an adversary.
//!
//! - [`Learner`]: what learns from driven steps: [`Td3`] (Fujimoto et al. 2018, arXiv 1802.09477) and [`Ppo`] (Schulman et
//!   al. 2017, arXiv 1707.06347).
//! - [`Td3Learner`]: actor, twin critics, their targets and optimisers; one [`update`](Td3Learner::update) from a batch.
//! - [`ActorCritic`]: actor and critic of PPO; one [`step`](ActorCritic::step) from a minibatch.
//! - [`ReplayBuffer`]: transitions in a ring, each observation once.
//! - [`Training`]: the loop of episodes, updates and evaluations, with a [`Curriculum`](sage_sim::curriculum::Curriculum), a [`SceneSampler`] and an
//!   [`Attacker`](sage_sim::attacker::Attacker).
//!
//! The driving policy of an actor is [`sage_sim::actor::ActorPolicy`].
//!
//! Observation and action sizes of the networks are free. Their updates are written by hand: buffers are allocated once,
//! products come from `faer`, gradients are formulas, and Adam changes weights, moments and targets in one pass. It is
//! generic over `f32` (training) and `f64` (tests against candle's automatic differentiation).
//!
//! A learner learns from driven steps: TD3 and PPO are behind one trait, and the loop of episodes knows neither buffers nor
//! batches. A checkpoint holds how each episode in progress began and its actions, and drives them again: a world needs no file
//! format.

mod adam;
mod batch_passes;
mod checkpoint;
pub mod curricula;
mod kernels;
mod learner;
mod named_tensors;
mod ppo;
mod running_episode;
pub mod scene_sampler;
mod td3;
mod training;
mod training_options;
mod training_state;

pub use checkpoint::CHECKPOINT;
pub use kernels::Real;
pub use learner::{DrivenStep, Learner};
pub use named_tensors::NamedTensor;
pub use ppo::{ActorCritic, After, Minibatch, Ppo, PpoOptions, Running, StepReport, Taught, advantages};
pub use scene_sampler::{SceneRecord, SceneSampler};
pub use td3::{BUFFER, ReplayBuffer, Td3, Td3Learner, Td3Options, Transition, TransitionBatch, UpdateReport};
pub use training::{KEPT_ACTORS, Setting, Stop, Training};
pub use training_options::{Algorithm, TrainingOptions};
pub use training_state::{Counters, Evaluation, TrainingState};
