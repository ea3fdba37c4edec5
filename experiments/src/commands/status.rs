//! `sage status`: what is done of a run, and how to finish it.

use std::{collections::BTreeSet, path::Path};

use anyhow::Result;
use sage_core::files::OutputLock;
use sage_data::dataset::Shard;
use sage_run::{
    Outcome,
    output::{self, Counts, Manifests, State, ranges},
    progress::count,
    terminal,
};
use serde::Serialize;

use super::join::recorded_command;
use crate::cli::StatusArgs;

/// Most scenes of a kind, and most problems, that are printed as text; JSON has all.
const MOST_PRINTED: usize = 20;
/// Most shards whose commands are printed one by one.
const MOST_COMMANDS: usize = 4;

/// What is done of a run.
#[derive(Serialize)]
struct Status {
    command: String,
    /// `null` for a run that has no manifest: it has not ended, or is of a command without scenes.
    scenes: Option<SceneCounts>,
    shards: Shards,
    bad: Vec<Reason>,
    retry: Vec<Reason>,
    left_out: Vec<Reason>,
    /// What is wrong with manifests or files.
    problems: Vec<String>,
    /// Size of the files of all finished scenes.
    bytes: u64,
    /// Time of the shards that have ended, or of the run, times their threads.
    core_seconds: Option<f64>,
    /// True if nothing is left to do: the manifest of the whole run is written, or its record says so.
    complete: bool,
    /// Commands that finish the run.
    finish: Vec<String>,
    #[serde(skip)]
    is_contradicted: bool,
}

/// Numbers of scenes by what became of them.
#[derive(Clone, Copy, Serialize)]
struct SceneCounts {
    all: usize,
    done: usize,
    left_out: usize,
    bad: usize,
    retry: usize,
    /// Not reached, or with files that are not as a manifest says.
    missing: usize,
}

#[derive(Default, Serialize)]
struct Shards {
    of: Option<u32>,
    /// Those whose manifest is there.
    ended: BTreeSet<u32>,
    /// Those with scenes that are missing or to be tried again; they may be among the ended ones.
    unfinished: BTreeSet<u32>,
    /// Those of the unfinished that a process has begun: it runs, or was killed.
    begun: BTreeSet<u32>,
}

#[derive(Serialize)]
struct Reason {
    scene: String,
    reason: String,
}

pub(crate) fn run(args: &StatusArgs) -> Result<Outcome> {
    let status = Status::of(args)?;
    match args.json {
        true => output::print(&format!("{}\n", serde_json::to_string(&status)?))?,
        false => output::print(&status.text())?,
    }
    Ok(status.outcome())
}

impl Status {
    fn of(args: &StatusArgs) -> Result<Self> {
        let folder = &args.folder;
        let command = recorded_command(folder)?;
        let record = output::record_of(folder)?.unwrap_or_default();
        let manifests = Manifests::read(folder, &output::run_hash(&record["run"]), args.verify)?;
        let locked = OutputLock::begun_shards(folder)?;
        let of = manifests.shard_count().or_else(|| locked.first().map(|[_, of]| *of));
        let unfinished = of.map(|of| manifests.unfinished_shards(of)).unwrap_or_default();
        let begun = locked.into_iter().filter(|[_, count]| Some(*count) == of).map(|[number, _]| number);
        let shards = Shards {
            of,
            ended: manifests
                .shards
                .iter()
                .map(|state| state.shard)
                .filter(|s| Some(s.of) == of)
                .map(number)
                .collect(),
            begun: begun.filter(|number| unfinished.contains(number)).collect(),
            unfinished,
        };
        let with = |state: State| -> Vec<Reason> {
            let records = manifests.scenes.iter().filter_map(|name| manifests.records.get(name));
            let reason = |record: &sage_run::output::SceneRecord| Reason {
                scene: record.scene.clone(),
                reason: record.reason.clone(),
            };
            records.filter(|record| record.state == state).map(reason).collect()
        };
        let Counts { done, left_out, bad, retry, .. } = manifests.counts();
        let (all, missing) = (manifests.scenes.len(), manifests.missing().len());
        let is_known = !manifests.scenes.is_empty();
        let is_recorded_done = !record["seconds"].is_null();
        let is_joined = manifests.is_joined && !output::has_shards(folder)?;
        let mut status = Self {
            scenes: is_known.then_some(SceneCounts { all, done, left_out, bad, retry, missing }),
            bad: with(State::Bad),
            retry: with(State::Retry),
            left_out: with(State::LeftOut),
            bytes: manifests.records.values().flat_map(|record| &record.files).map(|file| file.bytes).sum(),
            core_seconds: match manifests.shards.is_empty() {
                true => record["core_seconds"].as_f64(),
                false => {
                    Some(manifests.shards.iter().map(|shard| shard.seconds * shard.threads as f64).sum())
                }
            },
            complete: match is_known {
                true => is_joined && missing == 0 && retry == 0,
                // A run of these commands has a manifest.
                false => is_recorded_done && !has_scenes(&command),
            },
            problems: manifests.problems,
            is_contradicted: manifests.is_contradicted,
            finish: Vec::new(),
            shards,
            command,
        };
        status.finish = status.finishing(folder);
        Ok(status)
    }

