//! `sage generate` for a program of another name, such as a module of an interpreter: the same options, files and exit codes.

use std::path::Path;

use advsage::Registries;
use clap::Parser;
use sage_run::{
    outcome::code_of,
    output::{self, Part},
    progress,
};

use crate::{cli::GenerateArgs, commands::generate, signals, threads};

#[derive(Parser)]
#[command(name = "sage generate", max_term_width = 100)]
struct Job {
    #[command(flatten)]
    args: GenerateArgs,
    /// Number of threads (default: all cores); results do not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Complete the folder from its shards; work on no scene.
    #[arg(long, conflicts_with = "shard")]
    join: bool,
}

/// Runs `sage generate` with these arguments, which do not hold its name, and returns its exit code. `program` is the file whose
/// content identifies the program: a run is resumed by the same one. The process should run nothing else.
pub fn run(arguments: &[String], program: &Path, registries: &Registries) -> u8 {
    let words = std::iter::once("sage generate").chain(arguments.iter().map(String::as_str));
    let job = match Job::try_parse_from(words) {
        Ok(job) => job,
        Err(error) => {
            let is_help = !error.use_stderr();
            progress::say_lines(error.render().to_string().trim_end());
            return if is_help { 0 } else { 2 };
        }
    };
    output::identify_by(program);
    let own = arguments.iter().filter(|word| *word != "--join").cloned();
    output::stand_for(std::iter::once("generate".to_owned()).chain(own).collect());
    signals::clean_up_when_stopped();
    let part = if job.join { Part::Join } else { Part::of(job.args.shard) };
    let done = threads::build_pool(job.threads).and_then(|()| generate::run(&job.args, part, registries));
    match done {
        Ok(outcome) => outcome.code(),
        Err(error) => {
            progress::say(&format!("error: {error:#}"));
            code_of(&error)
        }
    }
}
