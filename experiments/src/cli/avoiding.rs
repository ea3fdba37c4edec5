//! Arguments of the search for ways out of attacks.

use clap::Args;
use sage_sim::avoidable::AvoidanceOptions;

use super::attacking::{ComparisonArgs, OperatingPointArgs, number};
use crate::{part::Parts, react};

/// Name of the preset of comfortable limits.
const COMFORTABLE: &str = "comfortable";

/// Search for ways out of attacks.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct AvoidableArgs {
    /// Search whether a driver could have avoided each attack, and how late. Options as JSON, such as
    /// '{"refinement": 2}' or '{"lateral": 4}', or the word `comfortable` for nuPlan's limits of comfort
    /// (`generate` always searches, by default without options).
    #[arg(long, value_name = "JSON", num_args = 0..=1, default_missing_value = "{}", value_parser = avoidance)]
    pub avoidable: Option<AvoidanceOptions>,
}

impl AvoidableArgs {
    /// The options of the search, if it was asked for.
    pub(crate) fn options(&self) -> Option<AvoidanceOptions> {
        self.avoidable
    }
}

pub(super) fn seconds(text: &str) -> std::result::Result<f64, String> {
    let seconds = number(text)?;
    if !(0.0..=react::LONGEST).contains(&seconds) {
        return Err(format!("{seconds} is not a time from 0 to {} seconds", react::LONGEST));
    }
    Ok(seconds)
}

fn avoidance(text: &str) -> std::result::Result<AvoidanceOptions, String> {
    if text == COMFORTABLE {
        return Ok(AvoidanceOptions::comfortable());
    }
    let options: AvoidanceOptions = serde_json::from_str(text).map_err(|error| error.to_string())?;
    options.check().map_err(|error| error.to_string())?;
    Ok(options)
}

/// Measure how well `generate --react` works: the times to react that can be chosen among candidates.
///
/// Every generator attacks each scene. For each target time, the table has the share of scenes with an avoidable
/// attack whose time to react is within 0.25 s of it, and the median of the chosen times.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sage bench react target/data/womd_cat500/val --weights waymo --methods sage,random,rule --out react/"
)]
pub(crate) struct ReactArgs {
    #[command(flatten)]
    pub on: ComparisonArgs,
    /// Comma-separated generators; with options as NAME{"option": value}.
    #[arg(long, value_name = "NAMES", default_value = "sage,random,rule")]
    pub methods: Parts,
    /// Comma-separated target times, seconds.
    #[arg(long, value_name = "TIMES", value_delimiter = ',', value_parser = seconds, default_value = "0.5,1,1.5,2")]
    pub targets: Vec<f64>,
    #[command(flatten)]
    pub points: OperatingPointArgs,
    #[command(flatten)]
    pub avoidable: AvoidableArgs,
}
