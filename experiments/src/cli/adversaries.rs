//! Arguments of the commands that train adversaries.

use std::path::PathBuf;

use advsage::driver_spec::DriverSpec;
use clap::{Args, Subcommand};

use super::{
    FolderArgs, MOST_PROCEDURAL, PlannerArgs, SplitArgs,
    help::{DRIVER, OUTPUT, RUN, SCENE, TRAINING},
};

/// Adversaries with learned parts.
#[derive(Debug, Subcommand)]
pub(crate) enum TrainAdversaryCommand {
    Seal(TrainSealArgs),
    Goose(TrainGooseArgs),
}

/// Scenes of a training, and those on which its result is measured.
#[derive(Debug, Args)]
pub(crate) struct TrainingScenesArgs {
    /// Scene files and folders for training (default: procedural scenes).
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Scene files and folders on which what was trained is measured; scenes of the training are left out.
    #[arg(long, help_heading = SCENE, value_name = "PATH", num_args = 1..)]
    pub dev: Vec<PathBuf>,
    /// Number of procedural scenes if no PATH is given.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
}

/// Train the learned parts of the generators `seal-score` and `seal`.
///
/// A car-following driver drives every scene alone and against each of the prior's 32 candidates. A score learns from these
/// drives how critical a candidate is; skills and their distributions learn how the car was driven, ordinarily and before
/// contacts. The folder gets `seal.safetensors` (copy it beside the prior, then --weights finds it),
/// `seal-benign.safetensors` (the same with the skills of ordinary driving, for comparison), curves, `README.md` with what was
/// measured, and `run.json`. The same command resumes an interrupted run with bit-identical results. The windows are
/// held in memory: about 1 MB a scene.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage train-adversary seal scenes/ --weights waymo --dev dev/ --out seal/
  sage train-adversary seal scenes/ --splits docs/results/splits.json \\
      --split train --weights waymo --out seal/
  sage train-adversary seal --procedural 200 --out procedural-seal/")]
pub(crate) struct TrainSealArgs {
    #[command(flatten)]
    pub scenes: TrainingScenesArgs,
    /// Weights whose prior proposes the candidates: procedural, waymo, a folder or a file.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Options of training as JSON, such as '{"hidden": 512, "skills": {"epochs": 100, "rate": 1e-4}}'.
    #[arg(long, help_heading = TRAINING, value_name = "JSON", default_value = "{}")]
    pub options: String,
    /// Seed of drives, training order and procedural scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Licence text for the header of the weights.
    #[arg(long, help_heading = OUTPUT, value_name = "TEXT")]
    pub license: Option<String>,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Train the policy of the generator `goose` against a driver.
///
/// The policy moves the control points of the adversary's path, the driver drives against it, and the policy learns from what
/// happened (TD3 with goals in hindsight). Each decision costs one drive and one update. The folder gets `goose.safetensors` (copy it beside the
/// prior, then --weights finds it), curves, `README.md` with what was measured, and `run.json`. The same command resumes an
/// interrupted run with bit-identical results; it first repeats its drives. Scenes are held in memory: about 2 MB for each of their role
/// assignments.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage train-adversary goose scenes/ --dev dev/ --out goose/
  sage train-adversary goose scenes/ --splits docs/results/splits.json \\
      --split train --out goose/
  sage train-adversary goose --procedural 200 --ego expert \\
      --out against-expert/")]
pub(crate) struct TrainGooseArgs {
    #[command(flatten)]
    pub scenes: TrainingScenesArgs,
    /// Driver that it attacks, by its name in `sage list`.
    #[arg(long, help_heading = DRIVER, value_name = "POLICY", default_value = "idm-release")]
    pub ego: DriverSpec,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Options of training as JSON (docs/training.md, section 'Adversaries'), such as '{"decisions": 24000, "networks": {"unscaled": true}}'.
    #[arg(long, help_heading = TRAINING, value_name = "JSON", default_value = "{}")]
    pub options: String,
    /// Seed of drives, exploration, training order and procedural scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Licence text for the header of the weights.
    #[arg(long, help_heading = OUTPUT, value_name = "TEXT")]
    pub license: Option<String>,
    #[command(flatten)]
    pub folder: FolderArgs,
}
