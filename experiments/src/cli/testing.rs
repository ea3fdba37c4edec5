//! Arguments of `sage report`, `sage suite` and `sage test`.

use std::path::PathBuf;

use advsage::{attacked_files::AttackFormats, driver_spec::DriverSpec};
use clap::{Args, ValueEnum};
use sage_sim::search::suite::MOST_TESTS;

use super::{
    FolderArgs, PlannerArgs,
    formats::attack_formats,
    help::{DRIVER, OUTPUT, RUN, SELECTION},
};

/// Make a page of the failures that searches found.
///
/// The page has filters, clusters, thumbnails, and every failure in a player. It is made from the rows of the searches;
/// nothing is driven again. It opens from disk and needs no network. Several
/// searches, such as those of several drivers, make one page.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  sage search scenes/ --ego idm --out idm/
  sage search scenes/ --ego expert --out expert/
  sage report idm/ expert/ --out report/
  sage report --compare tests-of-v1/ tests-of-v2/ --out compared/")]
pub(crate) struct FailureReportArgs {
    /// Output folders of `sage search`; with --compare two of `sage test --out`.
    #[arg(required = true, value_name = "SEARCH")]
    pub searches: Vec<PathBuf>,
    /// Compare two outputs of `sage test --out` on one suite: what is fixed, what fails anew, and both drives in one player.
    #[arg(long, conflicts_with = "keep")]
    pub compare: bool,
    /// Failures of each scene that are shown.
    #[arg(long, value_enum, default_value_t = Keep::All)]
    pub keep: Keep,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Keep failures of searches as a test suite.
///
/// The suite holds the unchanged scenes, the plans of the adversary, and the clauses that made them failures. `sage test`
/// drives any driver against it. The attacked scenes are written too, as a data set for other simulators.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  sage search scenes/ --ego idm --out failures/
  sage suite failures/ --out suite/
  sage test suite/ --ego expert
  sage suite failures/ --diverse 30 --out suite/")]
pub(crate) struct SuiteArgs {
    /// Output folders of `sage search`. All must require the same clauses.
    #[arg(required = true, value_name = "SEARCH")]
    pub searches: Vec<PathBuf>,
    /// Failures of each scene that are kept (default: mildest; with --diverse all).
    #[arg(long, help_heading = SELECTION, value_enum)]
    pub keep: Option<Keep>,
    /// Keep at most N of these, as different as possible: by type of the collision, relative heading and speed, what both cars
    /// do, kind of road, and latest start of an evasive manoeuvre.
    #[arg(long, help_heading = SELECTION, value_name = "N", value_parser = tests)]
    pub diverse: Option<usize>,
    /// Formats of the attacked scenes.
    #[arg(long, help_heading = OUTPUT, default_value = "native", value_parser = attack_formats())]
    pub format: AttackFormats,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Failures of a scene that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Keep {
    /// The one whose adversary is driven least differently from the recording.
    Mildest,
    /// The one with the largest reward.
    Worst,
    /// The one with the largest probability under the motion prior (`docs/rates.md`).
    Likeliest,
    /// All.
    All,
}

/// Drive a driver against a test suite.
///
/// A test passes if the driver is at fault in no contact, stays on the road, and makes progress: from now on at least half
/// of what the reference driver does that prevents the contact, or of its own drive without the attack. A contact that is
/// not its fault, or whose fault is unknown, passes with a mark. Exit status: 0 if all tests pass, else
/// 1; with --baseline a test that failed there at the same plan is excused, and nothing else is.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage test suite/ --ego expert
  sage test suite/ --ego 'cmd:python3 my_planner.py' --junit report.xml
  sage test suite/ --ego idm --out tests/
  sage test suite/ --ego idm --json > today.jsonl
  sage test suite/ --ego idm --baseline yesterday.jsonl")]
pub(crate) struct TestArgs {
    /// Folder of a suite.
    pub suite: PathBuf,
    /// Driver under test: a policy by its name in `sage list`; path:FILE, a drive of your own planner; or your own
    /// planner: 'cmd:COMMAND', a program, or py:MODULE:CLASS, a class of Python.
    #[arg(long, help_heading = DRIVER, value_name = "POLICY")]
    pub ego: DriverSpec,
    #[command(flatten)]
    pub planner: PlannerArgs,
    /// Any contact fails the test, whosever fault it is.
    #[arg(long, help_heading = RUN)]
    pub strict: bool,
    /// A drive beyond nuPlan's bounds of acceleration, jerk and turning, up to its first contact, fails the test.
    #[arg(long, help_heading = RUN)]
    pub comfort: bool,
    /// Results of an earlier run (--json): a test that failed there at the same plan is excused; new tests and errors count.
    #[arg(long, help_heading = RUN, value_name = "FILE")]
    pub baseline: Option<PathBuf>,
    /// Also write a page that plays all tests into this folder, with the results, which `sage report --compare` compares.
    #[arg(long, help_heading = OUTPUT, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Also write the results as JUnit XML, which build servers read.
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Print one JSON object per test.
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,
    /// Print all columns.
    #[arg(long, help_heading = OUTPUT, conflicts_with = "json")]
    pub wide: bool,
    /// Overwrite an existing file.
    #[arg(long, help_heading = OUTPUT)]
    pub force: bool,
}

fn tests(text: &str) -> Result<usize, String> {
    let number = text.trim().parse().ok().filter(|number| (1..=MOST_TESTS).contains(number));
    number.ok_or_else(|| format!("expected a whole number from 1 to {MOST_TESTS}"))
}
