//! Arguments of the commands that make adversarial scenes and compare generators.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::SplitArgs;
use crate::methods::Choosing;

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
    #[command(flatten)]
    pub split: SplitArgs,
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
