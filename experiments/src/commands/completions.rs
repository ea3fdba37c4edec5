//! `sage completions`: prints a completion script for a shell.

use anyhow::Result;
use sage_run::Outcome;

use crate::Cli;

pub(crate) fn run(shell: clap_complete::Shell) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::described(), "sage", &mut script);
    std::io::Write::write_all(&mut std::io::stdout().lock(), &script)?;
    Ok(Outcome::Done)
}
