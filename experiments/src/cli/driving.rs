//! Arguments of the commands that drive scenes.

use std::path::PathBuf;

use clap::Args;

use super::{AttackArgs, FolderArgs, ReadingArgs};
use crate::part::{Part, PolicyParts};

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
