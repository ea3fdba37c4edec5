//! Arguments of the commands for large jobs: those that look at the shards of a run and join them.

use std::path::PathBuf;

use clap::Args;

/// Say what is done of a run, and how to finish it.
///
/// Reads the manifests in the output folder of `generate`, `simulate`, `search`, `rate`, `convert` or a study, and checks
/// that the files they name are there. The exit status is that of the run: 0 if it is complete, 65 if it is complete but scenes are
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
