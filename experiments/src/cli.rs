//! Arguments of the command line. Each command turns its own into a plain call.

mod attacking;
mod learning;

use std::path::PathBuf;

use clap::{
    Args, Parser, Subcommand, ValueEnum,
    builder::{PossibleValuesParser, TypedValueParser},
};
use sage_core::objective::Convention;
use sage_data::procedural::Kind;

pub(crate) use attacking::{CalibrateArgs, DialBenchArgs, GenerateArgs, OpenLoopArgs};
pub(crate) use learning::{ExpertsArgs, FinetuneArgs, PredictArgs, PredictionArgs, PretrainArgs, SelectArg};

/// Most procedural scenes that a command makes to learn from or to measure on.
pub(crate) const MOST_PROCEDURAL: u64 = 100_000;
/// Most procedural scenes that are written to a folder at once.
const MOST_COUNT: u64 = 10_000_000;

/// Steerable adversarial scenario generation for testing driving software.
#[derive(Debug, Parser)]
#[command(name = "sage", version, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Threads to work with; all cores by default. Results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Demo(DemoArgs),
    /// List the rewards, rules and other parts that commands can name.
    #[command(after_help = "Example:\n  sage list --json")]
    List {
        /// One JSON object a line.
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
    Calibrate(CalibrateArgs),
    Predict(PredictArgs),
    Generate(GenerateArgs),
    /// Measure speed or quality.
    #[command(subcommand)]
    Bench(BenchCommand),
    /// Print a completion script for a shell.
    #[command(
        after_help = "Example:\n  sage completions bash > ~/.local/share/bash-completion/completions/sage"
    )]
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

/// Make scenes of each kind, attack them from natural to aggressive, and draw the sweep.
///
/// Prints how often the adversary hits the ego at each aggression, and how it drives; leaves scenes, attacked
/// scenes and pictures. The weights are in the binary.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage demo --out demo")]
pub(crate) struct DemoArgs {
    /// Folder to write into.
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Seed of the scenes.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Write into a folder that holds something, over what is there.
    #[arg(long)]
    pub force: bool,
}

/// Show what is in recorded scenes, and what is odd about them.
///
/// PATH is a scene file (MetaDrive or ScenarioNet pickle) or a folder of them. Rows go to stdout;
/// the sum at the end goes to stderr with --json.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage inspect scenes/\n  sage inspect scenes/ --json | jq 'select(.warnings != [])'\n  sage inspect scenes/0.pkl --tracks"
)]
pub(crate) struct InspectArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
    /// List the tracks of each scene as well.
    #[arg(long, conflicts_with = "json")]
    pub tracks: bool,
}

/// Score candidate trajectories of the adversary: reward, penalties, feasibility, criticality.
///
/// The candidates are a JSON list of {"name", "trajectory": [[x, y] × 80], "ego": optional
/// [[x, y] or [x, y, heading]] × 80}: frames 11 to 90 at 10 Hz, metres, radians, world frame. The
/// ego is the logged one by default.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage score scenes/0.pkl --candidates candidates.json --convention paper --json"
)]
pub(crate) struct ScoreArgs {
    /// The scene.
    pub scene: PathBuf,
    /// JSON file of candidates; - for standard input.
    #[arg(long, value_name = "FILE")]
    pub candidates: PathBuf,
    /// Which reading of the formulas: as the paper writes them, or as the published code runs.
    #[arg(long, value_enum, default_value_t = ConventionArg::Paper)]
    pub convention: ConventionArg,
    /// Sizes of ego and adversary: the log's, or the published simulator's vehicle classes.
    #[arg(long, value_enum, default_value_t = SizesArg::Logged)]
    pub sizes: SizesArg,
    /// Where the simulator's cycle of vehicle classes starts, 0 to 5 (it draws this for each scene).
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..6))]
    pub class_cycle: u8,
    /// Take this track as the ego.
    #[arg(long, value_name = "ID")]
    pub ego: Option<String>,
    /// Take this track as the adversary.
    #[arg(long, value_name = "ID")]
    pub adversary: Option<String>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
}

