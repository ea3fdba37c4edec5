//! Arguments of the command line.

#[cfg(feature = "baselines")]
mod adversaries;
mod attacking;
mod avoiding;
mod brief_help;
mod converting;
mod driving;
mod formats;
mod help;
mod learning;
mod mixing;
mod planner;
mod rating;
mod reading;
mod searching;
mod sharding;
mod studies;
#[cfg(feature = "studio")]
mod studio;
mod testing;
mod theory;
mod training;

use std::path::PathBuf;

use clap::{
    Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum,
    builder::{PossibleValuesParser, TypedValueParser},
    error::ErrorKind,
};
use sage_core::objective::Convention;
use sage_data::{Format, procedural::Kind};

use self::{
    formats::scene_formats,
    help::{OUTPUT, PICTURE, RUN, SCENE, SCORE},
};

#[cfg(feature = "baselines")]
pub(crate) use adversaries::{TrainAdversaryCommand, TrainGooseArgs, TrainSealArgs, TrainingScenesArgs};
pub(crate) use attacking::{AttackArgs, CalibrateArgs, ExplainArgs, GenerateArgs};
pub(crate) use avoiding::AvoidableArgs;
pub(crate) use converting::ConvertArgs;
pub(crate) use driving::SimulateArgs;
pub(crate) use learning::{FinetuneArgs, MOST_ROLES, PredictArgs, PretrainArgs, SelectArg};
pub(crate) use mixing::{ConnectivityArgs, MergeArgs};
pub(crate) use planner::PlannerArgs;
pub(crate) use rating::RateArgs;
pub(crate) use reading::{ReadingArgs, SplitArgs};
pub(crate) use searching::SearchArgs;
pub(crate) use sharding::{JoinArgs, StatusArgs};
pub(crate) use studies::{ReportArgs, StudyArgs};
#[cfg(feature = "studio")]
pub(crate) use studio::StudioArgs;
pub(crate) use testing::{FailureReportArgs, Keep, SuiteArgs, TestArgs};
pub(crate) use theory::TheoryArgs;
pub(crate) use training::{EgosName, RecipeName, RewardSpec, TrainEgoArgs};

pub(crate) use sage_bench::study::MOST_PROCEDURAL;

/// Maximum number of procedural scenes that `sage scenes` writes.
const MOST_COUNT: u64 = 10_000_000;

/// Steerable adversarial scenario generation for testing driving software.
#[derive(Debug, Parser)]
#[command(name = "sage", version, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Number of threads (default: all cores); results do not depend on it.
    // Last, wherever the other options of a command end.
    #[arg(long, global = true, value_name = "N", display_order = 900, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Demo(DemoArgs),
    /// List generators, mergers, rewards, objectives, driving policies and other parts.
    #[command(after_help = "Example:\n  sage list --json")]
    List {
        /// Print one JSON object per line.
        #[arg(long)]
        json: bool,
    },
    Inspect(InspectArgs),
    Score(ScoreArgs),
    Draw(DrawArgs),
    Convert(ConvertArgs),
    Scenes(ScenesArgs),
    Pretrain(PretrainArgs),
    Finetune(FinetuneArgs),
    Merge(MergeArgs),
    Theory(TheoryArgs),
    Calibrate(CalibrateArgs),
    Predict(PredictArgs),
    Generate(GenerateArgs),
    Explain(ExplainArgs),
    Simulate(SimulateArgs),
    #[cfg(feature = "studio")]
    Studio(StudioArgs),
    Search(Box<SearchArgs>),
    Rate(Box<RateArgs>),
    Report(FailureReportArgs),
    Suite(SuiteArgs),
    Test(TestArgs),
    Status(StatusArgs),
    Join(JoinArgs),
    TrainEgo(TrainEgoArgs),
    /// Train the learned parts of an adversary.
    #[cfg(feature = "baselines")]
    #[command(
        subcommand,
        after_help = "Example:\n  sage train-adversary seal --procedural 200 --out procedural-seal/
  sage train-adversary goose --procedural 200 --out procedural-goose/"
    )]
    TrainAdversary(TrainAdversaryCommand),
    /// Analyse a set of experts.
    #[command(
        subcommand,
        after_help = "Example:\n  sage analyse connectivity --weights experts/ --out connectivity/"
    )]
    Analyse(AnalyseCommand),
    /// Run a study, or another benchmark.
    #[command(after_help = "\
