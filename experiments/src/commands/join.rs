//! `sage join`: completes the folder of a run from its shards.

use std::{io, path::Path};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Parser as _;
use sage_run::{
    Outcome, io_causes,
    output::{self, Extent, RECORD},
    progress,
};

use super::{bench_study, convert, generate, rate, search, simulate};
use crate::{
    Registries,
    cli::{Cli, Command, JoinArgs},
};

/// Runs the command that the folder records, as the join of its shards.
pub(crate) fn run(args: &JoinArgs, registries: &Registries) -> Result<Outcome> {
    let folder = args.folder.display().to_string();
    let command = recorded_command(&args.folder)?;
    progress::say(&format!("$ {command}"));
    let mut words = shlex::split(&command).with_context(|| format!("`{RECORD}` in `{folder}` is damaged"))?;
    ensure!(words.len() > 1, "`{RECORD}` in `{folder}` is damaged: its command is `{command}`");
    output::stand_for(words[1..].to_vec());
    // After the name of the command, because `--` may end its options.
    words.splice(2..2, ["--out".to_owned(), folder.clone()]);
    let no_such = || format!("`{folder}` was not begun by this version of sage: its command is `{command}`");
    let joined = match Cli::try_parse_from(&words).with_context(no_such)?.command {
        Command::Generate(args) => generate::run(&args, Extent::Join, &registries.parts),
        Command::Simulate(args) => simulate::run(&args, Extent::Join, &registries.parts),
        Command::Search(args) => search::run(&args, Extent::Join, &registries.parts),
        Command::Rate(args) => rate::run(&args, Extent::Join, &registries.parts),
        Command::Convert(args) => convert::run(&args, Extent::Join),
        Command::Bench(args) if args.command.is_none() => {
            bench_study::run(&args.study, Extent::Join, registries)
        }
        _ => bail!("`{folder}` has no shards: it is of `{command}`"),
    };
    joined.map_err(|error| {
        let is_missing = io_causes(error.as_ref()).any(|cause| cause.kind() == io::ErrorKind::NotFound);
        // What is missing in the folder itself is told by its name.
        match is_missing && !format!("{error:#}").contains(&folder) {
            true => error.context(format!("run `sage join` in the folder from which `{command}` was run")),
            false => error,
        }
    })
}

/// The command that began a folder.
///
/// *Errors*: the folder holds no run.
pub(super) fn recorded_command(folder: &Path) -> Result<String> {
    let none = || format!("`{}` holds no run of a command: there is no `{RECORD}` of one", folder.display());
    let record = output::record_of(folder)?.with_context(none)?;
    let command = record["full_command"].as_str().or_else(|| record["command"].as_str());
    command.filter(|command| command.starts_with("sage ")).map(str::to_owned).with_context(none)
}
