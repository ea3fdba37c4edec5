//! Arguments of the commands for large jobs: those that look at the shards of a run, join them, and print scripts that
//! run them.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::help::JOB;

/// Say what is done of a run, and how to finish it.
///
/// Reads the manifests in the output folder of `generate`, `simulate`, `search`, `convert` or a study, and checks that the
/// files they name are there. The exit status is that of the run: 0 if it is complete, 65 if it is complete but scenes are
/// bad, 74 if scenes are missing or the shards are not joined yet, and 1 if a manifest contradicts the files.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage status attacked/
  sage status attacked/ --json | jq -r '.bad[].scene'
  while sage status attacked/; [ $? = 74 ]; do sleep 60; done")]
pub(crate) struct StatusArgs {
    /// Output folder of a run.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Also read all files of scenes and compare their hashes.
    #[arg(long)]
    pub verify: bool,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// Complete the folder of a run from its shards: summary, report, one manifest.
///
/// Computes nothing again: the folder gets the bytes that one run without --shard leaves. Run it where the shards were
/// run, with the same program, when all of them are done (`sage status`).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sage join attacked/")]
pub(crate) struct JoinArgs {
    /// Output folder of the shards.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Print a script that runs the shards of a command on a cluster.
///
/// `slurm` prints an array script, `kubernetes` an Indexed Job (Kubernetes 1.33 or later). COMMAND is a command of `sage`
/// that has --shard, without the word `sage` and without --shard. A shard is tried again only where that can help: after an
/// input or output error (exit status 74), or if its node failed. `docs/large-jobs.md` describes the rest.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage jobs slurm --shards 200 -- generate scenes/ --format rows \\
      --no-pages --out attacked/ > job.sh && bash job.sh
  sage jobs kubernetes --shards 200 --image registry/sage:1 --claim scenes \\
      -- search scenes/ --ego idm --out failures/ > job.yaml")]
pub(crate) struct JobsArgs {
    /// Scheduler.
    #[arg(value_enum)]
    pub scheduler: Scheduler,
    /// Number of shards.
    #[arg(long, help_heading = JOB, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub shards: u32,
    /// Most shards that run at the same time.
    #[arg(long, help_heading = JOB, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub at_once: u32,
    /// Cores of a shard.
    #[arg(long, help_heading = JOB, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub cores: u16,
    /// Memory of a shard, GiB.
    #[arg(long, help_heading = JOB, value_name = "GIB", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub memory: u16,
    /// Time limit of a shard, minutes.
    #[arg(long, help_heading = JOB, value_name = "MIN", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub minutes: u32,
    /// How often a shard is tried again; Slurm counts what it requeues for other reasons too.
    #[arg(long, help_heading = JOB, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=100))]
    pub retries: u8,
    /// Program that the job runs.
    #[arg(long, help_heading = JOB, value_name = "PATH", default_value = "sage")]
    pub program: String,
    /// Container image that holds the program, for `kubernetes`.
    #[arg(long, help_heading = JOB, value_name = "NAME", required_if_eq("scheduler", "kubernetes"))]
    pub image: Option<String>,
    /// Persistent volume claim with inputs and outputs, for `kubernetes`: the working directory of the command.
    #[arg(long, help_heading = JOB, value_name = "NAME", required_if_eq("scheduler", "kubernetes"))]
    pub claim: Option<String>,
    /// The command.
    #[arg(last = true, required = true, value_name = "COMMAND")]
    pub command: Vec<String>,
}

/// A scheduler of jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Scheduler {
    /// An array script.
    Slurm,
    /// An Indexed Job.
    Kubernetes,
}
