//! Arguments of the commands that make adversarial scenes and compare generators.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use sage_core::generator::Mixture;
use sage_data::dataset::Shard;
use sage_generators::Aggression;
use sage_merging::Range;

use super::{FolderArgs, MOST_PROCEDURAL, SplitArgs};
use crate::{
    operating_point::{OperatingPointSpec, aggression_variant},
    part::{Part, Parts},
};

/// Make adversarial scenes: the adversary drives something else than it did, the rest stays.
///
/// Lambda mixes the realistic (0) and the adversarial (1) expert and weighs what the choice prefers, 1
/// by default; several make a sweep, with one picture of all. Each scene comes out as native file, MetaDrive
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
    pub method: Part,
    /// Its options as JSON, as `sage list` names them: '{"candidates": 64}'. The same as
    /// --method 'sage{"candidates": 64}'.
    #[arg(long, value_name = "JSON")]
    pub options: Option<String>,
    #[command(flatten)]
    pub points: OperatingPointArgs,
    /// What the choice among candidates makes large: an objective by name, as `sage list` shows them, or a
    /// JSON file.
    #[arg(long, value_name = "NAME", default_value = "natural")]
    pub selection: String,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
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
    /// Print one JSON object for each scene and operating point.
    #[arg(long)]
    pub json: bool,
    /// Scene files to write: MetaDrive pickles, native files, or both.
    #[arg(long, value_enum, default_value_t = DatasetFormat::Both)]
    pub format: DatasetFormat,
    /// Attack only the K-th of N parts of the scenes, for runs on several machines into one folder.
    #[arg(long, value_name = "K/N")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Formats of the scene files of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DatasetFormat {
    /// Both.
    Both,
    /// MetaDrive pickles with the data set's summary and mapping.
    Pickle,
    /// Native files (safetensors).
    Native,
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
    #[arg(required_unless_present = "data", value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// The same as an option.
    #[arg(long, value_name = "DIR")]
    pub data: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Generators, with commas; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES", default_value = "sage,prior,most-likely,random,oracle,cat,rule,log")]
    pub methods: Parts,
    #[command(flatten)]
    pub points: OperatingPointArgs,
    /// What the choice among candidates makes large: an objective by name or a JSON file.
    #[arg(long, value_name = "NAME", default_value = "paper-selection")]
    pub selection: String,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    /// Weights with experts: procedural, waymo or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Fit the even dial of some experts: for each aggression the weight of the choice at which the attack
/// rate lies on a straight line.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage calibrate scenes/ dev-scenes/ --splits splits.json --without-split train --weights experts/ --out experts/dial.json"
)]
pub(crate) struct CalibrateArgs {
    /// Scene files and folders; procedural scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Number of procedural scenes if no path is given.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Weights with experts: procedural, waymo or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Selections to fit a dial for, with commas: objectives by name, or JSON files.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "natural,paper-selection")]
    pub selection: Vec<String>,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    #[command(flatten)]
    pub merging: MergerArgs,
    /// Seed of candidates, and of procedural scenes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Overwrite it.
    #[arg(long)]
    pub force: bool,
}

/// Measure how the dial steers: attack rates along it, how even they are, and what lambda and mu each
/// bring.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage bench dial target/data/womd_cat500/val --weights waymo --out dial/")]
pub(crate) struct DialBenchArgs {
    /// Scene files and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Weights with experts and their dial: procedural, waymo or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// What the choice among candidates makes large: an objective by name or a JSON file.
    #[arg(long, value_name = "NAME", default_value = "natural")]
    pub selection: String,
    #[command(flatten)]
    pub rule: FeasibilityArgs,
    #[command(flatten)]
    pub merging: MergerArgs,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Where the dials are put, for every command that turns them.
#[derive(Clone, Debug, Args)]
pub(crate) struct OperatingPointArgs {
    /// Where between the experts: a number, several with commas, or from:to:step.
    #[arg(long, value_name = "L", value_parser = values, allow_hyphen_values = true)]
    pub lambda: Option<Values>,
    /// Weight mu of the selection, 0 to 1; lambda by default.
    #[arg(long, value_name = "M", value_parser = number, allow_hyphen_values = true)]
    pub mu: Option<f64>,
    /// One even dial for both, 0 to 1: the attack rate rises in proportion. Same form as --lambda.
    #[arg(long, value_name = "A", value_parser = values, allow_hyphen_values = true, conflicts_with_all = ["lambda", "mu"])]
    pub aggression: Option<Values>,
    /// Weights of any experts, by name: realistic=0.5,adversarial=0.3,lawful=0.2. Mu is the adversarial one's
    /// weight unless given.
    #[arg(long, value_name = "NAME=W,...", value_parser = mix, conflicts_with_all = ["lambda", "aggression"])]
    pub mix: Option<Mix>,
    #[command(flatten)]
    pub merging: MergerArgs,
}

/// What mixes experts, for every command that does.
#[derive(Clone, Debug, Args)]
pub(crate) struct MergerArgs {
    /// How the experts are mixed; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAME", default_value = "linear")]
    pub merger: Part,
}

impl OperatingPointArgs {
    /// Refuses values out of range, before anything is read.
    ///
    /// *Errors*: the first of them.
    pub(crate) fn check(&self, range: Range) -> Result<()> {
        for lambda in self.lambda.iter().flat_map(|values| &values.0) {
            OperatingPointSpec::at(*lambda, self.mu, range)?;
        }
        OperatingPointSpec::at(1.0, self.mu, range)?;
        if let Some(Mix(mix)) = &self.mix {
            range.check_weights(mix.len(), &Mixture::new(mix.iter().map(|(_, weight)| *weight).collect()))?;
            OperatingPointSpec::mixed(mix, self.mu)?;
        }
        Ok(self.aggression.iter().flat_map(|values| &values.0).try_for_each(|a| Aggression::check(*a))?)
    }

