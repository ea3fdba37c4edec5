//! Arguments of `theory`.

use clap::Args;

/// Check the theorems of preference-mixed experts numerically.
///
/// A line for each claim: comparisons of its formula with a direct computation on seeded instances, those that
/// miss their tolerance, the smallest share of the tolerance that is left, the largest error of stored cases as a
/// share of theirs, and the verdict: a claim holds, or fails as printed, with counterexamples where they are
/// predicted. The exit code is 0 if every verdict is the expected one.
///
/// With --plant every claim also runs with wrong versions of its formula, which its check must notice. The last
/// line says how many were, and the exit code is 0 if all were.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sage theory\n  sage theory --plant --only T1,T3")]
pub(crate) struct TheoryArgs {
    /// Run every claim with its planted errors.
    #[arg(long)]
    pub plant: bool,
    /// Only the claims with these comma-separated ids; `sage list` shows them.
    #[arg(long, value_name = "IDS", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Seed of the instances.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Number of random instances of each claim.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub instances: u32,
    /// Print one JSON object per claim, or per planted error.
    #[arg(long)]
    pub json: bool,
}
