//! Arguments of the commands that drive scenes.

use std::path::PathBuf;

use clap::Args;

use super::{
    AttackArgs, FolderArgs, MOST_PROCEDURAL, ReadingArgs, SplitArgs,
    attacking::{FeasibilityArgs, OperatingPointArgs},
    avoiding::AvoidableArgs,
};
use crate::part::{Part, Parts, PolicyParts};

/// Drive scenes with policies, with or without an attack, and watch the drives.
///
/// SCENE is a scene file or a folder of them. Each policy drives the ego from frame 0 to its first contact, or
/// to frame 90. All other agents replay their recordings; in a scene of `sage generate` the adversary drives
/// its attack.
///
/// With --method each policy is attacked in two stages. It drives the unchanged scene, the generator plans
/// attacks against that drive, and the policy drives again against each attack. The options of the attack and
/// their defaults are those of `sage generate`.
///
/// The output folder holds a JSON row per scene, policy and operating point, and per scene an HTML page that
/// plays all its drives side by side. The page needs no network. `docs/simulation.md`, section 'Simulate and
/// watch', describes the rows.
///
/// Scenes run in parallel. The files of a finished scene stay, so the same command resumes an interrupted run,
/// and --force starts again. If a scene fails, the error is printed and the other scenes continue.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage simulate examples/crossing.pkl --ego replay,idm,expert --method sage --lambda 0,0.5,1 --out drives/\n  sage simulate scenes/ --ego idm --json --out drives/\n  sage simulate scene.pkl --attack attacked/scene-lambda1.json --ego expert --out drives/"
)]
pub(crate) struct SimulateArgs {
    /// Scene file, or folder of scene files.
    pub scene: PathBuf,
    /// Comma-separated policies that drive the ego, by their names in `sage list`, or path:FILE with the drive
    /// of your own planner.
    #[arg(long, value_name = "POLICIES", default_value = "idm")]
    pub ego: PolicyParts,
    /// Let the adversary drive this attack on SCENE: a row of `sage generate` (JSON), or an attacked scene.
    #[arg(long, value_name = "FILE", conflicts_with = "method")]
    pub attack: Option<PathBuf>,
    /// Attack the drive of each policy with this generator, by its name in `sage list`.
    #[arg(long, value_name = "NAME")]
    pub method: Option<Part>,
    #[command(flatten)]
    pub options: AttackArgs,
    /// Print one JSON object per scene, policy and operating point.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub folder: FolderArgs,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Compare drivers: without attack, and under the attacks of generators.
///
/// Each policy drives the ego from frame 0 to the end of the recording, while all other agents replay theirs:
/// contacts, at-fault contacts, comfort, completion. Every generator then attacks that drive, and the policy
/// drives again, up to its first contact: attacks that work, those at fault, those that it could have avoided
/// and how late, progress. Prints tables with the differences of all pairs of drivers, and writes them with rows
/// per scene and `run.json`. Without PATH, procedural scenes are generated. A driver that hardly moves is hardly
/// attacked: see its completion.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage bench drivers scenes/ --policies idm,r157,pdm,expert --methods sage,random,rule --out drivers/\n  sage bench drivers scenes/ --policies constant-speed,idm,expert --unattacked --out drivers/"
)]
pub(crate) struct DriversArgs {
    /// Scene files and folders.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Policies, separated by commas; `sage list` shows them, and path:FILE is the drive of your own planner.
    #[arg(
        long,
        value_name = "NAMES",
        default_value = "replay,constant-speed,idm,idm-release,r157,pdm,expert,expert-release"
    )]
    pub policies: PolicyParts,
    /// Comma-separated generators that attack every driver; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES", default_value = "sage")]
    pub methods: Parts,
    /// Drive the unchanged scenes alone.
    #[arg(long, conflicts_with_all = ["methods", "avoidable", "lambda", "mu", "aggression", "mix"])]
    pub unattacked: bool,
    #[command(flatten)]
    pub points: OperatingPointArgs,
    /// Objective that selects one of the candidates: its name in `sage list`, or a JSON file.
    #[arg(long, value_name = "NAME", default_value = "natural")]
    pub selection: String,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    /// Weights of the experts: procedural, waymo, waymo-paper or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    #[command(flatten)]
    pub avoidable: AvoidableArgs,
    /// Number of procedural scenes, if no PATH is given.
    #[arg(long, value_name = "N", default_value_t = 28, value_parser = clap::value_parser!(u64).range(1..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Seed of random numbers.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}