    fn outcome(&self) -> Outcome {
        match () {
            () if self.is_contradicted => Outcome::NotHeld,
            () if !self.complete => Outcome::Retry,
            () if !self.bad.is_empty() => Outcome::BadScenes,
            () => Outcome::Done,
        }
    }

    /// The commands that finish the run.
    fn finishing(&self, folder: &Path) -> Vec<String> {
        let out = output::quoted(folder.display().to_string());
        let with = |options: &str| output::command_with(&self.command, &format!("--out {out}{options}"));
        if self.complete {
            return Vec::new();
        }
        let Some(of) = self.shards.of else { return vec![with("")] };
        let unfinished = &self.shards.unfinished;
        let mut all: Vec<String> = match unfinished.len() {
            0 => Vec::new(),
            1..=MOST_COMMANDS => {
                unfinished.iter().map(|number| with(&format!(" --shard {number}/{of}"))).collect()
            }
            _ => {
                let words = ranges(unfinished).split(',').map(braced).collect::<Vec<_>>().join(" ");
                vec![format!("for k in {words}; do {}; done", with(&format!(" --shard $k/{of}")))]
            }
        };
        all.push(format!("sage join {out}"));
        all
    }

    fn text(&self) -> String {
        let mut lines = vec![self.command.clone()];
        match self.scenes {
            Some(SceneCounts { all, done, left_out, bad, retry, missing }) => {
                let others = [
                    (left_out, "left out"),
                    (bad, "bad"),
                    (retry, "to be tried again"),
                    (missing, "missing"),
                ];
                let others = others.iter().filter(|(number, _)| *number > 0);
                let others: String = others.map(|(number, what)| format!(", {number} {what}")).collect();
                let end = if self.complete { "; complete" } else { "" };
                lines.push(format!("{}: {done} done{others}{end}", count(all, "scene")));
            }
            None if self.complete => lines.push("complete".to_owned()),
            None => lines.push("not complete; which scenes are done is known at its end".to_owned()),
        }
        if let Some(of) = self.shards.of {
            let Shards { ended, unfinished, begun, .. } = &self.shards;
            let named = |what: &str, numbers: &BTreeSet<u32>| match numbers.len() {
                0 => String::new(),
                some => format!(", {some} {what} ({})", ranges(numbers)),
            };
            lines.push(format!(
                "{of} shards: {} done{}{}",
                ended.difference(unfinished).count(),
                named("to be run", unfinished),
                named("of them running, or killed", begun)
            ));
        }
        if let Some(seconds) = self.core_seconds {
            let (gigabytes, hours) = (self.bytes as f64 / 1e9, seconds / 3600.0);
            let so_far = if self.complete { "" } else { "so far " };
            lines.push(format!("{so_far}{gigabytes:.3} GB and {hours:.3} core-hours"));
        }
        for problem in limited(&self.problems) {
            lines.push(format!("error: {problem}"));
        }
        for (what, reasons) in [("bad", &self.bad), ("to be tried again", &self.retry)] {
            let named = reasons.iter().map(|Reason { scene, reason }| {
                format!("{what}: {}: {reason}", terminal::escaped_name(scene))
            });
            lines.extend(limited(&named.collect::<Vec<_>>()));
        }
        if !self.finish.is_empty() {
            lines.push("to finish, in the folder where the run was begun:".to_owned());
            lines.extend(self.finish.iter().map(|command| format!("  {command}")));
        }
        lines.iter().map(|line| format!("{}\n", terminal::escaped_name(line))).collect()
    }
}

/// True for the commands whose runs end with a manifest.
fn has_scenes(command: &str) -> bool {
    let name = command.split(' ').nth(1).unwrap_or_default();
    ["generate", "simulate", "search", "convert", "bench"].contains(&name)
}

fn number(shard: Shard) -> u32 {
    shard.number
}

/// A range of numbers in the words of a shell.
fn braced(range: &str) -> String {
    range.split_once('-').map_or(range.to_owned(), |(first, last)| format!("{{{first}..{last}}}"))
}

/// The first lines, and how many more there are.
fn limited(lines: &[String]) -> Vec<String> {
    let mut shown: Vec<String> = lines.iter().take(MOST_PRINTED).cloned().collect();
    if lines.len() > MOST_PRINTED {
        shown.push(format!("and {} more; --json prints all", lines.len() - MOST_PRINTED));
    }
    shown
}
