//! Arguments of the search for evasive manoeuvres.

use clap::Args;
use sage_sim::avoidable::AvoidanceOptions;

/// Search for evasive manoeuvres.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct AvoidableArgs {
    /// Search whether a driver could have avoided each attack, and how late. Options as JSON, such as
    /// '{"refinement": 2}' or '{"lateral": 4}', or the word `comfortable` for nuPlan's limits of comfort. `generate` and `search` always
    /// search; there this sets the options.
    #[arg(long, value_name = "JSON", num_args = 0..=1, default_missing_value = "{}")]
    pub avoidable: Option<AvoidanceOptions>,
}

impl AvoidableArgs {
    /// The options of the search, if it was asked for.
    pub(crate) fn options(&self) -> Option<AvoidanceOptions> {
        self.avoidable
    }
}
