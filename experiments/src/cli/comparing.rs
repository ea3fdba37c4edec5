//! Arguments of `bench front`.

use clap::Args;

use super::attacking::{ComparisonArgs, OperatingPointArgs};
use crate::part::Parts;

/// SAGE, the baselines, and the optimisers at five weights.
const METHODS: &str = r#"sage,prior,random,king{"adversarial":0.1,"realism":0.9},king{"adversarial":0.3,"realism":0.7},king{"adversarial":0.5,"realism":0.5},king{"adversarial":0.7,"realism":0.3},king,king{"adversarial":2},adv-traj-opt{"adversarial":0.1,"realism":0.9},adv-traj-opt{"adversarial":0.3,"realism":0.7},adv-traj-opt{"adversarial":0.5,"realism":0.5},adv-traj-opt{"adversarial":0.7,"realism":0.3},adv-traj-opt,king-published,adv-traj-opt-published,cat,rule"#;

/// Compare generators by attack rate against realism.
///
/// Every generator attacks each scene at all its points: at lambda 0, 0.1, … 1 (or as --lambda says), and with all the
/// options that are given; rows of one generator that differ in numbers alone are one front. Writes hypervolumes with
/// intervals, the difference of the first generator from each other one at equal realism, paired by scene, the points as
/// CSV, and charts of the attack rate against P_real, lane distance and negative log-likelihood.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench front target/data/womd_cat500/val --weights waymo --methods 'sage,king,king{\"adversarial\":0.5},rule' --out front/"
)]
pub(crate) struct FrontArgs {
    #[command(flatten)]
    pub on: ComparisonArgs,
    /// Comma-separated generators, the one that the others are compared with first; with options as
    /// NAME{"option": value}.
    #[arg(long, value_name = "NAMES", default_value = METHODS)]
    pub methods: Parts,
    #[command(flatten)]
    pub points: OperatingPointArgs,
}
