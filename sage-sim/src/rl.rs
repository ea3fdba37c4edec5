//! Reinforcement learning of a driving policy, alone and in closed-loop training against an adversary.
//!
//! - [`Learner`]: what learns from driven steps: [`Td3`] (Fujimoto et al. 2018, arXiv 1802.09477) and [`Ppo`] (Schulman et
//!   al. 2017, arXiv 1707.06347).
//! - [`Td3Learner`]: actor, twin critics, their targets and optimisers; one [`update`](Td3Learner::update) from a batch.
//! - [`ActorCritic`]: actor and critic of PPO; one [`step`](ActorCritic::step) from a minibatch.
//! - [`ReplayBuffer`]: transitions in a ring, each observation once.
//! - [`Training`]: the loop of episodes, updates and evaluations, with a [`Curriculum`], a [`SceneSampler`] and an
//!   [`Attacker`].
//! - [`ActorPolicy`]: the driving policy of an actor.
//!
//! Observation and action sizes of the networks are free. Their updates are written by hand: buffers are allocated once,
//! products come from `faer`, gradients are formulas, and Adam changes weights, moments and targets in one pass. It is
//! generic over `f32` (training) and `f64` (tests against candle's automatic differentiation).
//!
//! A learner learns from driven steps: TD3 and PPO are behind one trait, and the loop of episodes knows neither buffers nor
//! batches. A checkpoint holds how each episode in progress began and its actions, and drives them again: a world needs no file
//! format.

mod adam;
mod attacker;
mod checkpoint;
pub mod curriculum;
mod evaluation;
mod kernels;
mod learner;
mod named_tensors;
mod network;
mod policy;
mod policy_file;
mod ppo;
mod running_episode;
pub mod scene_sampler;
mod standing;
mod success;
mod td3;
mod tensor_file;
mod training;
mod training_options;
mod training_state;

pub use attacker::{Attacker, plan_of_generator};
pub use checkpoint::CHECKPOINT;
pub use curriculum::{Curriculum, Progress, SuccessRates};
pub(crate) use evaluation::SHORTEST_DRIVE;
pub use evaluation::{EpisodeRow, attack_episode, drive_episode, drive_scene, evaluation_rules};
pub use kernels::Real;
pub use learner::{DrivenStep, Learner};
pub use named_tensors::NamedTensor;
pub use network::{Network, Shape, SingleRow};
pub use policy::ActorPolicy;
pub use policy_file::{PolicyCard, parse_policy, read_policy, write_policy};
pub use ppo::{ActorCritic, After, Minibatch, Ppo, PpoOptions, Running, StepReport, Taught, advantages};
pub use scene_sampler::{SceneRecord, SceneSampler};
pub(crate) use success::success;
pub use td3::{BUFFER, ReplayBuffer, Td3, Td3Learner, Td3Options, Transition, TransitionBatch, UpdateReport};
pub use training::{KEPT_ACTORS, Setting, Stop, Training};
pub use training_options::{Algorithm, TrainingOptions};
pub use training_state::{Counters, Evaluation, TrainingState};