Examples:
  sage bench list
  sage bench open-loop scenes/ --method sage,log --lambda 1 --out table/
  sage bench my-study.yaml scenes/ --set lambda=0:1:0.1 --out mine/
  sage bench report table/ --wide --out again/")]
    Bench(Box<BenchArgs>),
    /// Print a completion script for a shell.
    #[command(
        after_help = "Example:\n  sage completions bash > ~/.local/share/bash-completion/completions/sage"
    )]
    Completions {
        /// Shell that runs the script.
        shell: clap_complete::Shell,
    },
}

/// Generate procedural scenes, attack them at five aggressions, and show them.
///
/// Runs `sage scenes` and `sage generate` and prints both commands, and at the end the page to open. Uses the weights in
/// the binary.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage demo --out demo")]
pub(crate) struct DemoArgs {
    /// Output folder.
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Seed of the scenes.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Write into a folder that is not empty, and overwrite files there.
    #[arg(long)]
    pub force: bool,
}

/// Summarise scenes and warn about unusual data.
///
/// PATH is a scene file (MetaDrive or ScenarioNet pickle, or native file), a TFRecord file of the Waymo Open
/// Motion Dataset, a record of it (FILE#3), a pipe (-), or a folder of such files. Rows go to stdout. With
/// --json the totals at the end go to stderr.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage inspect scenes/
  sage inspect scenes/ --json | jq 'select(.warnings != [])'
  sage inspect scenes/0.pkl --tracks
  sage inspect validation.tfrecord-00000-of-00150")]
pub(crate) struct InspectArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Print one JSON object per line.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Also list the tracks of each scene.
    #[arg(long, help_heading = OUTPUT, conflicts_with = "json")]
    pub tracks: bool,
    /// Print all columns.
    #[arg(long, help_heading = OUTPUT, conflicts_with = "json")]
    pub wide: bool,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Score candidate trajectories of the adversary.
///
/// Prints reward, penalties, feasibility and criticality of each. The candidates are a JSON list of {"name", "trajectory": [[x, y] × 80], "ego": optional
/// [[x, y] or [x, y, heading]] × 80}: frames 11 to 90 at 10 Hz, metres, radians, world frame. Without
/// "ego" the logged ego path is used.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage score scenes/0.pkl --candidates candidates.json --convention paper --json"
)]
pub(crate) struct ScoreArgs {
    /// Scene file.
    pub scene: PathBuf,
    /// JSON file of candidates, or a row of `sage generate`; - for standard input.
    #[arg(long, help_heading = SCORE, value_name = "FILE")]
    pub candidates: PathBuf,
    /// Convention of the formulas: as in the paper, or as in the published code.
    #[arg(long, help_heading = SCORE, value_enum, default_value_t = ConventionArg::Paper)]
    pub convention: ConventionArg,
    /// Sizes of ego and adversary: from the log, or from the published simulator's vehicle classes.
    #[arg(long, help_heading = SCORE, value_enum, default_value_t = SizesArg::Logged)]
    pub sizes: SizesArg,
    /// Start of the simulator's cycle of vehicle classes, 0 to 5 (the simulator draws it for each scene).
    #[arg(long, help_heading = SCORE, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..6))]
    pub class_cycle: u8,
    /// Use this track as the ego.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub ego: Option<String>,
    /// Use this track as the adversary.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub adversary: Option<String>,
    #[command(flatten, next_help_heading = SCORE)]
    pub avoidable: AvoidableArgs,
    /// Print one JSON object per line.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Print all columns.
    #[arg(long, help_heading = OUTPUT, conflicts_with = "json")]
    pub wide: bool,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Draw a scene from above as SVG.
///
/// Marks ego and adversary, colours their trajectories by time, and draws boxes to scale at one frame.
/// Candidates replace the adversary's logged trajectory, and their first contact with the ego is marked.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage draw scenes/0.pkl --candidates candidates.json --out 0.svg")]
pub(crate) struct DrawArgs {
    /// Scene file.
    pub scene: PathBuf,
    /// SVG file to write; - for standard output.
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub out: PathBuf,
    /// JSON file of candidates, in the format of `sage score`, or a row of `sage generate`.
    #[arg(long, help_heading = PICTURE, value_name = "FILE")]
    pub candidates: Option<PathBuf>,
    /// Frame at which boxes are drawn (default: 10, which is now).
    #[arg(long, help_heading = PICTURE, value_name = "N")]
    pub frame: Option<usize>,
    /// Draw the whole map, not only the surroundings of ego and adversary.
    #[arg(long, help_heading = PICTURE)]
    pub whole_map: bool,
    /// Use this track as the ego.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub ego: Option<String>,
    /// Use this track as the adversary.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub adversary: Option<String>,
    /// Overwrite an existing file.
    #[arg(long, help_heading = OUTPUT)]
    pub force: bool,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Generate procedural scenes with an ego and an adversary in conflict.
///
/// Needs no data: roads and traffic are generated too. The same seed and number always give the same scene,
/// whatever the other scenes and the number of threads are.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  sage scenes --kind four-way --kind roundabout --count 20 --out procedural/")]
pub(crate) struct ScenesArgs {
    /// Kind of scene (default: all); repeat the option for several kinds in turn.
    #[arg(long, help_heading = SCENE, value_name = "KIND", value_parser = kinds())]
    pub kind: Vec<Kind>,
    /// Number of scenes.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u64).range(..=MOST_COUNT))]
    pub count: u64,
    /// Seed of the scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Output folder.
    #[arg(long, help_heading = OUTPUT, value_name = "DIR")]
    pub out: PathBuf,
    /// Output format.
    #[arg(long, help_heading = OUTPUT, default_value = "native", value_parser = scene_formats(&[Format::Native, Format::Pickle]))]
    pub format: Format,
    /// Write into a folder that is not empty.
    #[arg(long, help_heading = OUTPUT)]
    pub force: bool,
}

/// Parses a kind by its name.
fn kinds() -> impl TypedValueParser<Value = Kind> {
    PossibleValuesParser::new(Kind::ALL.map(Kind::name))
        .try_map(|name| Kind::from_name(&name).ok_or("no such kind"))
}

/// Names of [`Convention`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ConventionArg {
    /// As in the paper.
    Paper,
    /// As in the published code.
    Release,
}

impl From<ConventionArg> for Convention {
    fn from(name: ConventionArg) -> Self {
        match name {
            ConventionArg::Paper => Self::Paper,
            ConventionArg::Release => Self::Release,
        }
    }
}

/// Names of [`sage_core::objective::Sizes`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SizesArg {
    /// From the log at frame 10 (now).
    Logged,
    /// From the published simulator's vehicle classes.
    Metadrive,
}