    /// Names of the operating points, lambda at `otherwise` if nothing is given.
    pub(crate) fn variants(&self, otherwise: &[f64]) -> Vec<String> {
        if let Some(values) = &self.aggression {
            return values.0.iter().map(|a| aggression_variant(*a)).collect();
        }
        // Checked before, so nothing is left out.
        if let Some(Mix(mix)) = &self.mix {
            return OperatingPointSpec::mixed(mix, self.mu).iter().map(OperatingPointSpec::variant).collect();
        }
        let lambdas = self.lambda.as_ref().map_or(otherwise, |values| &values.0);
        let at = |lambda: &f64| OperatingPointSpec {
            aggression: None,
            lambda: Some(*lambda),
            mix: Vec::new(),
            mu: self.mu.unwrap_or(*lambda),
        };
        lambdas.iter().map(|lambda| at(lambda).variant()).collect()
    }

    /// The operating points, lambda at `otherwise` if nothing is given.
    ///
    /// *Errors*: one out of range; no dial for these weights and this selection.
    pub(crate) fn specs(
        &self,
        dial: impl FnOnce() -> Result<Aggression>,
        range: Range,
        otherwise: &[f64],
    ) -> Result<Vec<OperatingPointSpec>> {
        if let Some(values) = &self.aggression {
            let dial = dial()?;
            return values.0.iter().map(|a| OperatingPointSpec::of(&dial, *a)).collect();
        }
        if let Some(Mix(mix)) = &self.mix {
            return Ok(vec![OperatingPointSpec::mixed(mix, self.mu)?]);
        }
        let lambdas = self.lambda.as_ref().map_or(otherwise, |values| &values.0);
        lambdas.iter().map(|lambda| OperatingPointSpec::at(*lambda, self.mu, range)).collect()
    }
}

/// Weights of experts by name.
#[derive(Clone, Debug)]
pub(crate) struct Mix(pub Vec<(String, f64)>);

fn mix(text: &str) -> std::result::Result<Mix, String> {
    let mut weights: Vec<(String, f64)> = Vec::new();
    for part in text.split(',') {
        let (name, weight) = part.split_once('=').ok_or(format!("`{part}` is not NAME=WEIGHT"))?;
        let name = name.trim();
        if weights.iter().any(|(known, _)| known == name) {
            return Err(format!("`{name}` is weighed twice"));
        }
        weights.push((name.to_owned(), number(weight)?));
    }
    Ok(Mix(weights))
}

/// What the choice among candidates makes large, for every command that makes one.
#[derive(Clone, Debug, Args)]
pub(crate) struct FeasibilityArgs {
    /// Which rule makes a candidate feasible, in place of the selection's; with options as
    /// NAME{"option": value}.
    #[arg(long, value_name = "NAME")]
    pub feasibility: Option<Part>,
}

/// One or more places of a dial.
#[derive(Clone, Debug)]
pub(crate) struct Values(pub Vec<f64>);

/// Parses a finite number.
fn number(text: &str) -> std::result::Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("`{text}` is not a finite number")),
    }
}

/// Most values of a sweep.
const MOST_VALUES: usize = 1001;

/// Parses `1`, `0,0.5,1` or `0:1:0.1`.
fn values(text: &str) -> std::result::Result<Values, String> {
    if let [from, to, step] = text.split(':').collect::<Vec<_>>()[..] {
        let [from, to, step] = [number(from)?, number(to)?, number(step)?];
        let count = (to - from) / step;
        if step == 0.0 || count < 0.0 {
            return Err(format!("the step {step} does not lead from {from} to {to}"));
        }
        if count >= MOST_VALUES as f64 {
            return Err(format!("{text} has more than {} steps", MOST_VALUES - 1));
        }
        // Rounded, so that 0.3 is 0.3 and not three times 0.1.
        let at = |k: usize| ((from + k as f64 * step) * 1e9).round() / 1e9;
        return Ok(Values((0..=(count + 1e-9) as usize).map(at).collect()));
    }
    if text.split(',').count() > MOST_VALUES {
        return Err(format!("more than {MOST_VALUES} values"));
    }
    Ok(Values(text.split(',').map(number).collect::<std::result::Result<_, _>>()?))
}
