//! Training: samples, the training loop and its checkpoints.

mod checkpoint;
mod epochs;
mod finetune;
mod finetune_options;
mod goal_table;
mod mode_pairs;
mod prepared_scene;
mod pretrain;
mod role_assignments;
mod samples;
mod step;

pub use checkpoint::{Checkpoint, EpochRow};
pub use epochs::CheckpointFile;
pub use finetune::{FinetuneRow, finetune};
pub use finetune_options::{FinetuneOptions, Schedule, Tunes};
pub use goal_table::{Expectation, ExpertObjective, GoalTable, Measures};
pub use mode_pairs::preference_margin;
pub use prepared_scene::PreparedScene;
pub use pretrain::{Observer, PretrainOptions, Pretrained, pretrain};
pub use role_assignments::role_assignments;
pub use samples::{Example, Examples, MOVING, recorded, recorded_sample};
pub use step::{Gradient, Trainer, trainable};
