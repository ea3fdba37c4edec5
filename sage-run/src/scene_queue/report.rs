//! Output of all threads: rows on standard output in the order of the scenes, and progress on standard error.

use std::{
    cmp::Ordering,
    collections::BTreeMap,
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use advsage::{WithContext as _, in_one_line};
use sage_data::checks::Warning;

use super::row_file::json_line;
use crate::{
    AnyError, Result, io_causes,
    progress::{Progress, count, say},
};

/// Scenes with a kind of warning from which on the kind is only counted: in some data sets every scene has it.
const MOST_WARNINGS: usize = 20;

/// Printed line of one result.
pub struct Line {
    /// The line as text.
    pub text: String,
    /// Name of the row's file, which holds the line as JSON.
    pub row: String,
    /// Time of the work, seconds; `None` if an earlier run finished it.
    pub seconds: Option<f64>,
    /// Mean time of a step of the driver, milliseconds, if one drove.
    pub step_ms: Option<f64>,
}

/// Result of one scene.
pub struct SceneReport {
    /// What is printed, a line for each row.
    pub lines: Vec<Line>,
    /// Names of its files beside the rows of its lines.
    pub files: Vec<String>,
    /// Time per line, seconds; `None` if an earlier run finished all.
    pub seconds: Option<f64>,
    /// Warnings about the scene that change its results.
    pub warnings: Vec<Warning>,
    /// Why lines are missing: planners that failed.
    pub failures: Vec<String>,
}

impl SceneReport {
    /// The report of a scene that an earlier run finished.
    pub fn found(lines: Vec<Line>, files: Vec<String>) -> Self {
        Self { lines, files, seconds: None, warnings: Vec::new(), failures: Vec::new() }
    }
}

/// Prints results in the order of the scenes. Waiting rows stay on the disk, so memory does not grow with
/// them.
pub struct Report {
    folder: PathBuf,
    json: bool,
    /// What one line is: a noun.
    result: &'static str,
    state: Mutex<ReportState>,
}

struct ReportState {
    /// Index of the scene whose lines are printed next.
    next: usize,
    /// Lines of finished scenes that wait for an earlier scene.
    waiting: BTreeMap<usize, Vec<Line>>,
    /// False if no lines are wanted, and after the reader has closed standard output. The run continues, because it also
    /// writes files.
    is_open: bool,
    progress: Progress,
    results: usize,
    failed: usize,
    left_out: usize,
    /// Number of scenes with each kind of warning.
    warnings: BTreeMap<&'static str, usize>,
}

/// Words of a report.
#[derive(Clone, Copy, Debug)]
pub struct ReportWords {
    /// What is done to a scene: a participle.
    pub done: &'static str,
    /// What one line is: a noun.
    pub result: &'static str,
}

impl Report {
    /// A report for a number of scenes with rows in a folder.
    pub fn new(folder: &Path, json: bool, scenes: usize, ReportWords { done, result }: ReportWords) -> Self {
        let state = ReportState {
            next: 0,
            waiting: BTreeMap::new(),
            is_open: true,
            progress: Progress::new(done, scenes),
            results: 0,
            failed: 0,
            left_out: 0,
            warnings: BTreeMap::new(),
        };
        Self { folder: folder.to_owned(), json, result, state: Mutex::new(state) }
    }

    /// The same without a line for each result.
    pub fn quiet(self) -> Self {
        self.state().is_open = false;
        self
    }

    /// Reports a finished scene.
    ///
    /// *Errors*: standard output is not writable, or a row cannot be read back.
    pub fn done(&self, number: usize, name: &str, scene: SceneReport) -> Result<()> {
        let mut state = self.state();
        for warning in &scene.warnings {
            let number = state.warnings.entry(warning.kind).or_default();
            *number += 1;
            let text = match (*number).cmp(&MOST_WARNINGS) {
                Ordering::Less => format!("warning: {name}: {warning}"),
                Ordering::Equal => {
                    format!("warning: more scenes have `{}`; all are counted at the end", warning.kind)
                }
                Ordering::Greater => continue,
            };
            state.progress.say(&text);
        }
        for failure in &scene.failures {
            state.progress.say(&format!("error: {name}: {failure}"));
        }
        state.failed += usize::from(!scene.failures.is_empty());
        state.results += scene.lines.len();
        if scene.seconds.is_some() {
            state.progress.step()
        } else {
            state.progress.step_found()
        }
        self.print(&mut state, number, scene.lines)
    }

    /// Reports a failed scene.
    ///
    /// *Errors*: as [`Report::done`].
    pub fn report_failure(&self, number: usize, file: &Path, error: &AnyError) -> Result<()> {
        let mut state = self.state();
        state.failed += 1;
        state.progress.say(&format!("error: {}", named(file, error)));
        state.progress.step();
        self.print(&mut state, number, Vec::new())
    }

    /// Reports a scene in which nothing can be measured.
    ///
    /// *Errors*: as [`Report::done`].
    pub fn left_out(&self, number: usize, name: &str, reason: &str, lines: Vec<Line>) -> Result<()> {
        let mut state = self.state();
        state.left_out += 1;
        state.progress.say(&format!("left out: {name}: {reason}"));
        state.progress.step();
        self.print(&mut state, number, lines)
    }

    /// Says something about the work.
    pub fn say(&self, text: &str) {
        self.state().progress.say(text);
    }

    /// Number of scenes finished so far.
    pub fn finished_count(&self) -> usize {
        let state = self.state();
        state.progress.done() - state.failed - state.left_out
    }

    /// Prints a summary. Returns the number of results.
    pub fn finish(self, out: &Path) -> usize {
        let state = self.state.into_inner().unwrap_or_else(PoisonError::into_inner);
        let scenes = state.progress.done() - state.failed - state.left_out;
        let found = state.progress.found_count();
        let before = if found > 0 { format!(", {found} of them finished before") } else { String::new() };
        let scenes = count(scenes, "scene");
        // A result that is a scene need not be counted twice.
        let results = match self.result {
            "scene" => String::new(),
            result => format!(", {}", count(state.results, result)),
        };
        // A run without any result has said why.
        let left_out = match state.left_out {
            0 => String::new(),
            some => format!(", {} left out", count(some, "scene")),
        };
        if !state.warnings.is_empty() {
            let counts =
                state.warnings.iter().map(|(kind, number)| format!("{} {kind}", count(*number, "scene")));
            let counts = counts.collect::<Vec<_>>().join(", ");
            say(&format!("warnings that may change results: {counts}; `sage inspect` says all"));
        }
        if state.results > 0 || state.failed == 0 {
            state.progress.finish(&format!("{scenes}{before}{left_out}{results} in `{}`", out.display()));
        }
        state.results
    }

    fn state(&self) -> MutexGuard<'_, ReportState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn print(&self, state: &mut ReportState, number: usize, lines: Vec<Line>) -> Result<()> {
        state.waiting.insert(number, lines);
        while let Some(lines) = state.waiting.remove(&state.next) {
            state.next += 1;
            for line in lines.iter().filter(|_| state.is_open) {
                state.progress.clear();
                match self.write(line) {
                    Err(error) if is_closed(&error) => {
                        state.is_open = false;
                        break;
                    }
                    outcome => outcome?,
                }
            }
        }
        Ok(())
    }

    fn write(&self, line: &Line) -> Result<()> {
        let bytes = if self.json {
            let row = self.folder.join(&line.row);
            json_line(&row, line.seconds, line.step_ms)
                .map_err(|error| error.within(format!("cannot read `{}`", row.display())))?
        } else {
            format!("{}\n", line.text).into_bytes()
        };
        let mut out = std::io::stdout().lock();
        let written = out.write_all(&bytes).and_then(|()| out.flush());
        Ok(written.with_context(|| "cannot write to standard output")?)
    }
}

/// An error that names its file.
pub(super) fn named(file: &Path, error: &AnyError) -> String {
    let (file, error) = (format!("`{}`", file.display()), in_one_line(error));
    if error.contains(&file) { error } else { format!("{file}: {error}") }
}

fn is_closed(error: &AnyError) -> bool {
    io_causes(error).any(|error| error.kind() == ErrorKind::BrokenPipe)
}