/// Draw a scene from above as SVG.
///
/// Ego and adversary are marked, their ways coloured by time, boxes to scale at one frame. With
/// candidates, these are drawn in place of the adversary's logged way, and where one touches the
/// ego is marked.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage draw scenes/0.pkl --candidates candidates.json --out 0.svg")]
pub(crate) struct DrawArgs {
    /// The scene.
    pub scene: PathBuf,
    /// Where the picture goes; - for standard output.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// JSON file of candidates, as `score` takes it.
    #[arg(long, value_name = "FILE")]
    pub candidates: Option<PathBuf>,
    /// Frame whose boxes are shown; 10 is now.
    #[arg(long, value_name = "N")]
    pub frame: Option<usize>,
    /// Show the whole map, not only the surroundings of ego and adversary.
    #[arg(long)]
    pub whole_map: bool,
    /// Take this track as the ego.
    #[arg(long, value_name = "ID")]
    pub ego: Option<String>,
    /// Take this track as the adversary.
    #[arg(long, value_name = "ID")]
    pub adversary: Option<String>,
    /// Write over a file that exists.
    #[arg(long)]
    pub force: bool,
}

/// Convert scene files between MetaDrive pickles and native files.
///
/// Nothing is lost either way: what a native file does not model of its source travels along.
/// Folders keep their structure. docs/formats.md describes native files.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage convert scenes/ --to native --out native/")]
pub(crate) struct ConvertArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Format to write.
    #[arg(long, value_enum)]
    pub to: Format,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Make scenes without any data: roads, traffic, and an ego and an adversary in conflict.
///
/// The same seed and number give the same scene, whatever else is made and on however many threads.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage scenes --kind four-way --kind roundabout --count 20 --seed 1 --out made/"
)]
pub(crate) struct ScenesArgs {
    /// Kind of scene; give it again for several, which then take turns. All by default.
    #[arg(long, value_name = "KIND", value_parser = kinds())]
    pub kind: Vec<Kind>,
    /// Number of scenes.
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u64).range(..=MOST_COUNT))]
    pub count: u64,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Format to write.
    #[arg(long, value_enum, default_value_t = Format::Native)]
    pub format: Format,
    /// Write into a folder that holds something.
    #[arg(long)]
    pub force: bool,
}

/// Kinds by their names.
fn kinds() -> impl TypedValueParser<Value = Kind> {
    PossibleValuesParser::new(Kind::ALL.map(Kind::name))
        .try_map(|name| Kind::from_name(&name).ok_or("no such kind"))
}

/// Formats of scene files.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Format {
    /// safetensors: loads fastest, opens anywhere.
    Native,
    /// MetaDrive pickle: for MetaDrive and ScenarioNet.
    Pickle,
}

/// Names of [`Convention`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ConventionArg {
    /// As the paper writes them.
    Paper,
    /// As the published code computes them.
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
    /// The log's, now.
    Logged,
    /// The published simulator's vehicle models.
    Metadrive,
}

#[derive(Debug, Subcommand)]
pub(crate) enum BenchCommand {
    Speed(SpeedArgs),
    Prediction(PredictionArgs),
    OpenLoop(OpenLoopArgs),
    Dial(DialBenchArgs),
    Experts(ExpertsArgs),
}

/// Time the parts that everything else waits for, on one core where the row names no threads.
///
/// Where Python with numpy is at hand, its pickle.loads is timed beside ours in the same run.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage bench speed --data target/data/womd_cat500 --json")]
pub(crate) struct SpeedArgs {
    /// Folder of scenes; a built-in scene without it.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Repetitions of each measurement.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..100_000))]
    pub repeat: u32,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
}

/// Where a command writes that leaves more than one file.
#[derive(Clone, Debug, Args)]
pub(crate) struct FolderArgs {
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something; a run that was broken off there starts anew.
    #[arg(long)]
    pub force: bool,
}

/// Which scenes of the given ones count.
#[derive(Clone, Debug, Args)]
pub(crate) struct SplitArgs {
    /// JSON file of splits: lists of scene names by split.
    #[arg(long, value_name = "FILE")]
    pub splits: Option<PathBuf>,
    /// The split to take the scenes of.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub split: Option<String>,
    /// A split whose scenes are left out.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub without_split: Option<String>,
    /// Names of the scenes that count, with commas; all by default.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub scenes: Vec<String>,
}

impl Cli {
    /// Whether the command computes with networks.
    pub(crate) fn needs_networks(&self) -> bool {
        matches!(
            self.command,
            Command::Demo(_)
                | Command::Pretrain(_)
                | Command::Finetune(_)
                | Command::Calibrate(_)
                | Command::Predict(_)
                | Command::Generate(_)
                | Command::Bench(_)
        )
    }
}
