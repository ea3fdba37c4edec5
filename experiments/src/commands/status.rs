//! `sage status`: what is done of a run, and how to finish it.

use std::{collections::BTreeSet, path::Path};

use anyhow::Result;
use sage_core::files::OutputLock;
use sage_data::dataset::Shard;
use serde::Serialize;

use super::join::recorded_command;
use crate::{
    Outcome,
    cli::StatusArgs,
    output::{self, Claims, Counts, State, ranges},
    progress::count,
    terminal,
};

/// Most scenes of a kind, and most problems, that are printed as text; JSON has all.
const MOST_PRINTED: usize = 20;
/// Most shards whose commands are printed one by one.
const MOST_COMMANDS: usize = 4;

/// What is done of a run.
#[derive(Serialize)]
struct Status {
    command: String,
    #[serde(flatten)]
    counts: Counts,
    /// Scenes that were not reached, or whose files are not as a manifest says.
    missing: usize,
    /// False for a run that has no manifest: it has not ended, or is of a command without scenes.
    is_known: bool,
    /// True if the record of the run says that it is done.
    is_recorded_done: bool,
    shards: Shards,
    bad: Vec<Reason>,
    retry: Vec<Reason>,
    left_out_scenes: Vec<Reason>,
    /// What is wrong with manifests or files.
    problems: Vec<String>,
    /// Size of the files of all finished shards.
    bytes: u64,
    core_seconds: f64,
    /// True if the manifest of the whole run is written.
    joined: bool,
    /// True if shards have begun.
    #[serde(skip)]
    has_begun_shards: bool,
    /// Commands that finish the run.
    finish: Vec<String>,
}

#[derive(Default, Serialize)]
struct Shards {
    of: Option<u32>,
    /// Those whose manifest is there.
    ended: BTreeSet<u32>,
    /// Those with scenes that are missing or to be tried again.
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
        let claims = Claims::read(folder, &output::run_hash(&record["run"]), args.verify)?;
        let locked = OutputLock::begun_shards(folder)?;
        let of = claims.shard_count().or_else(|| locked.first().map(|[_, of]| *of));
        let unfinished = of.map(|of| claims.unfinished_shards(of)).unwrap_or_default();
        let begun = locked.into_iter().filter(|[_, count]| Some(*count) == of).map(|[number, _]| number);
        let shards = Shards {
            of,
            ended: claims
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
            let records = claims.scenes.iter().filter_map(|name| claims.records.get(name));
            let reason = |record: &crate::output::SceneRecord| Reason {
                scene: record.scene.clone(),
                reason: record.reason.clone(),
            };
            records.filter(|record| record.state == state).map(reason).collect()
        };
        let is_known = !claims.scenes.is_empty();
        let mut status = Self {
            missing: claims.missing().len(),
            counts: claims.counts(),
            is_known,
            is_recorded_done: !record["seconds"].is_null(),
            bad: with(State::Bad),
            retry: with(State::Retry),
            left_out_scenes: with(State::LeftOut),
            bytes: claims.records.values().flat_map(|record| &record.files).map(|file| file.bytes).sum(),
            // The sum of none would be -0.
            core_seconds: claims
                .shards
                .iter()
                .fold(0.0, |sum, state| sum + state.seconds * state.threads as f64),
            joined: claims.is_joined && !output::has_shards(folder)?,
            has_begun_shards: output::has_shards(folder)?,
            problems: claims.problems,
            finish: Vec::new(),
            shards,
            command,
        };
        status.finish = status.finishing(folder);
        Ok(status)
    }

    fn is_unfinished(&self) -> bool {
        match self.is_known {
            true => self.missing > 0 || self.counts.retry > 0 || !self.joined,
            false => !self.is_recorded_done,
        }
    }

    fn outcome(&self) -> Outcome {
        match () {
            () if !self.problems.is_empty() => Outcome::NotHeld,
            () if self.is_unfinished() => Outcome::Retry,
            () if self.counts.bad > 0 => Outcome::BadScenes,
            () => Outcome::Done,
        }
    }

    /// The commands that finish the run; none are known while the first shards run.
    fn finishing(&self, folder: &Path) -> Vec<String> {
        let out = output::quoted(folder.display().to_string());
        let with = |options: &str| output::command_with(&self.command, &format!("--out {out}{options}"));
        if !self.is_unfinished() {
            return Vec::new();
        }
        let Some(of) = self.shards.of else {
            return if self.has_begun_shards { Vec::new() } else { vec![with("")] };
        };
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
        let Counts { scenes, done, left_out, bad, retry } = self.counts;
        let mut lines = vec![self.command.clone()];
        if self.is_known {
            let mut parts = vec![format!("{done} done")];
            for (number, what) in [
                (left_out, "left out"),
                (bad, "bad"),
                (retry, "to be tried again"),
                (self.missing, "missing"),
            ] {
                if number > 0 {
                    parts.push(format!("{number} {what}"));
                }
            }
            lines.push(format!("{}: {}", count(scenes + self.missing, "scene"), parts.join(", ")));
        } else if self.is_recorded_done {
            lines.push("done".to_owned());
        } else {
            lines.push("unfinished, without shards: what is done is known at its end".to_owned());
        }
        if let Some(of) = self.shards.of {
            let Shards { ended, unfinished, begun, .. } = &self.shards;
            let named = |what: &str, numbers: &BTreeSet<u32>| match numbers.len() {
                0 => String::new(),
                all => format!(", {all} {what}: {}", ranges(numbers)),
            };
            lines.push(format!(
                "{of} shards: {} ended{}{}",
                ended.len(),
                named("unfinished", unfinished),
                named("of them running or killed", begun)
            ));
            let (gigabytes, hours) = (self.bytes as f64 / 1e9, self.core_seconds / 3600.0);
            lines.push(format!("so far {gigabytes:.2} GB and {hours:.2} core-hours"));
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
            lines.push("to finish:".to_owned());
            lines.extend(self.finish.iter().map(|command| format!("  {command}")));
        }
        lines.iter().map(|line| format!("{}\n", terminal::escaped_name(line))).collect()
    }
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
