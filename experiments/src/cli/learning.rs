//! Arguments of the commands that train networks and ask them.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::{FolderArgs, MOST_PROCEDURAL, SplitArgs, attacking::MergerArgs};

/// Train a motion prior from recorded or procedural scenes.
///
/// Learns from vehicles that are valid now and in 3 s of their future: all that move, at most ten of a
/// scene an epoch, and a few that stand, half of them mirrored. After each epoch it keeps the best weights (`prior.safetensors`), the state of training
/// (`last.safetensors`), and the curves; the same command goes on where it was interrupted, to the
/// same bits. Scenes are held in memory: about 3 MB each, 8 GiB at most.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage pretrain target/data/womd_cat500/pretrain --dev target/data/womd_cat500/dev --from procedural --out prior/\n  sage pretrain --procedural 1200 --epochs 6 --out procedural-prior/"
)]
pub(crate) struct PretrainArgs {
    /// Scene files and folders to learn from; procedural scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Scenes to choose the best epoch on; procedural ones without it.
    #[arg(long, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of procedural scenes if no path is given.
    #[arg(long, value_name = "N", default_value_t = 1200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Network to train; `sage list` shows them.
    #[arg(long, value_name = "NAME", default_value = "densetnt")]
    pub backbone: String,
    /// Options of the network as JSON, such as '{"hidden": 96}'.
    #[arg(long, value_name = "JSON")]
    pub network: Option<String>,
    /// Weights to start from: procedural, waymo, a folder or a file.
    #[arg(long, value_name = "NAME")]
    pub from: Option<String>,
    /// Passes over the vehicles.
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// Largest learning rate.
    #[arg(long, value_name = "X")]
    pub rate: Option<f64>,
    /// Other options of training as a JSON file; flags win.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Seed of the order of training and of procedural scenes; 0 without it and a --config.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Licence to keep in the weights' header.
    #[arg(long, value_name = "TEXT")]
    pub license: Option<String>,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Tune experts from a prior, by preferences among its own candidates: a realistic and an adversarial one.
///
/// Feasible beats infeasible, then better beats worse by each expert's own objective (HGPO). A --config names other
/// objectives, or other experts: {"experts": {"lawful": {"objective": …}, …}}. Encoder and
/// paths stay the prior's. The same command goes on where it was interrupted. Scenes are held in memory with
/// all their goals: about 12 MB each with three --roles. The folder gets `prior.safetensors`, `realistic.safetensors`,
/// `adversarial.safetensors`, `finetune.csv` and `run.json`; name it with `--weights` from then on.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage finetune target/data/womd_cat500/pretrain --splits splits.json --split train --prior waymo --dev target/data/womd_cat500/dev --out experts/\n  sage finetune --procedural 200 --prior procedural --out procedural-experts/"
)]
pub(crate) struct FinetuneArgs {
    /// Scene files and folders to tune on; procedural scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Scenes to report on beside those tuned on.
    #[arg(long, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of procedural scenes if no path is given.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Weights of the prior: procedural, waymo, a folder or a file; untrained:densetnt for one that
    /// has learnt nothing.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub prior: String,
    /// Pairs of ego and adversary taken from each scene beside its own: more to tune on.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = roles)]
    pub roles: usize,
    /// Options of fine-tuning as a JSON file; what is left out keeps each expert's own.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Seed of candidates, pairs and order, and of procedural scenes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Compare two ways to tune experts, each in several seeds, paired by scene.
///
/// What the policies do without choice, what the best of 32 candidates does, and how fast the
/// adversarial experts learnt.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench experts target/data/womd_cat500/val --a hgpo-0,hgpo-1 --b dpo-0,dpo-1"
)]
pub(crate) struct ExpertsArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Folders of experts of one sort, with commas.
    #[arg(long, value_name = "DIRS", required = true, value_delimiter = ',')]
    pub a: Vec<String>,
    /// Folders of the other sort.
    #[arg(long, value_name = "DIRS", required = true, value_delimiter = ',')]
    pub b: Vec<String>,
    /// Seed of the candidates.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub merging: MergerArgs,
}

/// Predict what a vehicle of a scene may do in the next eight seconds.
///
/// A row or a JSON object a candidate: rank, log-probability, goal, and with --json the 80 points of
/// the way there, world frame. With --out also a picture.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage predict examples/crossing.pkl --k 6 --select nms --out crossing.svg"
)]
pub(crate) struct PredictArgs {
    /// The scene.
    pub scene: PathBuf,
    /// The agent, by track id; the adversary by default.
    #[arg(long, value_name = "ID")]
    pub agent: Option<String>,
    /// Number of candidates.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = count)]
    pub k: usize,
    /// How candidates are chosen: the likeliest, a draw by probability, or the likeliest some way
    /// apart.
    #[arg(long, value_enum, default_value_t = SelectArg::TopK)]
    pub select: SelectArg,
    /// Distance that candidates keep with --select nms, metres.
    #[arg(long, value_name = "M", default_value = "5", value_parser = radius)]
    pub radius: f32,
    /// Seed of the draw.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Weights: procedural, waymo, lane-graph, a folder or a file. By default waymo for recordings
    /// if it is at hand, else procedural.
    #[arg(long, value_name = "NAME")]
    pub weights: Option<String>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
    /// Where a picture goes; - for standard output, then without rows.
    #[arg(long, value_name = "FILE.svg")]
    pub out: Option<PathBuf>,
    /// Write over a file that exists.
    #[arg(long)]
    pub force: bool,
}

/// Measure how well priors predict what recorded vehicles did, beside constant velocity.
///
/// Vehicles that are valid at frames 10 and 90 count. With K candidates the best one does: least mean
/// distance, least end distance, and the share of vehicles that all miss. Intervals are 95 %
/// bootstraps over scenes. `lane-graph` is the prior without weights.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage bench prediction target/data/womd_cat500/val --weights lane-graph --weights waymo --radius 5\n  sage bench prediction target/data/womd_cat500/dev --weights waymo --radius 3,4,5,6"
)]
pub(crate) struct PredictionArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Weights: procedural, waymo, lane-graph, a folder or a file; give it again for several.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: Vec<String>,
    /// Distance that candidates keep from each other, metres; several make a row each.
    #[arg(long, value_name = "M", value_delimiter = ',', default_value = "7", value_parser = radius)]
    pub radius: Vec<f32>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
}

/// Names of [`sage_backbones::candidates::Selection`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SelectArg {
    /// The likeliest.
    TopK,
    /// A draw by probability.
    Gumbel,
    /// The likeliest some way apart.
    Nms,
}

fn radius(text: &str) -> Result<f32, String> {
    let radius: f32 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.0..=1000.0).contains(&radius) { Ok(radius) } else { Err("expected 0 to 1000 m".to_owned()) }
}

/// Most pairs of ego and adversary that are taken from a scene beside its own.
const MOST_ROLES: usize = 64;

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
