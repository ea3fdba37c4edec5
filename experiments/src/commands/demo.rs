//! `sage demo`: generates procedural scenes and attacks them at five aggressions.
//!
//! It is two ordinary commands, so it shows what they do, and nothing else has to be kept true.

use advsage::Registries;
use anyhow::{Result, bail};
use clap::Parser;
use sage_run::{
    Outcome,
    output::{Extent, Folder},
    progress,
};

use super::{generate, scenes};
use crate::cli::{Cli, Command, DemoArgs};

/// Six scenes of each kind.
const SCENES: &str = "42";
/// Aggressions of the sweep.
const AGGRESSIONS: &str = "0:1:0.25";

pub(crate) fn run(args: &DemoArgs, registries: &Registries) -> Result<Outcome> {
    let folder = Folder::make(&args.out, args.force)?;
    let inner = |name: &str| folder.inner(name.as_ref()).map(|path| path.display().to_string());
    let (unchanged, attacked, seed) = (inner("scenes")?, inner("attacks")?, args.seed.to_string());
    // Both are ordinary commands, so what the demo shows is what they do.
    let make = ["scenes", "--count", SCENES, "--seed", &seed, "--out", &unchanged];
    let attack = [
        "generate",
        &unchanged,
        "--aggression",
        AGGRESSIONS,
        "--format",
        "rows",
        "--quiet",
        "--out",
        &attacked,
    ];
    let run = |command: &[&str]| {
        progress::say(&format!("$ sage {}", command.join(" ")));
        let force = if args.force || folder.is_begun() { &["--force"][..] } else { &[] };
        let words = [&["sage"], command, force].concat();
        match Cli::try_parse_from(words)?.command {
            Command::Scenes(args) => scenes::run(&args),
            Command::Generate(args) => generate::run(&args, Extent::Whole, registries),
            _ => bail!("the demo has no such command"),
        }
    };
    run(&make)?;
    let outcome = run(&attack)?;
    folder.finish()?;
    Ok(outcome)
}
