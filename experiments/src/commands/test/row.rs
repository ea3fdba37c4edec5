//! The result of a test, as a row, as words and as a case of JUnit.

use std::path::Path;

use anyhow::Result;
use sage_core::text::table::Table;
use sage_run::{Outcome, output, progress, terminal};
use sage_sim::search::{
    Met,
    passing::{self, Asked, Shortfall, TestDrive},
    suite::{Suite, SuiteTest},
};
use serde::{Deserialize, Serialize};

use super::Earlier;
use crate::{
    cli::TestArgs,
    junit::{Case, Verdict},
};

/// What comes before the last lines of a planner's log in a message.
const LOG: &str = "; the end of its standard error";

/// Failures whose sentences are printed.
const SHOWN: usize = 5;

/// What came of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum TestResult {
    Passed,
    Failed,
    Error,
}

/// What every result begins with, and what a baseline needs of an earlier one.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct ResultHead {
    pub(super) test: String,
    /// Which plan it was: another suite may have a test of the same name.
    pub(super) plan_hash: String,
    pub(super) ego: String,
    /// Version of the definitions.
    pub(super) suite: u32,
    pub(super) result: TestResult,
}

/// The result of a test, as `--json` prints it.
#[derive(Debug, Serialize)]
pub(super) struct ResultRow<'s> {
    #[serde(flatten)]
    pub(super) head: ResultHead,
    /// The driver that the failure was found with.
    found_with: &'s str,
    /// Cluster of that failure.
    cluster: &'s str,
    /// What explained it, in words.
    sentence: Option<&'s str>,
    #[serde(flatten)]
    driven: Driven,
    error: Option<String>,
    seconds: f64,
}

/// What the driver did.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Driven {
    Measured {
        #[serde(flatten)]
        drive: TestDrive,
        /// Why it failed.
        shortfall: Option<Shortfall>,
    },
    Failed {},
}

impl<'s> ResultRow<'s> {
    fn new(suite: &Suite, test: &'s SuiteTest, ego: &str, driven: Driven, seconds: f64) -> Self {
        let is_passed = match &driven {
            Driven::Measured { shortfall, .. } => shortfall.is_none(),
            Driven::Failed {} => false,
        };
        Self {
            head: ResultHead {
                test: test.name.clone(),
                plan_hash: test.plan_hash.clone(),
                ego: ego.to_owned(),
                suite: suite.suite,
                result: if is_passed { TestResult::Passed } else { TestResult::Failed },
            },
            found_with: &test.found.ego,
            cluster: &test.found.cluster,
            sentence: test.found.sentence.as_deref(),
            driven,
            error: None,
            seconds,
        }
    }

    pub(super) fn failed(
        suite: &Suite,
        test: &'s SuiteTest,
        ego: &str,
        error: &anyhow::Error,
        seconds: f64,
    ) -> Self {
        let mut row = Self::new(suite, test, ego, Driven::Failed {}, seconds);
        row.head.result = TestResult::Error;
        row.error = Some(format!("{error:#}"));
        row
    }

    pub(super) fn measured(
        suite: &Suite,
        test: &'s SuiteTest,
        ego: &str,
        drive: TestDrive,
        asked: Asked,
        seconds: f64,
    ) -> Self {
        let shortfall = drive.shortfall(asked);
        Self::new(suite, test, ego, Driven::Measured { drive, shortfall }, seconds)
    }

    /// What happened, in words.
    pub(super) fn words(&self) -> String {
        let after = |met: &Met| format!("contact after {:.1} s", met.step as f64 / 10.0);
        match (&self.error, &self.driven) {
            // A table has no place for a traceback: the end of it says what went wrong.
            (Some(error), _) => match error.split_once(LOG) {
                Some((error, log)) => format!("{error}: {}", log.rsplit(" | ").next().unwrap_or(log)),
                None => error.clone(),
            },
            (None, Driven::Measured { drive, shortfall }) => {
                let met = drive.contact.as_ref().map_or("no contact".to_owned(), after);
                let speed = drive.contact.as_ref().map_or(0.0, |met| met.impact_speed);
                let fault = || format!("{met}, impact {speed:.1} m/s, {}", fault_words(drive));
                let progress = &drive.progress;
                match shortfall {
                    Some(Shortfall::OffRoad) => format!(
                        "off the road after {:.1} s",
                        drive.off_road.map_or(0.0, |frame| frame as f64 / 10.0 - 1.0)
                    ),
                    Some(Shortfall::NoProgress) => {
                        let (made, compared, with) = (progress.made, progress.compared, &progress.with);
                        let met = if drive.contact.is_some() { fault() } else { met };
                        let with = match &**with {
                            passing::UNATTACKED => "no reference driver prevents it; its unattacked drive",
                            other => other,
                        };
                        format!(
                            "{made:.0} m of progress, at least {:.0} m are asked ({with}: {compared:.0} m); {met}",
                            progress.least()
                        )
                    }
                    Some(Shortfall::Discomfort) => format!("{met}; beyond the bounds of comfort"),
                    Some(Shortfall::AtFault | Shortfall::Contact) => fault(),
                    None if drive.contact.is_some() => fault(),
                    None if !progress.is_asked() => format!("{met}; progress not asked"),
                    None => met,
                }
            }
            (None, _) => "no contact".to_owned(),
        }
    }

