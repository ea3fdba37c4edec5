//! Arguments of drivers that are programs.

use advsage::driver_spec::{DriverSpec, Timeouts};
use clap::Args;

use super::help::DRIVER;

/// Options of planners that are programs.
#[derive(Debug, Args)]
#[command(next_help_heading = DRIVER)]
pub(crate) struct PlannerArgs {
    /// Seconds that a planner that is a program has to answer: START,RESET,STEP for its first message, for that of
    /// a drive and for that of a step, or one number for all (default: 60,20,5).
    #[arg(long, value_name = "TIMES", allow_hyphen_values = true)]
    pub ego_timeout: Option<Timeouts>,
}

impl PlannerArgs {
    /// A policy with the times that are given.
    pub(crate) fn applied(&self, part: &DriverSpec) -> DriverSpec {
        match self.ego_timeout {
            Some(Timeouts(times)) => part.clone().with_timeouts(times),
            None => part.clone(),
        }
    }
}
