//! Arguments of `sage rate`.

use std::path::PathBuf;

use advsage::{driver_spec::DriverSpecs, part::Part, rate::PROFILES, references};
use clap::Args;
use sage_data::dataset::Shard;
use sage_sim::{
    fault::FaultRule,
    rate::{Event, Given},
    search::Requirement,
};

use super::{
    FolderArgs, PlannerArgs, ReadingArgs,
    help::{ATTACK, DRIVER, OUTPUT, RATE, RUN, SCENE, SELECTION},
    searching::fault_rules,
};

/// How likely a driver fails, if the adversary moves as a motion prior says.
///
/// SCENE is a scene file, a TFRecord file, a record (FILE#3), or a folder of them. A motion prior, untuned, gives each goal of the
/// adversary a probability; the driver drives against a sample of these plans, likelier ones more often. The rate of an event is the
/// probability of the plans in whose drive it happens: `failure` by --require, `contact`, or a clause such as `believable` with the
/// ones before it. It is printed given that the plan does not touch the recorded ego (so a driver that repeats the recording has rate 0), and
/// given that it is feasible alone.
///
/// It is no accident rate, and nothing is per kilometre: the scenes are chosen, and this traffic does not look out (--aware: once). A failure that is there without
/// any attack is in no rate; rows have it beside.
///
/// The output folder holds a JSON row per scene and driver, with the probability and the outcome of each plan, and a page (`index.html`).
/// Scenes run in parallel; the same command resumes an interrupted run.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage rate scenes/ --ego idm,pdm --out rates/
  sage rate scenes/ --ego 'cmd:python3 my_planner.py' --budget 32 --out rates/
  sage rate examples/crossing.pkl --ego idm --budget all --out exact/")]
pub(crate) struct RateArgs {
    /// Scene file, TFRecord file, record (FILE#3), or folder of them.
    pub scene: PathBuf,
    /// Comma-separated drivers: policies by their names in `sage list`, path:FILE, or your own planner: 'cmd:COMMAND' or
    /// py:MODULE:CLASS. NAME=POLICY gives it a name. May be repeated.
    #[arg(long, help_heading = DRIVER, value_name = "POLICIES", required = true)]
    pub ego: Vec<DriverSpecs>,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Number of drives in a scene, or `all`: the rate is exact then.
    #[arg(long, help_heading = RATE, value_name = "N|all", default_value = "64")]
    pub budget: RateBudget,
    /// Comma-separated events.
    #[arg(long, help_heading = RATE, value_name = "EVENTS", value_delimiter = ',', default_value = "contact,attack,believable,failure")]
    pub event: Vec<Event>,
    /// Comma-separated clauses that make a failure.
    #[arg(long, help_heading = RATE, value_name = "CLAUSES", default_value_t = Requirement::default())]
    pub require: Requirement,
    /// Condition of the headline and of the likeliest failure: clear-of-recorded-ego or feasible; both are printed.
    #[arg(long, help_heading = RATE, value_name = "CONDITION", default_value_t = Given::default())]
    pub given: Given,
    /// Weights whose untuned prior is the density: procedural, waymo, or a folder (default: procedural).
    #[arg(long, help_heading = ATTACK, value_name = "NAME")]
    pub weights: Option<String>,
    /// Temperature of the density (default: that of the weights, at which recorded ends are as frequent as it says).
    #[arg(long, help_heading = ATTACK, value_name = "T")]
    pub temperature: Option<f64>,
    /// Number of profiles of a goal, equally likely: its trajectory, timed as recorded cars are; 1 is the trajectory alone.
    #[arg(long, help_heading = ATTACK, value_name = "N", default_value_t = PROFILES)]
    pub profiles: usize,
    /// Let the adversary look out, once: plans that touch the ego where the prior expects it are less likely.
    #[arg(long, help_heading = ATTACK)]
    pub aware: bool,
    /// Feasibility rule, by its name in `sage list` (default: drivable).
    #[arg(long, help_heading = SELECTION, value_name = "NAME")]
    pub feasibility: Option<Part>,
    /// Reference drivers, asked in this order whether they prevent the contact, up to the first that does.
    #[arg(long, help_heading = RATE, value_name = "NAMES", value_delimiter = ',', default_values_t = references::default_names())]
    pub reference: Vec<String>,
    /// Who is at fault: `nuplan` or `careful`, as for `sage search`.
    #[arg(long, help_heading = RATE, value_name = "RULE", default_value = FaultRule::default().name(), value_parser = fault_rules())]
    pub fault: FaultRule,
    /// Use this track as the adversary.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub adversary: Option<String>,
    /// Seed of the sample and of the drivers.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Print one JSON object per scene and driver.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Print all columns of the tables, however wide.
    #[arg(long, help_heading = OUTPUT)]
    pub wide: bool,
    /// Rate only the scenes of shard K of N. Several machines can write all shards into one folder, which `sage join` completes.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub folder: FolderArgs,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Number of drives in a scene; none for all plans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RateBudget(pub Option<usize>);

impl std::str::FromStr for RateBudget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "all" {
            return Ok(Self(None));
        }
        let number = text.trim().parse().ok().filter(|number| (1..=100_000).contains(number));
        number
            .map(|number| Self(Some(number)))
            .ok_or_else(|| "expected `all` or a whole number from 1 to 100000".to_owned())
    }
}
