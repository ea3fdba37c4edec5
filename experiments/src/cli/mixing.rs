//! Arguments of the commands that merge experts and compare mixtures of them.

use std::path::PathBuf;

use clap::Args;

use super::FolderArgs;

/// Merge experts into one network by a recipe.
///
/// RECIPE is YAML in mergekit's shape: `merge_method` (a merger of weights in `sage list`, or mergekit's name of it),
/// `base_model` (the prior: weights by name, or a folder), `models` (files of experts, each with its `weight`),
/// and `parameters` (options of the merger). The method `greedy-soup` finds the weights by a search on the scenes
/// that `parameters` names. Everything is checked before anything is written. The output folder holds the weights, a
/// copy of the recipe and a model card. `docs/method.md`, section 'Merge recipes', shows one.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  sage merge recipe.yaml --out merged/
  sage generate scenes/ --weights merged/ --method prior --out attacked/")]
pub(crate) struct MergeArgs {
    /// Recipe (YAML).
    pub recipe: PathBuf,
    /// Seed of mergers that use random numbers.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Analyse the geometry of experts.
///
/// Measures norms, angle and cosine of the preference vectors, principal components, and each tensor's share of the
/// movement. Needs no scenes. Writes a page with the figures (`connectivity.md`), CSV files and pictures. `sage bench connectivity`
/// measures rewards on the path between the experts and on the plane through them.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage analyse connectivity --weights waymo --out connectivity/")]
pub(crate) struct ConnectivityArgs {
    /// Weights of the experts: procedural, waymo, waymo-paper, waymo-literal or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    #[command(flatten)]
    pub folder: FolderArgs,
}
