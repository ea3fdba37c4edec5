//! Arguments of `sage search`.

use std::path::PathBuf;

use advsage::{attacked_files::AttackFormats, driver_spec::DriverSpec, part::Part, references};
use clap::{
    Args, ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use sage_data::dataset::Shard;
use sage_sim::{
    fault::FaultRule,
    search::{Explained, MOST_PLANS, Order, REFINE, Requirement},
};

use super::{
    AttackArgs, FolderArgs, PlannerArgs, ReadingArgs,
    avoiding::AvoidableArgs,
    formats::{ScenarioArgs, attack_formats},
    help::{ATTACK, DRIVER, OUTPUT, RUN, SEARCH, SELECTION},
};

/// Search for failures of a driver: drive against many plans of the adversary.
///
/// SCENE is a scene file, a TFRecord file, a record (FILE#3), or a folder of them. In each scene the driver drives the unchanged
/// scene once, and then up to --budget times against a plan of the adversary; what it has done decides which plan is next.
/// A plan is a failure if its attacked drive meets all clauses of --require: `attack` (the first contact is with the
/// adversary, and not there without the attack), `believable`, `at-fault` (by nuPlan's rule), and `preventable` (a reference
/// driver, which does not know the plan, takes over *now* and prevents the contact). `avoidable` asks whether an evasive manoeuvre exists,
/// knowing the plan, which it does for nearly all; `holds`, whether it is a failure in every variant of the drive: each way of following
/// plans that a planner offers, and small changes of the start; `believable-1` is the definition of `believable` before plans had limits of turns.
/// `human-time` asks whether what can be seen leaves a person 0.75 s to react, `human-time-r157` 1.15 s; `strict` whether a person as the
/// adversary keeps to 5 km/h on foot, 15 km/h by bicycle.
///
/// The plans are those of SAGE at five lambda, of its mixtures with the lawful expert, and of random goals, as far as they are
/// feasible (--feasibility, by default `drivable`). --method searches the plans of one generator instead; `king`,
/// `adv-traj-opt` and `rule` plan anew against the newest drive.
///
/// The output folder holds a JSON row and a picture per scene, a JSON file of all its drives, and for each failure a row and the
/// files of the attacked scene, as `sage generate` writes them. The mildest failure of a scene is explained in words (--explain-failures). `docs/testing-a-driver.md`, section 'What a search writes', describes
/// all files. Scenes run in parallel; the same command resumes an interrupted run, and another --budget continues one.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage search examples/crossing.pkl --ego idm --out failures/
  sage search scenes/ --ego 'cmd:python3 my_planner.py' --budget 32 \\
      --require attack,believable --out failures/
  sage search scenes/ --ego pdm --first --shard 2/8 --out failures/
  sage search scenes/ --ego idm --adversary-type pedestrian --out people/
  sage simulate examples/crossing.pkl --ego idm \\
      --attack failures/crossing-failure1.json --out watch/")]
pub(crate) struct SearchArgs {
    /// Scene file, TFRecord file, record (FILE#3), or folder of them.
    pub scene: PathBuf,
    /// Driver under test: a policy by its name in `sage list`; path:FILE, a drive of your own planner; or your own
    /// planner: 'cmd:COMMAND', a program, or py:MODULE:CLASS, a class of Python.
    #[arg(long, help_heading = DRIVER, value_name = "POLICY")]
    pub ego: DriverSpec,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Folder of `sage bench admit` with a verdict on this driver; a refused one is warned of.
    #[arg(long, help_heading = DRIVER, value_name = "DIR")]
    pub admitted: Option<PathBuf>,
    /// Largest number of attacked drives in a scene.
    #[arg(long, help_heading = SEARCH, value_name = "N", default_value_t = 64, value_parser = budget)]
    pub budget: usize,
    /// Comma-separated clauses that make a plan a failure (default: attack,believable,at-fault,preventable; with --adversary-type also
    /// human-time).
    #[arg(long, help_heading = SEARCH, value_name = "CLAUSES")]
    pub require: Option<Requirement>,
    /// Reference drivers, asked in this order whether they prevent the contact, up to the first that does; the driver under test
    /// is none of them. With --adversary-type the default order is expert, r157, idm, pdm.
    #[arg(long, help_heading = SEARCH, value_name = "NAMES", value_delimiter = ',', default_values_t = references::default_names())]
    pub reference: Vec<String>,
    /// Who is at fault: nuPlan's rule, or `careful`, by which an ego that has braked to below 3 m/s in its lane is not at fault if
    /// a faster car meets it.
    #[arg(long, help_heading = SEARCH, value_name = "RULE", default_value = FaultRule::default().name(), value_parser = fault_rules())]
    pub fault: FaultRule,
    /// Stop in each scene at the first failure.
    #[arg(long, help_heading = SEARCH)]
    pub first: bool,
    /// Order of the plans: `surrogate` drives first against what earlier drives make likely to fail; `random` and `pool` (by
    /// likelihood) do not learn from drives.
    #[arg(long, help_heading = SEARCH, value_name = "ORDER", default_value = "surrogate")]
    pub order: OrderArg,
    /// Share of the budget, at its end, for plans that are refined against what the driver did: until the first failure, and only
    /// with the order `surrogate`.
    #[arg(long, help_heading = SEARCH, value_name = "SHARE", default_value_t = REFINE, value_parser = share)]
    pub refine: f64,
    /// Failures that are explained, by some ten drives more: with less of the difference from the recording, and without other road
    /// users. `mildest` is the one whose adversary is driven least differently from the recording.
    #[arg(long, help_heading = SEARCH, value_name = "WHICH", value_enum, default_value = "mildest")]
    pub explain_failures: ExplainArg,
    /// Search the plans of this generator, by its name in `sage list`, instead of the default ones.
    #[arg(long, help_heading = ATTACK, value_name = "NAME")]
    pub method: Option<Part>,
    /// Largest number of plans of a scene.
    #[arg(long, help_heading = SEARCH, value_name = "N", default_value_t = MOST_PLANS, value_parser = budget)]
    pub plans: usize,
    #[command(flatten)]
    pub attack: AttackArgs,
    #[command(flatten, next_help_heading = SELECTION)]
    pub avoidable: AvoidableArgs,
    /// Print one JSON object per scene.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Formats of the attacked scenes.
    #[arg(long, help_heading = OUTPUT, default_value = "native", value_parser = attack_formats())]
    pub format: AttackFormats,
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Search only the scenes of shard K of N. Several machines can write all shards into one folder,
    /// which `sage join` completes.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub folder: FolderArgs,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Names of [`Explained`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExplainArg(pub Explained);

impl ValueEnum for ExplainArg {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Explained::None), Self(Explained::Mildest), Self(Explained::All)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self.0 {
            Explained::None => "none",
            Explained::Mildest => "mildest",
            Explained::All => "all",
        }))
    }
}

/// Names of [`Order`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct OrderArg(pub Order);

impl ValueEnum for OrderArg {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Order::Surrogate), Self(Order::Random), Self(Order::Pool)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self.0 {
            Order::Surrogate => "surrogate",
            Order::Random => "random",
            Order::Pool => "pool",
        }))
    }
}

pub(super) fn fault_rules() -> impl TypedValueParser<Value = FaultRule> {
    PossibleValuesParser::new(FaultRule::ALL.map(FaultRule::name))
        .map(|name| FaultRule::ALL.into_iter().find(|rule| rule.name() == name).unwrap_or_default())
}

/// Most drives or plans of a scene.
const MOST: usize = 100_000;

fn share(text: &str) -> Result<f64, String> {
    let share = text.trim().parse().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "expected a share, 0 to 1".to_owned())
}

pub(super) fn budget(text: &str) -> Result<usize, String> {
    let number = text.trim().parse().ok().filter(|number| (1..=MOST).contains(number));
    number.ok_or_else(|| format!("expected a whole number from 1 to {MOST}"))
}
