//! Arguments of the commands that merge experts and compare mixtures of them.

use std::path::PathBuf;

use clap::Args;

use super::{
    FolderArgs, SplitArgs,
    attacking::{ComparisonArgs, MergerArgs, number},
};
use crate::part::Parts;

/// Merge experts into one network by a recipe.
///
/// RECIPE is YAML in mergekit's shape: `merge_method` (a merger of weights in `sage list`, or mergekit's name of it),
/// `base_model` (the prior: weights by name, or a folder), `models` (files of experts, each with its `weight`),
/// and `parameters` (options of the merger). The method `greedy-soup` finds the weights by a search on the scenes
/// that `parameters` names. Everything is checked before anything is written. The output folder holds the weights, a
/// copy of the recipe and a model card. `docs/method.md`, section 'Merge recipes', shows one.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage merge recipe.yaml --out merged/\n  sage generate scenes/ --weights merged/ --method prior --out attacked/"
)]
pub(crate) struct MergeArgs {
    /// Recipe (YAML).
    pub recipe: PathBuf,
    /// Seed of mergers that use random numbers.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Compare mergers: reward against realism over 21 values of lambda.
///
/// SAGE attacks every scene with each merger at lambda 0, 0.05, … 1. Writes hypervolumes with intervals, paired
/// with the first merger, the points as CSV, and charts: R_adv against P_real, and the attack rate against
/// lambda. Every row comes twice: for the selected candidates, and without selection as expectations under the
/// policy, because the selection hides differences.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench pareto target/data/womd_cat500/val --weights waymo --mergers linear,logit,trajectory --out pareto/"
)]
pub(crate) struct ParetoArgs {
    #[command(flatten)]
    pub on: ComparisonArgs,
    /// Comma-separated mergers; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES", default_value = "linear,logit,probability,trajectory,slerp,ties,dare")]
    pub mergers: Parts,
    /// Weight mu of the selection at every lambda; default: lambda.
    #[arg(long, value_name = "M", value_parser = number)]
    pub mu: Option<f64>,
}

/// Measure mixtures of three experts: attack rate, P_real and lane distance on the triangle of their weights.
///
/// SAGE attacks every scene at every mixture whose weights are multiples of 1 / --steps. The same values come
/// without selection too, as expectations under the policy. Writes a table of the corners and the centre, all
/// mixtures as CSV, and a picture of three triangles for each kind.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench mixtures target/data/womd_cat500/val --weights waymo --out mixtures/"
)]
pub(crate) struct MixturesArgs {
    #[command(flatten)]
    pub on: ComparisonArgs,
    /// Three experts, separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "realistic,adversarial,lawful")]
    pub experts: Vec<String>,
    /// Steps along each side of the triangle.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=50))]
    pub steps: u32,
    #[command(flatten)]
    pub merging: MergerArgs,
    /// Weight mu of the selection at every mixture; default: the weight of the adversarial expert.
    #[arg(long, value_name = "M", value_parser = number)]
    pub mu: Option<f64>,
}

/// Analyse linear mode connectivity: geometry of the realistic and the adversarial expert, rewards on the path
/// between them, on the plane through them and the prior, and beyond the adversarial one.
///
/// Writes a page with the figures (`connectivity.md`), and CSV files and pictures of the path, of the landscape on
/// the plane (21 x 21 models), of extrapolation at equal step lengths, of the principal components of all experts,
/// and of each tensor's share of the movement. Rewards are expectations under the policy, without selection. The
/// same command resumes an interrupted run.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage analyse connectivity target/data/womd_cat500/val --weights waymo --out connectivity/"
)]
pub(crate) struct ConnectivityArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Weights of the experts: procedural, waymo, waymo-paper or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Seed of random numbers.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}
