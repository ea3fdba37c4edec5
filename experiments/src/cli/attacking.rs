//! Arguments of the commands that make adversarial scenes and compare generators.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use sage_generators::Choice;
use sage_merging::Experts;

use super::{FolderArgs, MOST_MADE, SplitArgs};
use crate::{
    methods::{Choosing, Place},
    networks,
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
    pub method: String,
    /// Its options as JSON, as `sage list` names them: '{"candidates": 64}'.
    #[arg(long, value_name = "JSON")]
    pub options: Option<String>,
    #[command(flatten)]
    pub dial: DialArgs,
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
    #[command(flatten)]
    pub folder: FolderArgs,
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
    /// Generators, with commas.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        default_value = "sage,prior,most-likely,random,oracle,cat,rule,log"
    )]
    pub methods: Vec<String>,
    #[command(flatten)]
    pub dial: DialArgs,
    #[command(flatten)]
    pub choosing: ChoosingArgs,
    /// What the choice weighs.
    #[arg(long, value_enum, default_value_t = ChoiceArg::Paper)]
    pub choice: ChoiceArg,
    /// Let Rule read frames in which the adversary was not seen, as the published code does.
    #[arg(long)]
    pub raw: bool,
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
    /// Scene files and folders; made scenes without any.
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Number of scenes to make where no path is given.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(..=MOST_MADE))]
    pub made: u64,
    /// Weights with experts: procedural, waymo or a folder.
    #[arg(long, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Choices to fit a dial for, with commas.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "natural,paper")]
    pub choice: Vec<ChoiceArg>,
    /// Seed of candidates, and of made scenes.
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
    /// What the choice weighs.
    #[arg(long, value_enum, default_value_t = ChoiceArg::Natural)]
    pub choice: ChoiceArg,
    /// Seed.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Where the dial is put, for every command that turns it.
#[derive(Clone, Debug, Args)]
pub(crate) struct DialArgs {
    /// Where between the experts: a number, several with commas, or from:to:step.
    #[arg(long, value_name = "L", value_parser = values, allow_hyphen_values = true)]
    pub lambda: Option<Values>,
    /// Weight of the adversarial reward in the choice, 0 to 1; lambda by default.
    #[arg(long, value_name = "M", value_parser = number, allow_hyphen_values = true)]
    pub mu: Option<f64>,
    /// One even dial for both, 0 to 1: the attack rate rises in proportion. Same form as --lambda.
    #[arg(long, value_name = "A", value_parser = values, allow_hyphen_values = true, conflicts_with_all = ["lambda", "mu"])]
    pub aggression: Option<Values>,
    /// How the experts' weights are mixed.
    #[arg(long, value_name = "NAME", default_value = "linear")]
    pub merger: String,
}

impl DialArgs {
    /// Whether the user put the dial anywhere.
    pub(crate) fn is_given(&self) -> bool {
        self.lambda.is_some() || self.mu.is_some() || self.aggression.is_some()
    }

    /// Refuses values out of range, before anything is read.
    ///
    /// *Errors*: the first of them.
    pub(crate) fn check(&self) -> Result<()> {
        for lambda in self.lambda.iter().flat_map(|values| &values.0) {
            Place::at(*lambda, self.mu)?;
        }
        Place::at(1.0, self.mu)?;
        match self.aggression.iter().flat_map(|values| &values.0).find(|a| !(0.0..=1.0).contains(*a)) {
            Some(aggression) => bail!("aggression is {aggression}; expected 0 (natural) to 1"),
            None => Ok(()),
        }
    }

    /// The places, lambda at `otherwise` if neither is given.
    ///
    /// *Errors*: one out of range; no even dial for these weights and this choice.
    pub(crate) fn places(
        &self,
        weights: &str,
        experts: &Experts,
        choice: Choice,
        otherwise: &[f64],
    ) -> Result<Vec<Place>> {
        if let Some(values) = &self.aggression {
            let dial = networks::load_dial(weights, experts, choice)?;
            return values.0.iter().map(|a| Place::of(&dial, *a)).collect();
        }
        let lambdas = self.lambda.as_ref().map_or(otherwise, |values| &values.0);
        lambdas.iter().map(|lambda| Place::at(*lambda, self.mu)).collect()
    }
}

/// What the choice among candidates weighs, for every command that makes one.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct ChoosingArgs {
    /// Which rule makes a candidate feasible.
    #[arg(long, value_enum, default_value_t = FeasibilityArg::Paper)]
    pub feasibility: FeasibilityArg,
}

impl ChoosingArgs {
    /// With what is weighed beside the preference.
    pub(crate) fn with(self, choice: ChoiceArg) -> Choosing {
        Choosing { choice: choice.into(), strict: matches!(self.feasibility, FeasibilityArg::Strict) }
    }
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

/// Names of [`sage_generators::Choice`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ChoiceArg {
    /// As in the paper.
    Paper,
    /// With a little for keeping to lanes and for what cars usually do.
    Natural,
}

impl From<ChoiceArg> for Choice {
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
