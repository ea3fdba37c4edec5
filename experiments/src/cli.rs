//! Arguments of the command line. Each command turns its own into a plain call.

use std::path::PathBuf;

use anyhow::Result;
use clap::{
    Args, Parser, Subcommand, ValueEnum,
    builder::{PossibleValuesParser, TypedValueParser},
};
use sage_core::objective::Convention;
use sage_data::procedural::Kind;

use crate::{Outcome, Registries, commands, methods::Choosing, threads};

/// Steerable adversarial scenario generation for testing driving software.
#[derive(Debug, Parser)]
#[command(name = "sage", version, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Threads to work with; all cores by default. Results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
enum Command {
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
/// Prints how often the adversary hits the ego at each lambda, and how it drives; leaves scenes, attacked
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
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something.
    #[arg(long)]
    pub force: bool,
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
    #[arg(long, value_name = "N", default_value_t = 6)]
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
enum BenchCommand {
    Speed(SpeedArgs),
    Prediction(PredictionArgs),
    OpenLoop(OpenLoopArgs),
}

/// Compare generators against a replayed ego: the paper's table and what it hides.
///
/// Rows are methods at each lambda; columns the paper's measures in both conventions, and how natural
/// the chosen ways are, paired with the log. A second table shows what the policies do without any
/// choice. Intervals are 95 % bootstraps over scenes.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench open-loop target/data/womd_cat500/val --weights waymo --methods sage,prior,random,cat,rule,log --lambda 0,0.5,1 --out table/"
)]
pub(crate) struct OpenLoopArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// JSON file of splits: lists of scene names by split.
    #[arg(long, value_name = "FILE", requires = "split")]
    pub splits: Option<PathBuf>,
    /// The split to run on.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub split: Option<String>,
    /// Generators, with commas.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        default_value = "sage,prior,random,oracle,cat,rule,log"
    )]
    pub methods: Vec<String>,
    /// Where between the experts: a number, several with commas, or from:to:step.
    #[arg(long, value_name = "L", default_value = "0,0.5,1", value_parser = lambdas)]
    pub lambda: Lambdas,
    #[command(flatten)]
    pub choosing: ChoosingArgs,
    /// What the choice weighs.
    #[arg(long, value_enum, default_value_t = ChoiceArg::Paper)]
    pub choice: ChoiceArg,
    /// Weights with experts: procedural, waymo or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something.
    #[arg(long)]
    pub force: bool,
}

/// Measure how well priors predict what recorded vehicles did, beside constant velocity.
///
/// Vehicles that are valid at frames 10 and 90 count. With K candidates the best one does: least mean
/// distance, least end distance, and the share of vehicles that all miss. Intervals are 95 %
/// bootstraps over scenes. `lane-graph` is the prior without weights.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage bench prediction target/data/womd_cat500/val --weights lane-graph --weights waymo --radius 5\n  sage bench prediction target/data/womd_cat500/dev --weights waymo --radius 3,4,5,6"
)]
pub(crate) struct PredictionArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Weights: procedural, waymo, lane-graph, a folder or a file; give it again for several.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: Vec<String>,
    /// Distance that candidates keep from each other, metres; several make a row each.
    #[arg(long, value_name = "M", value_delimiter = ',', default_value = "7", value_parser = radius)]
    pub radius: Vec<f32>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
}

/// Train a motion prior from recorded scenes, or from made ones.
///
/// Learns from vehicles that are valid now and in 3 s of their future: all that move, at most ten of a
/// scene an epoch, and a few that stand, half of them mirrored. After each epoch it keeps the best weights (`prior.safetensors`), the state of training
/// (`last.safetensors`), and the curves; the same command goes on where it was interrupted, to the
/// same bits.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage pretrain target/data/womd_cat500/pretrain --dev target/data/womd_cat500/dev --from procedural --out prior/\n  sage pretrain --made 1200 --epochs 6 --out made-prior/"
)]
pub(crate) struct PretrainArgs {
    /// Scene files and folders to learn from; made scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Scenes to choose the best epoch on; made ones without it.
    #[arg(long, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of scenes to make where no path is given.
    #[arg(long, value_name = "N", default_value_t = 1200)]
    pub made: u64,
    /// Network to train; `sage list` shows them.
    #[arg(long, value_name = "NAME", default_value = "densetnt")]
    pub backbone: String,
    /// Options of the network as JSON, such as '{"hidden": 96}'.
    #[arg(long, value_name = "JSON")]
    pub network: Option<String>,
    /// Weights to start from: procedural, waymo, a folder or a file.
    #[arg(long, value_name = "NAME")]
    pub from: Option<String>,
    /// Passes over the vehicles.
    #[arg(long, value_name = "N")]
    pub epochs: Option<u32>,
    /// Largest learning rate.
    #[arg(long, value_name = "X")]
    pub rate: Option<f64>,
    /// Other options of training as a JSON file; flags win.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Seed of the order of training and of made scenes; 0 without it and a --config.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Licence to keep in the weights' header.
    #[arg(long, value_name = "TEXT")]
    pub license: Option<String>,
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something, and start anew where a run was interrupted.
    #[arg(long)]
    pub force: bool,
}