#[derive(Debug, Subcommand)]
pub(crate) enum AnalyseCommand {
    Connectivity(ConnectivityArgs),
}

#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    pub command: Option<BenchCommand>,
    #[command(flatten)]
    pub study: StudyArgs,
}

#[derive(Debug, Subcommand)]
pub(crate) enum BenchCommand {
    /// List the shipped studies and all metrics.
    List,
    Report(ReportArgs),
}

/// Output folder of a command that writes several files.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = OUTPUT)]
pub(crate) struct FolderArgs {
    /// Output folder.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that is not empty; an interrupted run there restarts from the beginning.
    #[arg(long)]
    pub force: bool,
}

impl Cli {
    /// A usage error of options that exclude each other.
    pub(crate) fn conflict(problem: &str) -> clap::Error {
        Self::command().error(ErrorKind::ArgumentConflict, problem)
    }

    /// The command line with its help texts.
    pub(crate) fn described() -> clap::Command {
        help::arranged(Self::command())
    }

    /// Reads the arguments of this process.
    ///
    /// *Errors*: wrong usage, or help or the version is asked for.
    pub(crate) fn read() -> std::result::Result<Self, clap::Error> {
        let shows_all = std::env::args_os().any(|word| word == brief_help::OPTION);
        let described = Self::described();
        let mut command = if shows_all { described } else { brief_help::brief(described) };
        let mut matches = command.try_get_matches_from_mut(std::env::args_os())?;
        Self::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
    }

    /// True if the command evaluates networks or computes with their weights.
    pub(crate) fn needs_networks(&self) -> bool {
        match self.command {
            #[cfg(feature = "baselines")]
            Command::TrainAdversary(_) => true,
            #[cfg(feature = "studio")]
            Command::Studio(_) => true,
            Command::Demo(_)
            | Command::Pretrain(_)
            | Command::Finetune(_)
            | Command::Merge(_)
            | Command::Calibrate(_)
            | Command::Predict(_)
            | Command::Generate(_)
            | Command::Simulate(_)
            | Command::Search(_)
            | Command::Rate(_)
            | Command::Test(_)
            | Command::Join(_)
            | Command::TrainEgo(_)
            | Command::Analyse(_)
            | Command::Bench(_)
            | Command::Theory(TheoryArgs { data: Some(_), .. }) => true,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// clap itself looks only in builds with debug assertions.
    #[test]
    fn no_option_of_a_command_has_the_name_of_another() {
        fn check(command: &clap::Command) {
            let mut names: Vec<&str> = command.get_arguments().filter_map(|arg| arg.get_long()).collect();
            let count = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), count, "{}: {names:?}", command.get_name());
            command.get_subcommands().for_each(check);
        }
        check(&Cli::described());
    }
}
