//! Arguments of the commands that train and evaluate networks.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sage_backbones::{candle::Device, device::device, features::EdgeKinds};

use super::{
    FolderArgs, MOST_PROCEDURAL, ReadingArgs, SplitArgs,
    help::{OUTPUT, PREDICTION, RUN, SCENE, TRAINING},
};

/// Train a motion prior on recorded or procedural scenes.
///
/// A training sample is a vehicle that is valid now and in 3 s of its future. An epoch uses the moving
/// vehicles, at most ten per scene, and a few standing ones; half of the samples are mirrored. After each
/// epoch the best weights (`prior.safetensors`), the training state (`last.safetensors`) and the curves are
/// written. The same command resumes an interrupted run with bit-identical results. All scenes are held in
/// memory: about 3 MB each, 8 GiB at most.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage pretrain scenes/ --dev dev-scenes/ --from procedural --out prior/
  sage pretrain --procedural 1200 --epochs 6 --out procedural-prior/")]
pub(crate) struct PretrainArgs {
    /// Scene files and folders for training (default: procedural scenes).
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Scenes for selecting the best epoch (default: procedural scenes).
    #[arg(long, help_heading = SCENE, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of procedural scenes if no PATH is given.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 1200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Backbone to train, by its name in `sage list`.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "densetnt")]
    pub backbone: String,
    /// Options of the backbone as JSON, such as '{"hidden": 96}'.
    #[arg(long, help_heading = TRAINING, value_name = "JSON")]
    pub network: Option<String>,
    /// Initial weights: procedural, waymo, waymo-paper, waymo-literal, a folder or a file.
    #[arg(long, help_heading = TRAINING, value_name = "NAME")]
    pub from: Option<String>,
    /// Number of epochs: passes over the vehicles.
    #[arg(long, help_heading = TRAINING, value_name = "N")]
    pub epochs: Option<u32>,
    /// Maximum learning rate.
    #[arg(long, help_heading = TRAINING, value_name = "X")]
    pub rate: Option<f64>,
    /// JSON file of training options; command-line options override it.
    #[arg(long, help_heading = TRAINING, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Device of the network: cpu, or cuda and cuda:N in a build with the feature `cuda`.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "cpu", value_parser = device)]
    pub device: Device,
    /// Seed of the training order and of procedural scenes (default: from --config, else 0).
    #[arg(long, help_heading = RUN, value_name = "S")]
    pub seed: Option<u64>,
    /// Licence text for the header of the weights.
    #[arg(long, help_heading = OUTPUT, value_name = "TEXT")]
    pub license: Option<String>,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Fine-tune a realistic, an adversarial and a lawful expert from a prior (HGPO).
///
/// Preference pairs are formed among the policy's own candidates: feasible over infeasible, then higher over
/// lower by each expert's objective. A --config file can set other objectives or other experts: {"experts":
/// {"calm": {"objective": …}, …}}. The trajectories stay those of the prior, and so does the encoder unless
/// the config sets {"tunes": "all"}. The same command resumes an interrupted run. Scenes are held in memory with all
/// their goals: about 12 MB each with three --roles. The output folder holds `prior.safetensors`, a file for each
/// expert, `finetune.csv` and `run.json`; other commands read it with `--weights`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage finetune scenes/ --splits docs/results/splits.json --split train \\
      --prior waymo --dev dev-scenes/ --out experts/
  sage finetune scenes/ --prior waymo-paper --preset paper --out paper-experts/
  sage finetune --procedural 200 --prior procedural --out procedural-experts/")]
pub(crate) struct FinetuneArgs {
    /// Scene files and folders for fine-tuning (default: procedural scenes).
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Scenes for a report after fine-tuning; not used in it.
    #[arg(long, help_heading = SCENE, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of procedural scenes if no PATH is given.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Weights of the prior: procedural, waymo, waymo-paper, waymo-literal, a folder or a file; untrained:densetnt for initial weights.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "procedural")]
    pub prior: String,
    /// Maximum number of further role assignments (ego, adversary) per scene for fine-tuning (default: `roles` of the
    /// options, else 3).
    #[arg(long, help_heading = SCENE, value_name = "N", value_parser = roles)]
    pub roles: Option<usize>,
    /// Edges in the features of the network: road boundaries alone as in the paper, or medians too (default:
    /// `edges` of the options, else all; networks without the option keep their features).
    #[arg(long, help_heading = TRAINING, value_enum, value_name = "KIND")]
    pub edges: Option<Edges>,
    /// JSON file of fine-tuning options, with `edges` and `roles`; omitted options keep each expert's defaults.
    #[arg(long, help_heading = TRAINING, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Shipped options: `paper` for the paper's own set-up (200 epochs: 12 minutes for 220 scenes on one core).
    #[arg(long, help_heading = TRAINING, value_name = "NAME", conflicts_with = "config")]
    pub preset: Option<String>,
    /// Tune the variants of a study, each as an expert, and draw their training curves: `ablation`, `paper-ablation`,
    /// `paper-parts`, `paper-reuse`, or a JSON file as for --config.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", conflicts_with_all = ["config", "preset"])]
    pub variants: Option<String>,
    /// Device of the network: cpu, or cuda and cuda:N in a build with the feature `cuda`.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "cpu", value_parser = device)]
    pub device: Device,
    /// Seed of candidates, pairs, training order and procedural scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Predict candidate trajectories of a vehicle for eight seconds.
///
/// Prints a row for each candidate: rank, log-probability, goal, length and final speed. With --json it is an
/// object with rank, log-probability, goal and the 80 points of the trajectory, world frame. With --out a
/// picture is drawn too.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage predict examples/crossing.pkl --k 6 --select nms --out crossing.svg"
)]
pub(crate) struct PredictArgs {
    /// Scene file.
    pub scene: PathBuf,
    /// Track id of the agent (default: the adversary).
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub agent: Option<String>,
    /// Number of candidates.
    #[arg(long, help_heading = PREDICTION, value_name = "N", default_value_t = 32, value_parser = count)]
    pub k: usize,
    /// Selection of candidates: most likely, sampled, or most likely with a minimum distance.
    #[arg(long, help_heading = PREDICTION, value_enum, default_value_t = SelectArg::TopK)]
    pub select: SelectArg,
    /// Minimum distance between end points of candidates with --select nms, metres.
    #[arg(long, help_heading = PREDICTION, value_name = "M", default_value = "5", value_parser = radius)]
    pub radius: f32,
    /// Seed of the sampling with --select gumbel.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Weights: procedural, waymo, lane-graph, a folder or a file.
    #[arg(long, help_heading = PREDICTION, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Device of the network: cpu, or cuda and cuda:N in a build with the feature `cuda`.
    #[arg(long, help_heading = PREDICTION, value_name = "NAME", default_value = "cpu", value_parser = device)]
    pub device: Device,
    /// Print one JSON object per line.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// SVG file to write; - for standard output, without rows.
    #[arg(long, help_heading = OUTPUT, value_name = "FILE.svg")]
    pub out: Option<PathBuf>,
    /// Overwrite an existing file.
    #[arg(long, help_heading = OUTPUT)]
    pub force: bool,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Names of [`sage_backbones::candidates::Sampling`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SelectArg {
    /// The most likely candidates.
    TopK,
    /// Sampling by probability (Gumbel top-k).
    Gumbel,
    /// The most likely candidates with a minimum distance (non-maximum suppression).
    Nms,
}

fn radius(text: &str) -> Result<f32, String> {
    let radius: f32 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.0..=1000.0).contains(&radius) { Ok(radius) } else { Err("expected 0 to 1000 m".to_owned()) }
}

/// Maximum number of further role assignments per scene.
pub(crate) const MOST_ROLES: usize = 64;

fn roles(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 0..=MOST_ROLES) => Ok(n),
        _ => Err(format!("expected 0 to {MOST_ROLES}")),
    }
}

fn count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=10_000) => Ok(n),
        _ => Err("expected 1 to 10000".to_owned()),
    }
}

/// Edges in the features of a network.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Edges {
    /// Road boundaries.
    Boundaries,
    /// Road boundaries and medians.
    All,
}

impl From<Edges> for EdgeKinds {
    fn from(edges: Edges) -> Self {
        match edges {
            Edges::Boundaries => Self::Boundaries,
            Edges::All => Self::All,
        }
    }
}