/// Tune a realistic and an adversarial expert from a prior, by preferences among its own candidates.
///
/// Feasible beats infeasible, then better beats worse by each expert's own reward (HGPO). Encoder and
/// paths stay the prior's. The folder gets `prior.safetensors`, `realistic.safetensors`,
/// `adversarial.safetensors`, `finetune.csv` and `run.json`; name it with `--weights` from then on.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage finetune target/data/womd_cat500/pretrain --splits splits.json --split train --prior waymo --dev target/data/womd_cat500/dev --out experts/\n  sage finetune --made 200 --prior procedural --out made-experts/"
)]
pub(crate) struct FinetuneArgs {
    /// Scene files and folders to tune on; made scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// JSON file of splits: lists of scene names by split.
    #[arg(long, value_name = "FILE", requires = "split")]
    pub splits: Option<PathBuf>,
    /// The split to tune on.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub split: Option<String>,
    /// Scenes to report on beside those tuned on.
    #[arg(long, value_name = "DIR")]
    pub dev: Option<PathBuf>,
    /// Number of scenes to make where no path is given.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub made: u64,
    /// Weights of the prior: procedural, waymo, a folder or a file.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub prior: String,
    /// Options of fine-tuning as a JSON file; what is left out keeps each expert's own.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Seed of candidates, pairs and order, and of made scenes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something.
    #[arg(long)]
    pub force: bool,
}

/// Predict what a vehicle of a scene may do in the next eight seconds.
///
/// A row or a JSON object a candidate: rank, log-probability, goal, and with --json the 80 points of
/// the way there, world frame. With --out also a picture.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage predict examples/crossing.pkl --k 6 --select nms --out crossing.svg"
)]
pub(crate) struct PredictArgs {
    /// The scene.
    pub scene: PathBuf,
    /// The agent, by track id; the adversary by default.
    #[arg(long, value_name = "ID")]
    pub agent: Option<String>,
    /// Number of candidates.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = count)]
    pub k: usize,
    /// How candidates are chosen: the likeliest, a draw by probability, or the likeliest some way
    /// apart.
    #[arg(long, value_enum, default_value_t = SelectArg::TopK)]
    pub select: SelectArg,
    /// Distance that candidates keep with --select nms, metres.
    #[arg(long, value_name = "M", default_value = "5", value_parser = radius)]
    pub radius: f32,
    /// Seed of the draw.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Weights: procedural, waymo, lane-graph, a folder or a file. By default waymo for recordings
    /// if it is at hand, else procedural.
    #[arg(long, value_name = "NAME")]
    pub weights: Option<String>,
    /// One JSON object a line.
    #[arg(long)]
    pub json: bool,
    /// Where a picture goes; - for standard output, then without rows.
    #[arg(long, value_name = "FILE.svg")]
    pub out: Option<PathBuf>,
    /// Write over a file that exists.
    #[arg(long)]
    pub force: bool,
}

/// Make adversarial scenes: the adversary drives something else than it did, the rest stays.
///
/// Lambda mixes the realistic (0) and the adversarial (1) expert and weighs what the choice prefers;
/// several make a sweep, with one picture of all. Each scene comes out as native file, MetaDrive
/// pickle, SVG, and JSON with all candidates and their scores. A scene that fails is reported, and the
/// others go on.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sage generate examples/crossing.pkl --lambda 1 --out attacked/\n  sage generate scenes/ --method sage --lambda 0:1:0.25 --out sweep/ --json"
)]
pub(crate) struct GenerateArgs {
    /// Scene file or folder.
    pub scene: PathBuf,
    /// Generator.
    #[arg(long, value_name = "NAME", default_value = "sage")]
    pub method: String,
    /// Where between the experts: a number, several with commas, or from:to:step.
    #[arg(long, value_name = "L", default_value = "1", value_parser = lambdas)]
    pub lambda: Lambdas,
    #[command(flatten)]
    pub choosing: ChoosingArgs,
    /// What the choice weighs: the paper's preference, or also lanes and surprise.
    #[arg(long, value_enum, default_value_t = ChoiceArg::Natural)]
    pub choice: ChoiceArg,
    /// Take this track as the adversary.
    #[arg(long, value_name = "ID")]
    pub adversary: Option<String>,
    /// Weights with experts: procedural, waymo or a folder. By default waymo for recordings if it is
    /// at hand, else procedural.
    #[arg(long, value_name = "NAME")]
    pub weights: Option<String>,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// One JSON object a scene and lambda.
    #[arg(long)]
    pub json: bool,
    /// Folder to write into.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into a folder that holds something.
    #[arg(long)]
    pub force: bool,
}

