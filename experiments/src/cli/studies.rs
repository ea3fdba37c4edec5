//! Arguments of `sage bench STUDY`.

use std::path::PathBuf;

use advsage::{driver_spec::DriverSpecs, operating_point::GivenPoints};
use clap::Args;
use sage_data::dataset::Shard;

use super::{
    Cli, FolderArgs, MOST_PROCEDURAL, PlannerArgs, SplitArgs,
    attacking::FeasibilityArgs,
    avoiding::AvoidableArgs,
    help::{ATTACK, DRIVER, OUTPUT, RUN, SCENE, SELECTION, STUDY},
};

/// Run a study: measure what it names over its axes, and report it.
///
/// STUDY is the name of a shipped study (`sage bench list`) or a file (YAML); `docs/benchmarks.md` shows how to write
/// one. Everything is checked before the first scene is read. Options replace axes of the study, and --set any field.
///
/// The output folder gets `table.md`, `estimates.csv` (each metric with its 95 % interval), `rows.csv` (one row per
/// method, scene and metric), the charts of the study, and `study.json`, from which `sage bench report` renders the
/// report again. The same command resumes an interrupted run. If a scene fails, it is named and counted, the others
/// continue, and the exit status is 65.
#[derive(Debug, Args)]
pub(crate) struct StudyArgs {
    /// Study: a name from `sage bench list`, or a YAML file.
    #[arg(required = true, value_name = "STUDY")]
    pub study: Option<String>,
    /// Scene files and folders; without any, procedural scenes, if the study allows them.
    #[arg(value_name = "SCENES")]
    pub paths: Vec<PathBuf>,
    /// Further scene files and folders, the same as SCENES.
    #[arg(long, help_heading = SCENE, value_name = "DIR")]
    pub data: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    #[command(flatten)]
    pub axes: AxisArgs,
    #[command(flatten, next_help_heading = SELECTION)]
    pub avoidable: AvoidableArgs,
    /// Replace a field of the study, such as latest_start=1,2 or 'metrics={"trajectory": ["*"]}'; may be repeated.
    #[arg(long, help_heading = STUDY, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Number of procedural scenes, if no SCENES are given.
    #[arg(long, help_heading = SCENE, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_PROCEDURAL))]
    pub procedural: Option<u64>,
    /// Measure only the scenes of shard K of N. Several machines can write all shards into one folder; `sage join` writes
    /// its report.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    /// Print all columns.
    #[arg(long, help_heading = OUTPUT)]
    pub wide: bool,
    #[command(flatten)]
    pub folder: OutArgs,
}

/// Output folder; optional, so that the subcommands of `bench` need none.
#[derive(Debug, Args)]
#[command(next_help_heading = OUTPUT)]
pub(crate) struct OutArgs {
    /// Output folder.
    #[arg(long, required = true, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into a folder that is not empty; an interrupted run there restarts from the beginning.
    #[arg(long)]
    pub force: bool,
}

