//! `sage generate`: writes adversarial variants of scenes as a data set.

use advsage::Registries;
use anyhow::Result;
use sage_run::{Outcome, generate, output::Extent};

use crate::cli::GenerateArgs;

pub(crate) fn run(args: &GenerateArgs, extent: Extent, registries: &Registries) -> Result<Outcome> {
    Ok(generate::run(&args.options()?, extent, registries)?)
}
