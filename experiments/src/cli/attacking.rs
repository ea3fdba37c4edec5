//! Arguments of the commands that generate adversarial scenes and compare generators.

use std::path::PathBuf;

use advsage::{
    AdversarySpec, PersonKind, attacked_files::AttackFormats, driver_spec::DriverSpec, latest_start,
    named_generator::GeneratorSpec, part::Part, selection::ends_near,
};
use anyhow::Result;
use clap::{Args, ValueEnum};
use sage_data::dataset::Shard;
use sage_generators::{Placement, Rate};
use sage_run::generate::GenerateOptions;
use sage_sim::search::Requirement;

use super::{
    Cli, FolderArgs, MOST_PROCEDURAL, PlannerArgs, SplitArgs,
    avoiding::AvoidableArgs,
    formats::{ScenarioArgs, attack_formats},
    help::{ATTACK, DRIVER, OUTPUT, RUN, SCENE, SELECTION},
    reading::ReadingArgs,
};

/// Generate adversarial scenes: replace the adversary's future, keep everything else.
///
/// SCENE is a scene file (MetaDrive or ScenarioNet pickle, native file, JSON of GPUDrive, scenario of Argoverse 2), a
/// TFRecord file of the Waymo Open Motion Dataset, a record of it (FILE#3), or a folder of such files. Each scene is attacked at each operating
/// point that --lambda, --aggression or --mix gives (default: lambda 1).
///
/// At the end a table says how often each operating point attacks and why it does not, and `index.html` lists all
/// scenes: each has a page that plays its attacks and a picture (SVG). The output folder is a data set that MetaDrive
/// and ScenarioNet read, unless --format excludes pickles. It holds a scene file and a JSON row per scene and operating
/// point; `sage explain` takes a row. `docs/formats.md`, section 'Data sets', describes all files.
///
/// Scenes run in parallel on all cores (see --threads). The files of a finished scene stay, so the same
/// command resumes an interrupted run, and --force starts again. If a scene fails, the error is printed and
/// the other scenes continue.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage generate examples/crossing.pkl --lambda 1 --out attacked/
  sage generate scenes/ --method sage --lambda 0:1:0.25 --out sweep/ --json
  sage generate scenes/ --lambda 1 --shard 2/8 --out dataset/
  sage generate scenes/ --lambda 1 --latest-start 1.5 --out late/
  sage generate scenes/0.pkl --ego path:drive.json --lambda 1 --out against-it/")]