/// Axes of a study that commands spell alike. Each replaces the study's own.
#[derive(Debug, Args)]
#[command(next_help_heading = ATTACK)]
pub(crate) struct AxisArgs {
    /// Comma-separated generators; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES")]
    pub method: Option<String>,
    /// Comma-separated driving policies; `sage list` shows them. path:FILE is a drive of your own planner, and
    /// py:MODULE:CLASS or 'cmd:COMMAND' your own planner, a class of Python or a program, which takes the rest of the text.
    /// NAME=POLICY gives it a name in rows and tables. May be repeated.
    #[arg(long, help_heading = DRIVER, value_name = "POLICIES")]
    pub ego: Vec<DriverSpecs>,
    /// Drive the unchanged scenes alone.
    #[arg(long, conflicts_with_all = ["method", "lambda", "mu", "aggression", "mix"])]
    pub unattacked: bool,
    /// Comma-separated mergers; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES")]
    pub merger: Option<String>,
    /// Comma-separated weights: procedural, waymo, waymo-paper, waymo-literal, folders, or ARM=FOLDER, where several folders of one arm
    /// are its training seeds.
    #[arg(long, value_name = "NAMES")]
    pub weights: Vec<String>,
    /// Objective that selects one of the candidates: its name in `sage list`, or a JSON file.
    #[arg(long, help_heading = SELECTION, value_name = "NAME")]
    pub selection: Option<String>,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    /// Interpolation weight lambda: a number, a comma-separated list, or FROM:TO:STEP.
    #[arg(long, value_name = "L", allow_hyphen_values = true)]
    pub lambda: Option<String>,
    /// Weight mu of the selection, 0 (realism) to 1 (attack), at every lambda.
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    pub mu: Option<String>,
    /// Aggression, 0 to 1, in place of lambda; same form.
    #[arg(long, value_name = "A", allow_hyphen_values = true)]
    pub aggression: Option<String>,
    /// Weights of the experts by name, in place of lambda: realistic=0.5,adversarial=0.3,lawful=0.2.
    #[arg(long, value_name = "NAME=W,...")]
    pub mix: Option<String>,
    /// Comma-separated latest starts that are aimed at, seconds before the contact.
    #[arg(long, help_heading = SELECTION, value_name = "TIMES")]
    pub latest_start: Option<String>,
    /// Comma-separated radii of the suppression among predictions, metres.
    #[arg(long, help_heading = STUDY, value_name = "M")]
    pub radius: Option<String>,
    /// Comma-separated runs of `sage train-ego`, as NAME=FOLDER.
    #[arg(long, help_heading = STUDY, value_name = "RUNS")]
    pub runs: Option<String>,
    /// Number of untrained policies, the floor.
    #[arg(long, help_heading = STUDY, value_name = "N")]
    pub untrained: Option<u64>,
    /// Run that the tests of the study compare with every other run.
    #[arg(long, help_heading = STUDY, value_name = "NAME")]
    pub tested: Option<String>,
    /// Seed of random numbers.
    #[arg(long, help_heading = RUN, value_name = "S")]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub planner: PlannerArgs,
}

impl AxisArgs {
    /// Refuses operating points that exclude each other.
    ///
    /// *Errors*: wrong usage.
    pub(crate) fn check(&self) -> Result<(), clap::Error> {
        let [lambda, mu, aggression, mix] =
            [&self.lambda, &self.mu, &self.aggression, &self.mix].map(Option::is_some);
        GivenPoints { lambda, mu, aggression, mix }.check().map_err(|problem| Cli::conflict(&problem))
    }

    /// The axes that are given, as assignments to a study.
    pub(crate) fn assignments(&self) -> Vec<String> {
        let axes = [
            ("method", &self.method),
            ("merger", &self.merger),
            ("selection", &self.selection),
            ("lambda", &self.lambda),
            ("mu", &self.mu),
            ("aggression", &self.aggression),
            ("latest_start", &self.latest_start),
            ("radius", &self.radius),
            ("runs", &self.runs),
        ];
        let given = axes.into_iter().filter_map(|(name, value)| Some(format!("{name}={}", value.as_ref()?)));
        let weights = (!self.weights.is_empty()).then(|| format!("weights={}", self.weights.join(",")));
        let rule = self.rule.feasibility.as_ref().map(|rule| format!("feasibility={rule}"));
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        let untrained = self.untrained.map(|count| format!("untrained={count}"));
        let mix = self.mix.as_ref().map(|mix| {
            let weights = mix.split(',').map(|part| part.replacen('=', ": ", 1));
            format!("mix=[{{{}}}]", weights.collect::<Vec<_>>().join(", "))
        });
        given.chain(rule).chain(weights).chain(seed).chain(untrained).chain(mix).collect()
    }

    /// The drivers that are given, in place of those of a study.
    pub(crate) fn drivers(&self) -> Option<Vec<String>> {
        let all = self.ego.iter().flat_map(|DriverSpecs(parts)| parts);
        (!self.ego.is_empty()).then(|| all.map(|part| self.planner.applied(part).spelled()).collect())
    }
}

/// Render the report of a study again, from one folder or joined from several.
///
/// Nothing is measured. The scenes of several folders come one after another. All must be of the same methods and metrics.
/// Shards of one run are joined by `sage join`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage bench report monday/ tuesday/ --out both/")]
pub(crate) struct ReportArgs {
    /// Folders that `sage bench STUDY` wrote.
    #[arg(required = true, value_name = "DIR")]
    pub folders: Vec<PathBuf>,
    /// Render as this study says, a name or a file, instead of the one that was run.
    #[arg(long, value_name = "STUDY")]
    pub study: Option<String>,
    /// Print all columns.
    #[arg(long)]
    pub wide: bool,
    #[command(flatten)]
    pub folder: FolderArgs,
}
