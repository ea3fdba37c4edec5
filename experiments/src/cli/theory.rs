//! Arguments of `theory`.

use std::path::PathBuf;

use clap::Args;

use super::{
    SplitArgs,
    help::{CLAIMS, DIAGNOSTICS, OUTPUT, RUN},
};

/// Check the theorems of preference-mixed experts numerically.
///
/// A line for each claim: instances, comparisons of its formula with a direct computation, those that miss their
/// tolerance, the smallest share of the tolerance that is left, the smallest ratio of a bound to what it bounds, the
/// largest error of stored cases as a share of their tolerance, and the verdict. A claim holds; holds with slack (a
/// bound that no instance attains); holds if (under a condition, with failures outside it); or fails as printed (an
/// instance refutes the paper's text, and a corrected form has no violation). The exit code is 0 if every verdict is
/// the expected one and every stored case comes out.
///
/// With --inject every claim also runs with wrong versions of its formula, which its check must notice; a check that
/// misses one is broken. The last line says how many were caught, and the exit code is 0 if all were.
///
/// With --out a page states for each claim formula, experiment, numbers, figures, verdict and caveat. With --data
/// the same questions are put to trained experts on scenes, as diagnostics: they prove nothing.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage theory
  sage theory --inject --only T1,T3
  sage theory --out theory/
  sage theory --data scenes/ --weights waymo --out theory/")]
pub(crate) struct TheoryArgs {
    /// Run every claim with its injected faults.
    #[arg(long, help_heading = CLAIMS, conflicts_with_all = ["out", "data"])]
    pub inject: bool,
    /// Only the claims with these comma-separated ids; `sage list` shows them.
    #[arg(long, help_heading = CLAIMS, value_name = "IDS", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Seed of the instances.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Instances for every 1000 that a claim's experiment states: 100 runs a tenth of each.
    #[arg(long, help_heading = CLAIMS, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub instances: u32,
    /// Print one JSON object per claim, or per injected fault.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Output folder of a page (`index.html`, `theory.md`) with figures.
    #[arg(long, help_heading = OUTPUT, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into a folder that is not empty.
    #[arg(long, help_heading = OUTPUT, requires = "out")]
    pub force: bool,
    /// Scene files and folders for the diagnostics of trained experts.
    #[arg(long, help_heading = DIAGNOSTICS, value_name = "PATH", num_args = 1..)]
    pub data: Option<Vec<PathBuf>>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Weights of the experts: procedural, waymo, waymo-paper, waymo-literal or a folder.
    #[arg(long, help_heading = DIAGNOSTICS, value_name = "NAME", default_value = "procedural", requires = "data")]
    pub weights: String,
}
