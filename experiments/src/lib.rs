//! The command line of `sage` as a library. A program of your own can offer it with additional
//! parts: build [`Registries`], add entries, and pass them to [`run`].
//!
//! - `cli`: arguments. `commands`: one file per command. `dispatch`: which command runs.
//!
//! What a command does with many scenes is in `sage_run`, what it shows in `sage_view`, and what attacks and drives in `advsage`.
//!
//! ```no_run
//! use experiments::Registries;
//!
//! fn main() -> std::process::ExitCode {
//!     experiments::run(|| {
//!         let registries = Registries::shipped()?;
//!         // registries.parts.rewards = registries.parts.rewards.with::<MyReward>()?;
//!         Ok(registries)
//!     })
//! }
//! ```

mod candidates;
mod cli;
mod commands;
mod dispatch;
mod junit;
mod threads;

use std::{io, process::ExitCode};

use advsage::as_cause;
use anyhow::Result;
use sage_core::{Error, defect};
use sage_run::{causes, io_causes, outcome, progress};

pub use advsage::operating_point::{OperatingPointSpec, RowKey};
pub use cli::Cli;
pub use sage_bench::Registries;
pub use sage_run::Outcome;

/// Runs the command line of this process. Exit codes: 0 all is done, 2 wrong usage, 65 done
/// but scenes are bad, 70 a scene met a defect of this program, 74 an input or output error that another try may pass, 1
/// anything else.
pub fn run(registries: impl FnOnce() -> Result<Registries, Error>) -> ExitCode {
    let cli = match Cli::read() {
        Ok(cli) => cli,
        Err(error) => return print_usage(&error),
    };
    if let Some(code) = cli.needs_networks().then(threads::restart_without_candle_threads).flatten() {
        return code;
    }
    sage_run::signals::clean_up_when_stopped();
    let outcome = outcome::caught(|| cli.execute(&registries()?));
    if defect::count() > 0 {
        if let Err(error) = outcome {
            progress::say(&format!("error: {error:#}"));
        }
        return Outcome::Defect.into();
    }
    match outcome {
        Ok(outcome) => outcome.into(),
        // The reader closed the pipe, as `head` does: not a failure.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if error.is::<clap::Error>() => {
            error.downcast_ref().map_or(ExitCode::FAILURE, print_usage)
        }
        Err(error) => {
            progress::say(&format!("error: {error:#}"));
            outcome::code_of(error.as_ref()).into()
        }
    }
}

/// Prints a usage error to stderr, or the requested help to stdout.
fn print_usage(error: &clap::Error) -> ExitCode {
    if error.use_stderr() {
        // The message repeats arguments, which may hold control characters; `say` escapes them.
        progress::say_lines(error.render().to_string().trim_end());
        return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
    }
    match error.print() {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let json = causes(error.as_ref()).filter_map(as_cause::<serde_json::Error>);
    let mut kinds = json
        .filter_map(serde_json::Error::io_error_kind)
        .chain(io_causes(error.as_ref()).map(io::Error::kind));
    kinds.any(|kind| kind == io::ErrorKind::BrokenPipe)
}

/// Compiles the code examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_runs_are_found_within_what_was_done() {
        let bad = sage_run::Error::BadScenes(Box::new(sage_run::Error::Refused("no scene".to_owned())));
        let error = anyhow::Error::from(bad).context("the study");
        assert_eq!(outcome::code_of(error.as_ref()), Outcome::BadScenes.code());
        assert_eq!(format!("{error:#}"), "the study: no scene");
        let closed = sage_run::Error::from(io::Error::from(io::ErrorKind::BrokenPipe));
        assert!(is_broken_pipe(&anyhow::Error::from(closed).context("the table")));
    }
}
