//! `sage jobs`: prints a script that runs the shards of a command on a cluster.

use std::path::Path;

use anyhow::Result;
use clap::{Parser as _, error::ErrorKind};
use sage_data::dataset::Shard;
use sage_run::{
    Outcome,
    output::{self, quoted},
};

use crate::cli::{Cli, Command, JobsArgs, Scheduler};

const SLURM: &str = include_str!("jobs/slurm.sh");
const KUBERNETES: &str = include_str!("jobs/kubernetes.yaml");

/// Most indices of an Indexed Job.
const MOST_INDICES: u32 = 100_000;

pub(crate) fn run(args: &JobsArgs) -> Result<Outcome> {
    let words: Vec<&str> = std::iter::once("sage").chain(args.command.iter().map(String::as_str)).collect();
    let sharded = Sharded::of(Cli::try_parse_from(words)?)?;
    if args.scheduler == Scheduler::Kubernetes && args.shards > MOST_INDICES {
        return Err(misused(format!(
            "an Indexed Job has at most {MOST_INDICES} indices; give fewer --shards"
        )));
    }
    output::print(&script(args, &sharded))?;
    Ok(Outcome::Done)
}

/// What a script needs to know of a command.
struct Sharded {
    name: &'static str,
    out: String,
}

impl Sharded {
    /// Takes a command that can be run in shards.
    ///
    /// *Errors*: it cannot, or has options that the shards give.
    fn of(cli: Cli) -> Result<Self> {
        let threads = cli.threads;
        let (name, shard, force, out): (_, Option<Shard>, bool, &Path) = match &cli.command {
            Command::Generate(args) => ("generate", args.shard, args.folder.force, &args.folder.out),
            Command::Simulate(args) => ("simulate", args.shard, args.folder.force, &args.folder.out),
            Command::Search(args) => ("search", args.shard, args.folder.force, &args.folder.out),
            Command::Convert(args) => ("convert", args.shard, args.folder.force, &args.folder.out),
            Command::Bench(args) if args.command.is_none() => {
                let study = &args.study;
                (
                    "bench",
                    study.shard,
                    study.folder.force,
                    study.folder.out.as_deref().unwrap_or(Path::new("")),
                )
            }
            _ => {
                let problem =
                    "only generate, simulate, search, convert and studies (bench STUDY) have shards";
                return Err(misused(problem.to_owned()));
            }
        };
        if shard.is_some() || threads.is_some() {
            return Err(misused("the job gives --shard and --threads; leave them out".to_owned()));
        }
        if force {
            let out = out.display();
            return Err(misused(format!(
                "a shard cannot begin anew for the others; remove `{out}` instead of --force"
            )));
        }
        Ok(Self { name, out: quoted(out.display().to_string()) })
    }
}

/// An error of wrong usage.
fn misused(problem: String) -> anyhow::Error {
    clap::Error::raw(ErrorKind::ArgumentConflict, format!("{problem}\n")).into()
}

/// The script for a scheduler.
fn script(args: &JobsArgs, sharded: &Sharded) -> String {
    let program = quoted(args.program.clone());
    let words: Vec<String> = args.command.iter().cloned().map(quoted).collect();
    let command = format!("{program} {}", words.join(" "));
    let join = format!("{program} join {} --threads {}", sharded.out, args.cores);
    // Jobs of different commands have different names.
    let hash = &blake3::hash(format!("{command} {}", args.shards).as_bytes()).to_hex()[..6];
    let shards = args.shards;
    let comment = format!("`{}` in {shards} shards, as `sage jobs` prints it.", command.replace('\n', " "));
    let (template, command, join) = match args.scheduler {
        Scheduler::Slurm => (SLURM, command, join),
        Scheduler::Kubernetes => {
            let threads = args.cores;
            let shard = format!("\"$((JOB_COMPLETION_INDEX + 1))/{shards}\"");
            let command = format!("exec {command} --threads {threads} --shard {shard}");
            (KUBERNETES, yaml(&dollars(&command)), yaml(&dollars(&format!("exec {join}"))))
        }
    };
    let values = [
        ("@COMMENT@", comment),
        ("@NAME@", format!("sage-{}-{hash}", sharded.name)),
        ("@OUT@", sharded.out.replace('\n', " ")),
        ("@SHARDS@", shards.to_string()),
        ("@AT_ONCE@", args.at_once.min(shards).to_string()),
        ("@CORES@", args.cores.to_string()),
        ("@MEMORY@", args.memory.to_string()),
        ("@MINUTES@", args.minutes.to_string()),
        ("@SECONDS@", (60 * u64::from(args.minutes)).to_string()),
        ("@RETRIES@", args.retries.to_string()),
        ("@IMAGE@", yaml(args.image.as_deref().unwrap_or_default())),
        ("@CLAIM@", yaml(args.claim.as_deref().unwrap_or_default())),
        ("@JOIN@", join),
        ("@COMMAND@", command),
    ];
    filled(template, &values)
}

/// A template with its values. A value that holds the name of another is not filled again.
fn filled(template: &str, values: &[(&str, String)]) -> String {
    let mut text = String::new();
    let mut rest = template;
    while let Some(start) = rest.find('@') {
        let (before, from) = rest.split_at(start);
        text += before;
        let value = values.iter().find(|(name, _)| from.starts_with(name));
        let (added, length) = value.map_or(("@", 1), |(name, value)| (value.as_str(), name.len()));
        text += added;
        rest = &from[length..];
    }
    text + rest
}

/// A string in YAML: JSON's form is one of YAML's.
fn yaml(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// The command of a container in which nothing is replaced: Kubernetes reads `$(NAME)` as a variable and `$$` as `$`.
fn dollars(command: &str) -> String {
    command.replace('$', "$$")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_not_filled_again() {
        let values = [("@A@", "@B@ x@y".to_owned()), ("@B@", "b".to_owned())];
        assert_eq!(filled("@A@ @B@ @C", &values), "@B@ x@y b @C");
    }
}