/// What the choice among candidates weighs, for every command that makes one.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct ChoosingArgs {
    /// Weight of the adversarial reward in the choice, 0 to 1; lambda by default.
    #[arg(long, value_name = "M")]
    pub mu: Option<f64>,
    /// Which rule makes a candidate feasible.
    #[arg(long, value_enum, default_value_t = FeasibilityArg::Paper)]
    pub feasibility: FeasibilityArg,
}

impl ChoosingArgs {
    /// With what is weighed beside the preference.
    pub(crate) fn with(self, choice: ChoiceArg) -> Choosing {
        let strict = matches!(self.feasibility, FeasibilityArg::Strict);
        Choosing { choice: choice.into(), strict, mu: self.mu }
    }
}

/// One or more values of lambda.
#[derive(Clone, Debug)]
pub(crate) struct Lambdas(pub Vec<f64>);

/// Parses `1`, `0,0.5,1` or `0:1:0.1`.
fn lambdas(text: &str) -> Result<Lambdas, String> {
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| format!("`{text}` is not a number"));
    if let [from, to, step] = text.split(':').collect::<Vec<_>>()[..] {
        let [from, to, step] = [number(from)?, number(to)?, number(step)?];
        let count = (to - from) / step;
        if !(0.0..1000.0).contains(&count) {
            return Err("expected from:to:step with at most 1000 steps".to_owned());
        }
        // Rounded, so that 0.3 is 0.3 and not three times 0.1.
        let at = |k: usize| ((from + k as f64 * step) * 1e9).round() / 1e9;
        return Ok(Lambdas((0..=(count + 1e-9) as usize).map(at).collect()));
    }
    Ok(Lambdas(text.split(',').map(number).collect::<Result<_, _>>()?))
}

/// Names of [`sage_generators::Choice`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ChoiceArg {
    /// As in the paper.
    Paper,
    /// With a little for keeping to lanes and for what cars usually do.
    Natural,
}

impl From<ChoiceArg> for sage_generators::Choice {
    fn from(name: ChoiceArg) -> Self {
        match name {
            ChoiceArg::Paper => Self::Paper,
            ChoiceArg::Natural => Self::Natural,
        }
    }
}

/// Names of the feasibility rules.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum FeasibilityArg {
    /// No box touches an edge or anybody else at a frame.
    Paper,
    /// Also between frames, and on the drivable side.
    Strict,
}

/// Names of [`sage_backbones::candidates::Selection`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SelectArg {
    /// The likeliest.
    TopK,
    /// A draw by probability.
    Gumbel,
    /// The likeliest some way apart.
    Nms,
}

fn radius(text: &str) -> Result<f32, String> {
    let radius: f32 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (0.0..=1000.0).contains(&radius) { Ok(radius) } else { Err("expected 0 to 1000 m".to_owned()) }
}

fn count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=10_000) => Ok(n),
        _ => Err("expected 1 to 10000".to_owned()),
    }
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

impl Cli {
    /// Whether the command computes with networks.
    pub(crate) fn needs_networks(&self) -> bool {
        matches!(
            self.command,
            Command::Demo(_)
                | Command::Pretrain(_)
                | Command::Finetune(_)
                | Command::Predict(_)
                | Command::Generate(_)
                | Command::Bench(_)
        )
    }

    /// Runs the command.
    ///
    /// *Errors*: whatever kept it from doing its work, with the file or part at fault.
    pub fn execute(self, registries: &Registries) -> Result<Outcome> {
        threads::build_pool(self.threads)?;
        match self.command {
            Command::Demo(args) => commands::demo::run(&args, registries),
            Command::List { json } => commands::list::run(registries, json),
            Command::Inspect(args) => commands::inspect::run(&args),
            Command::Score(args) => commands::score::run(&args),
            Command::Draw(args) => commands::draw::run(&args),
            Command::Convert(args) => commands::convert::run(&args),
            Command::Scenes(args) => commands::scenes::run(&args),
            Command::Pretrain(args) => commands::pretrain::run(&args, registries),
            Command::Finetune(args) => commands::finetune::run(&args, registries),
            Command::Predict(args) => commands::predict::run(&args, registries),
            Command::Generate(args) => commands::generate::run(&args, registries),
            Command::Bench(BenchCommand::Speed(args)) => commands::bench_speed::run(&args),
            Command::Bench(BenchCommand::OpenLoop(args)) => commands::bench_open_loop::run(&args, registries),
            Command::Bench(BenchCommand::Prediction(args)) => {
                commands::bench_prediction::run(&args, registries)
            }
            Command::Completions { shell } => commands::completions::run(shell),
        }
    }
}