    /// What happened, what explained the failure that the test was made of, and the command that shows the drive.
    fn message(&self, args: &TestArgs) -> String {
        let mut parts = vec![self.words()];
        parts.extend(self.sentence.map(|sentence| format!("when it was found: {sentence}")));
        let watch = watch(&args.suite, &self.head.test, &args.ego.for_identity());
        parts.extend(watch.map(|command| format!("watch it: {command}")));
        parts.join("; ")
    }

    /// The mark of a test that passed with a contact.
    fn mark(&self) -> Option<String> {
        match &self.driven {
            Driven::Measured { drive, .. }
                if self.head.result == TestResult::Passed && drive.contact.is_some() =>
            {
                Some(self.words())
            }
            _ => None,
        }
    }

    /// Whether it failed, and the baseline has the same.
    pub(super) fn is_accepted(&self, baseline: Option<&Earlier>) -> bool {
        let before = baseline.and_then(|all| all.get(&(self.head.test.clone(), self.head.plan_hash.clone())));
        self.head.result == TestResult::Failed && before == Some(&TestResult::Failed)
    }

    pub(super) fn case(&self, baseline: Option<&Earlier>, args: &TestArgs) -> Case {
        let verdict = match self.head.result {
            TestResult::Passed => Verdict::Passed(self.mark()),
            TestResult::Failed if self.is_accepted(baseline) => Verdict::Accepted(self.words()),
            TestResult::Failed => Verdict::Failed(self.message(args)),
            TestResult::Error => Verdict::Error(self.words()),
        };
        Case { name: self.head.test.clone(), seconds: self.seconds, verdict }
    }
}

/// Whose fault the contact of a drive is.
fn fault_words(drive: &TestDrive) -> &'static str {
    match drive.at_fault {
        Some(true) => "at fault",
        Some(false) => "not at fault",
        None => "fault unknown",
    }
}

/// The results, as `--json` prints them.
pub(super) fn lines(rows: &[ResultRow]) -> Result<String> {
    let mut out = Vec::new();
    for row in rows {
        terminal::write_json_line(&mut out, &serde_json::to_string(row)?)?;
    }
    Ok(String::from_utf8(out)?)
}

pub(super) fn print(rows: &[ResultRow], baseline: Option<&Earlier>, args: &TestArgs) -> Result<()> {
    if args.json {
        return Ok(output::print(&lines(rows)?)?);
    }
    let heads = ["test", "result", "what happened", "found with", "cluster"];
    let mut table = Table { names: 2, ..Table::new("", &heads) };
    for row in rows {
        let result = match row.head.result {
            TestResult::Passed if row.mark().is_some() => "passed, contact",
            TestResult::Passed => "passed",
            TestResult::Failed if row.is_accepted(baseline) => "failed before",
            TestResult::Failed => "FAILED",
            TestResult::Error => "ERROR",
        };
        let cells = [result, &row.words(), row.found_with, row.cluster].map(terminal::escaped_name);
        table.row(terminal::escaped_name(&row.head.test), cells);
    }
    Ok(output::print(&if args.wide { table.aligned() } else { table.terminal() })?)
}

/// The command that plays a test.
fn watch(suite: &Path, test: &str, ego: &str) -> Option<String> {
    let scene = suite.join(format!("{test}.safetensors"));
    // A suite may hold its scenes in another format.
    scene.is_file().then(|| {
        let [scene, ego] = [scene.display().to_string(), ego.to_owned()].map(output::quoted);
        format!("sage simulate {scene} --ego {ego} --out watch/")
    })
}

/// Says how many tests passed. Done unless a test counts against the driver.
pub(super) fn ended(rows: &[ResultRow], baseline: Option<&Earlier>, args: &TestArgs) -> Outcome {
    let count = |result: TestResult| rows.iter().filter(|row| row.head.result == result).count();
    let [passed, failed, errors] = [TestResult::Passed, TestResult::Failed, TestResult::Error].map(count);
    let marked = rows.iter().filter(|row| row.mark().is_some()).count();
    // Only a failure excuses a failure: not an error, and not a test that the baseline does not know.
    let counts = |row: &&ResultRow| row.head.result == TestResult::Failed && !row.is_accepted(baseline);
    let new: Vec<&ResultRow> = rows.iter().filter(counts).collect();
    let mut text = format!("{passed} of {} passed", progress::count(rows.len(), "test"));
    if marked > 0 {
        text += &format!(" ({marked} with a contact that is not shown to be the driver's fault)");
    }
    text += &format!(", {failed} failed");
    if errors > 0 {
        text += &format!(", {}", progress::count(errors, "error"));
    }
    if baseline.is_some() {
        text += &format!("; {} not in the baseline as failed", new.len());
        new.iter().for_each(|row| text += &format!("\n  {}", terminal::escaped_name(&row.head.test)));
    }
    let ego = args.ego.for_identity();
    if let Some(command) = new.iter().find_map(|row| watch(&args.suite, &row.head.test, &ego)) {
        text += &format!("\nwatch one: {command}");
    }
    // A table has no room for sentences.
    for row in new.iter().take(SHOWN) {
        if let Some(sentence) = row.sentence {
            text += &format!(
                "\n{}: {}",
                terminal::escaped_name(&row.head.test),
                terminal::escaped_name(sentence)
            );
        }
    }
    progress::say_lines(&text);
    if new.is_empty() && errors == 0 { Outcome::Done } else { Outcome::NotHeld }
}
