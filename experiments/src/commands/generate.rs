//! `sage generate`: writes adversarial variants of scenes as a data set.

use advsage::Registries;
use anyhow::Result;
use sage_run::{Outcome, generate, output::Part};

use crate::cli::GenerateArgs;

pub(crate) fn run(args: &GenerateArgs, part: Part, registries: &Registries) -> Result<Outcome> {
    generate::run(&args.options()?, part, registries)
}
