//! Arguments of the commands that drive scenes.

use std::path::PathBuf;

use advsage::{driver_spec::DriverSpecs, part::Part};
use clap::Args;
use sage_data::dataset::Shard;

use super::{
    AttackArgs, FolderArgs, PlannerArgs, ReadingArgs,
    help::{ATTACK, DRIVER, OUTPUT, RUN},
};

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
#[command(after_help = "\
Examples:
  sage simulate examples/crossing.pkl --ego replay,idm,expert \\
      --method sage --lambda 0,0.5,1 --out drives/
  sage simulate scenes/ --ego idm --json --out drives/
  sage simulate scene.pkl --attack attacked/scene-lambda1.json \\
      --ego expert --out drives/
  sage simulate scenes/ --ego idm --ego 'cmd:python3 my_planner.py' \\
      --method sage --out drives/")]
pub(crate) struct SimulateArgs {
    /// Scene file, or folder of scene files.
    pub scene: PathBuf,
    /// Comma-separated policies that drive the ego, by their names in `sage list`; path:FILE, a drive of your own
    /// planner; or your own planner: py:MODULE:CLASS, a class of Python (which needs the package advsage), or 'cmd:COMMAND', a
    /// program, which takes the rest of the text. NAME=POLICY gives
    /// it a name in rows and tables. May be repeated.
    #[arg(long, help_heading = DRIVER, value_name = "POLICIES", default_value = "idm")]
    pub ego: Vec<DriverSpecs>,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// First drive up to ten scenes three times with each planner that is a program, in another order and in another
    /// process, and stop if the drives are not the same.
    #[arg(long, help_heading = DRIVER)]
    pub check_planner: bool,
    /// Let the adversary drive this attack on SCENE: a row with a plan (JSON) of generate, search or rate (its likeliest failure), or an attacked scene.
    #[arg(long, help_heading = ATTACK, value_name = "FILE", conflicts_with = "method")]
    pub attack: Option<PathBuf>,
    /// Attack the drive of each policy with this generator, by its name in `sage list`.
    #[arg(long, help_heading = ATTACK, value_name = "NAME")]
    pub method: Option<Part>,
    #[command(flatten)]
    pub options: AttackArgs,
    /// Print one JSON object per scene, policy and operating point.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Drive only the scenes of shard K of N. Several machines can write all shards into one folder,
    /// which `sage join` completes.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub folder: FolderArgs,
    #[command(flatten)]
    pub reading: ReadingArgs,
}
