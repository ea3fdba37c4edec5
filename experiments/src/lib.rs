//! The command line of `sage` as a library, so that a program of your own can offer it with parts
//! of your own: build [`Registries`], add entries, and pass them to [`run`].
//!
//! ```no_run
//! use experiments::Registries;
//!
//! fn main() -> std::process::ExitCode {
//!     experiments::run(|| {
//!         let mine = Registries::shipped()?;
//!         // mine.rewards = mine.rewards.with::<MyReward>()?;
//!         Ok(mine)
//!     })
//! }
//! ```

pub mod bench;
mod candidates;
mod cli;
mod commands;
mod dispatch;
pub mod drawing;
mod generators;
mod input;
mod networks;
mod operating_point;
mod output;
mod part;
mod progress;
mod scenes;
mod selection;
mod signals;
mod terminal;
mod threads;

use std::{io, process::ExitCode};

use anyhow::Result;
use clap::Parser;
use sage_backbones::{Backbone, backbones};
use sage_core::{
    Error,
    objective::{self, Feasibility, Reward},
    registry::Registry,
};
use sage_generators::{GeneratorKind, generators};
use sage_merging::{Merger, mergers};

pub use cli::Cli;
pub use operating_point::{OperatingPointSpec, RowKey};

/// The parts that commands can name.
pub struct Registries {
    /// Rewards and penalties.
    pub rewards: Registry<dyn Reward>,
    /// Feasibility rules.
    pub feasibilities: Registry<dyn Feasibility>,
    /// Motion prediction networks.
    pub backbones: Registry<dyn Backbone>,
    /// Ways to mix experts.
    pub mergers: Registry<dyn Merger>,
    /// Generators of adversarial scenes.
    pub generators: Registry<dyn GeneratorKind>,
}

impl Registries {
    /// All parts that `sage` ships.
    ///
    /// *Errors*: [`Error::Duplicate`] if two of a kind bear one name.
    pub fn shipped() -> Result<Self, Error> {
        Ok(Self {
            rewards: objective::rewards()?,
            feasibilities: objective::feasibilities()?,
            backbones: backbones()?,
            mergers: mergers()?,
            generators: generators()?,
        })
    }
}

/// How a command ended that could do its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All of it.
    Done,
    /// Some of it failed and was reported; the rest is done.
    Partial,
}

/// Runs the command line of this process: 0 done, 1 failed, 2 bad use.
pub fn run(registries: impl FnOnce() -> Result<Registries, Error>) -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return told(&error),
    };
    if let Some(code) = cli.needs_networks().then(threads::run_anew).flatten() {
        return code;
    }
    signals::clean_up_when_stopped();
    let outcome = registries().map_err(anyhow::Error::from).and_then(|registries| cli.execute(&registries));
    match outcome {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Partial) => ExitCode::FAILURE,
        // Whoever reads the output has seen enough.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            progress::say(&format!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

/// Says what is wrong with the command line, or the help that was asked for.
fn told(error: &clap::Error) -> ExitCode {
    if error.use_stderr() {
        // It repeats what was typed, and file names may be among that.
        progress::say(error.render().to_string().trim_end());
        return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
    }
    match error.print() {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => ExitCode::FAILURE,
        _ => ExitCode::SUCCESS,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
            || cause
                .downcast_ref::<serde_json::Error>()
                .is_some_and(|e| e.io_error_kind() == Some(io::ErrorKind::BrokenPipe))
    })
}

/// Compiles what the README shows.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;
