//! Arguments of `sage studio`.

use std::path::PathBuf;

use advsage::{driver_spec::DriverSpecs, part::Part};
use clap::Args;

use super::{
    MOST_PROCEDURAL, PlannerArgs,
    help::{ATTACK, DRIVER, OUTPUT, RUN, SCENE, SEARCH},
    searching::budget,
};

/// Try attacks by hand in a browser that attacks and drives again at each change.
///
/// A local page plays the drives of one or two drivers against an attack. A slider holds lambda or the aggression; a click on a
/// road user makes it the adversary or takes it away, and the end of the adversary's plan can be dragged. The page says what
/// happened, searches the scene for failures as `sage search` does, and gives the command that makes the same drives. It chooses
/// among the scenes, generators and drivers that this command line names. The server answers this machine alone, to whoever opens
/// the link that is printed, and writes nothing but the suite in --out.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage studio
  sage studio scenes/ --ego idm,pdm,expert --weights waymo --out suite/")]
pub(crate) struct StudioArgs {
    /// Scene files, records (FILE#3), and folders of them (default: procedural scenes).
    #[arg(value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    /// Number of procedural scenes if no SCENE is given.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 28, value_parser = clap::value_parser!(u64).range(1..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Comma-separated drivers to choose among, as for `sage simulate`. May be repeated.
    #[arg(long, help_heading = DRIVER, value_name = "POLICIES", default_value = "idm,expert")]
    pub ego: Vec<DriverSpecs>,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Generators to choose among, by their names in `sage list`. May be repeated.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "sage")]
    pub method: Vec<Part>,
    /// Comma-separated weights of the experts to choose among: procedural, waymo, waymo-paper, waymo-literal or a folder (default:
    /// procedural).
    #[arg(long, help_heading = ATTACK, value_name = "NAMES", value_delimiter = ',')]
    pub weights: Vec<String>,
    /// Largest number of attacked drives of a search.
    #[arg(long, help_heading = SEARCH, value_name = "N", default_value_t = 64, value_parser = budget)]
    pub budget: usize,
    /// Folder of the test suite in which failures are kept; one that is there grows.
    #[arg(long, help_heading = OUTPUT, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not open the link in the browser of this desktop.
    #[arg(long, help_heading = RUN)]
    pub no_browser: bool,
    /// Seed of random numbers, and of procedural scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Port of the server (default: any that is free).
    #[arg(long, help_heading = RUN, value_name = "PORT", default_value_t = 0)]
    pub port: u16,
}
