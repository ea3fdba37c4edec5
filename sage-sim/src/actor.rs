//! Learnt drivers: the actor network, its policy and its file.

mod layers;
mod network;
mod policy;
mod policy_file;
pub mod tensor_file;

pub use layers::{Real, narrow_layer};
pub use network::{Network, Shape, SingleRow};
pub use policy::{ActorPolicy, action_of, aims_of};
pub use policy_file::{PolicyCard, is_zero, parse_policy, read_policy, write_policy};
