//! Arguments of the search for evasive manoeuvres.

use advsage::latest_start;
use clap::Args;
use sage_sim::avoidable::AvoidanceOptions;

use super::number;

/// Name of the preset of comfortable limits.
const COMFORTABLE: &str = "comfortable";

/// Search for evasive manoeuvres.
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
    if !(0.0..=latest_start::LONGEST).contains(&seconds) {
        return Err(format!("{seconds} is not a time from 0 to {} seconds", latest_start::LONGEST));
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
