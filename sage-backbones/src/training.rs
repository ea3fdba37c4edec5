//! Training: what is learned from, the loop, and its state.

mod checkpoint;
mod finetune;
mod pretrain;
mod roles;
mod samples;
mod step;
mod tuned_scene;

pub use checkpoint::{Checkpoint, EpochRow};
pub use finetune::{FinetuneOptions, FinetuneRow, Kept, finetune};
pub use pretrain::{Observer, PretrainOptions, Pretrained, pretrain};
pub use roles::other_roles;
pub use samples::{Example, Examples, MOVING, SceneData, recorded, recorded_sample};
pub use step::{Gradient, Trainer};
pub use tuned_scene::{Expectation, GoalTable, TunedScene};
