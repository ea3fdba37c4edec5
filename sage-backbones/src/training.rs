//! Training: what is learned from, the loop, and its state.

mod checkpoint;
mod epochs;
mod finetune;
mod goal_table;
mod pretrain;
mod roles;
mod samples;
mod step;
mod tuned_scene;

pub use checkpoint::{Checkpoint, EpochRow};
pub use epochs::Kept;
pub use finetune::{FinetuneOptions, FinetuneRow, finetune};
pub use goal_table::{Expectation, GoalTable, Measures};
pub use pretrain::{Observer, PretrainOptions, Pretrained, pretrain};
pub use roles::other_roles;
pub use samples::{Example, Examples, MOVING, SceneData, recorded, recorded_sample};
pub use step::{Gradient, Trainer, trainable};
pub use tuned_scene::TunedScene;