pub(crate) struct GenerateArgs {
    /// Scene file, TFRecord file, record (FILE#3), or folder of them.
    pub scene: PathBuf,
    /// Generator, by its name in `sage list`.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "sage")]
    pub method: Part,
    #[command(flatten)]
    pub attack: AttackArgs,
    /// Policy that drives the ego before the attack, by its name in `sage list`; path:FILE, a drive of your own
    /// planner (JSON, [x, y, heading] for each frame); or your own planner: 'cmd:COMMAND', a program, or py:MODULE:CLASS, a
    /// class of Python. The attack is planned against this drive, which also replaces the ego's recording in the written scenes.
    #[arg(long, help_heading = DRIVER, value_name = "POLICY", default_value = "replay")]
    pub ego: DriverSpec,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Choose the most adversarial candidate whose latest evasive manoeuvre begins this many seconds before the contact (within
    /// 0.25 s), else the nearest, with a note. More candidates hold more late and early ones: --options '{"candidates": 384, "apart": 2}'.
    #[arg(long, help_heading = SELECTION, value_name = "T", value_parser = latest_start::seconds)]
    pub latest_start: Option<f64>,
    #[command(flatten, next_help_heading = SELECTION)]
    pub avoidable: AvoidableArgs,
    /// Print one JSON object per scene and operating point.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Print no line per attack, only the table at the end.
    #[arg(long, help_heading = OUTPUT, conflicts_with = "json")]
    pub quiet: bool,
    /// Write no pages and no pictures, for large runs.
    #[arg(long, help_heading = OUTPUT)]
    pub no_pages: bool,
    /// Leave the candidates that were not selected out of the rows, which then have a twentieth of their size.
    #[arg(long, help_heading = OUTPUT)]
    pub no_candidates: bool,
    /// Format of the written scenes.
    #[arg(long, help_heading = OUTPUT, default_value = "pickle", value_parser = attack_formats())]
    pub format: AttackFormats,
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Attack only the scenes of shard K of N. Several machines can write all shards into one folder,
    /// which `sage join` completes.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub folder: FolderArgs,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Explain why a scene is attacked as it is, or why there is no attack.
///
/// A scene is attacked as by `sage generate`, and no attack is written. A row of `sage generate` (JSON) is explained from its
/// candidates and its scene file, and a row of `sage search` by what came of its plans. For each operating point of a scene
/// (default: lambda 0 to 1 in quarters) it says how many candidates touch the ego, which of them are feasible and believable
/// and why the others are not, and what the selection makes of the best ones: its value is the sum of the columns to its right.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage explain examples/crossing.pkl
  sage explain scenes/7.pkl --lambda 1 --svg 7.svg
  sage explain attacked/7-lambda1.00.json --json | jq .outcome")]
pub(crate) struct ExplainArgs {
    /// Scene file, record (FILE#3), or row: SCENE-VARIANT.json of `sage generate`, SCENE.json of `sage search`.
    #[arg(value_name = "SCENE|ROW")]
    pub scene: PathBuf,
    /// Generator, by its name in `sage list`.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "sage")]
    pub method: Part,
    #[command(flatten)]
    pub attack: AttackArgs,
    /// The scene that a row is of, if the row names no scene file beside it.
    #[arg(long, help_heading = SCENE, value_name = "FILE")]
    pub of: Option<PathBuf>,
    /// Also draw the candidates, by what they do, at the last operating point.
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Overwrite an existing SVG file.
    #[arg(long, help_heading = OUTPUT, requires = "svg")]
    pub force: bool,
    /// Print one JSON object per operating point.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// How to attack a scene, besides the generator.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = ATTACK)]
pub(crate) struct AttackArgs {
    #[command(flatten)]
    pub generator: GeneratorSpec,
    /// Select the feasible plan that ends nearest to this place, metres in the scene's frame: --selection of the reward
    /// `goal-distance`.
    #[arg(long, help_heading = SELECTION, value_name = "X,Y", value_parser = ends_near, allow_hyphen_values = true, conflicts_with_all = ["selection", "aggression"])]
    pub goal: Option<String>,
    /// Use this track as the adversary; `focal` is the one that a scenario of Argoverse 2 was recorded for.
    #[arg(long, help_heading = SCENE, value_name = "ID")]
    pub adversary: Option<String>,
    /// Attack with a person, on foot or on a bicycle: the one that --adversary names, else one who is placed beside the ego's
    /// recorded way (`docs/people.md`). Plans come from the generator `person`, and no network proposes them.
    #[arg(long, help_heading = SCENE, value_name = "TYPE", value_enum)]
    pub adversary_type: Option<PersonKind>,
    /// How a person is placed, as JSON: '{"side": "right", "beyond": 0.7, "ahead": [10, 90], "after": [2.5, 7.5], "clearance": 1.5,
    /// "parked_car": false}' are metres and seconds.
    #[arg(long, help_heading = SCENE, value_name = "JSON", value_parser = placement, requires = "adversary_type", conflicts_with = "adversary")]
    pub place: Option<Placement>,
}

/// A placement of a user.
fn placement(text: &str) -> Result<Placement, String> {
    let place: Placement = serde_json::from_str(text).map_err(|error| error.to_string())?;
    place.check()?;
    Ok(place)
}

impl AttackArgs {
    /// Who is the adversary.
    pub(crate) fn adversary(&self) -> AdversarySpec {
        AdversarySpec { id: self.adversary.clone(), kind: self.adversary_type, place: self.place }
    }

    /// What a generator is asked for; `None` for the one that the command takes by default. `require` is what a search asks for.
    ///
    /// *Errors*: points that exclude each other, or what does not apply to a person.
    pub(crate) fn spec(&self, method: Option<&Part>, require: Option<Requirement>) -> Result<GeneratorSpec> {
        self.generator.points.check().map_err(|problem| Cli::conflict(&problem))?;
        let mut spec = GeneratorSpec { method: method.cloned(), ..self.generator.clone() };
        if let Some(selection) = &self.goal {
            spec.selection.clone_from(selection);
        }
        Ok(self.adversary().generator(spec, require).map_err(|error| Cli::conflict(&format!("--{error}")))?)
    }

    /// The first option that is given and makes an attack what it is.
    pub(crate) fn first_given(&self) -> Option<&'static str> {
        let GeneratorSpec { points, options, weights, feasibility, selection, merger, method: _, seed: _ } =
            &self.generator;
        let given = [
            ("--lambda", points.lambda.is_some()),
            ("--mu", points.mu.is_some()),
            ("--aggression", points.aggression.is_some()),
            ("--mix", !points.mix.is_empty()),
            ("--options", options.is_some()),
            ("--weights", weights.is_some()),
            ("--feasibility", feasibility.is_some()),
            ("--selection", selection != "natural"),
            ("--goal", self.goal.is_some()),
            ("--merger", merger.name != "linear"),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }
}

impl GenerateArgs {
    /// The options of the run.
    ///
    /// *Errors*: as [`AttackArgs::spec`].
    pub(crate) fn options(&self) -> Result<GenerateOptions> {
        Ok(GenerateOptions {
            scene: self.scene.clone(),
            generator: self.attack.spec(Some(&self.method), None)?,
            adversary: self.attack.adversary(),
            ego: self.ego.clone(),
            ego_timeout: self.planner.ego_timeout.map(|times| times.0),
            latest_start: self.latest_start,
            avoidable: self.avoidable.options(),
            format: self.format,
            standard: self.scenario.standard,
            scenario_ego: self.scenario.scenario_ego,
            reading: self.reading.options(),
            out: self.folder.out.clone(),
            force: self.folder.force,
            json: self.json,
            quiet: self.quiet,
            no_pages: self.no_pages,
            no_candidates: self.no_candidates,
        })
    }
}

/// Fit the aggression dial of experts, so that the rate of attacks rises linearly.
///
/// At aggression a, lambda is a. The fit finds the weight mu of the selection at eleven aggressions from 0 to
/// 1, for each --selection. `--aggression` of other commands reads the result as `dial.json` in the folder of
/// the experts. Use scenes that the experts were not fine-tuned on.
///
/// With --nominal the fit is that of a temperature, the one at which the untuned prior is a calibrated density of where recorded
/// vehicles end, and of how they are timed on their way. `sage rate` reads both as `nominal.json`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage calibrate scenes/ --splits splits.json --without-split train \\
      --weights experts/ --out experts/dial.json
  sage calibrate scenes/ --nominal --weights prior/ --out prior/nominal.json")]
pub(crate) struct CalibrateArgs {
    /// Scene files and folders (default: procedural scenes).
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Number of procedural scenes if no PATH is given.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Weights of the experts: procedural, waymo, waymo-paper, waymo-literal or a folder.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Comma-separated objectives to fit a dial for: names in `sage list`, or JSON files.
    #[arg(long, help_heading = SELECTION, value_name = "NAMES", value_delimiter = ',', default_value = "natural,paper-selection,natural-adversarial")]
    pub selection: Vec<String>,
    /// Rate that rises linearly: all attacks, or believable ones (default: believable; attack for a selection
    /// under the paper's feasibility rule).
    #[arg(long, help_heading = SELECTION, value_enum, value_name = "NAME")]
    pub attack_rate: Option<RateArg>,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    #[command(flatten)]
    pub merging: MergerArgs,
    /// Fit the temperature and the timing of the prior to recorded vehicles instead of a dial.
    #[arg(long, conflicts_with_all = ["selection", "attack_rate", "feasibility", "merger"])]
    pub nominal: bool,
    /// Scenes for which coverage and timing are reported too, without a fit to them.
    #[arg(long, value_name = "PATH", requires = "nominal")]
    pub unseen: Vec<PathBuf>,
    /// Seed of candidates and of procedural scenes.
    #[arg(long, help_heading = RUN, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// JSON file to write.
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub out: PathBuf,
    /// Overwrite an existing file.
    #[arg(long, help_heading = OUTPUT)]
    pub force: bool,
}

/// A rate of attacks.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum RateArg {
    /// Share of scenes with a feasible hit of the ego.
    Attack,
    /// Share of scenes with a believable attack.
    Believable,
}

impl From<RateArg> for Rate {
    fn from(rate: RateArg) -> Self {
        match rate {
            RateArg::Attack => Self::Attack,
            RateArg::Believable => Self::Believable,
        }
    }
}

/// Merger of a command that mixes experts.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = ATTACK)]
pub(crate) struct MergerArgs {
    /// Merger of the experts, by its name in `sage list`; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAME", default_value = "linear")]
    pub merger: Part,
}

/// Feasibility rule of a command that selects candidates.
#[derive(Clone, Debug, Args)]
pub(crate) struct FeasibilityArgs {
    /// Feasibility rule, by its name in `sage list`, instead of the rule of the selection; with options as
    /// NAME{"option": value}.
    #[arg(long, help_heading = SELECTION, value_name = "NAME")]
    pub feasibility: Option<Part>,
}
