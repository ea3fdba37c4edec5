//! `sage test`: drives a driver against a test suite.

use std::{collections::HashMap, path::Path, sync::Arc, time::Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use rayon::prelude::*;
use sage_bench::table::Table;
use sage_core::{files, objective::Feasibility, scene::SceneIndex};
use sage_data::{MAX_SCENE_FILE, Recording};
use sage_sim::{
    SimScene,
    search::{
        Clauses, Evaluated, Met,
        suite::{self, SCENES, Suite, SuiteTest, VERSION},
    },
};
use serde::{Deserialize, Serialize};

use super::suite::FILE;
use crate::{
    Outcome, Registries,
    cli::TestArgs,
    ego::Ego,
    junit::{self, Case, Verdict},
    outcome::caught,
    output::{self, OutputFile, RECORD},
    progress, terminal,
};

/// Size limit of a suite and of earlier results, bytes.
const LIMIT: u64 = 1 << 27;

/// What came of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum TestResult {
    Passed,
    Failed,
    Error,
}

/// The result of a test, as `--json` prints it.
#[derive(Debug, Serialize)]
struct ResultRow<'s> {
    test: &'s str,
    /// Which plan it was: another suite may have a test of the same name.
    plan_hash: &'s str,
    ego: &'s str,
    result: TestResult,
    /// The driver that the failure was found with.
    found_with: &'s str,
    /// Cluster of that failure.
    cluster: &'s str,
    contact: Option<Met>,
    clauses: Clauses,
    /// The first clause that does not hold, of a test that passed.
    missing: Option<String>,
    error: Option<String>,
    seconds: f64,
}

/// What a baseline needs of an earlier result.
#[derive(Deserialize)]
struct EarlierRow {
    test: String,
    plan_hash: String,
    ego: String,
    result: TestResult,
}

/// Results of an earlier run by the names and the plans of the tests.
type Earlier = HashMap<(String, String), TestResult>;

pub(crate) fn run(args: &TestArgs, registries: &Registries) -> Result<Outcome> {
    let ego = Ego::new(&args.planner.applied(&args.ego), registries)?;
    progress::say_notes(std::slice::from_ref(&ego));
    let suite = read(&args.suite)?;
    let rule = registries
        .feasibilities
        .build(&suite.feasibility.name, &suite.feasibility.options.clone().into())
        .with_context(|| format!("`{}`", args.suite.join(FILE).display()))?;
    let baseline = args.baseline.as_deref().map(|path| earlier(path, &suite, &ego.label)).transpose()?;
    let junit = args.junit.as_deref().map(|path| OutputFile::claim(path, args.force)).transpose()?;
    // Tests of one scene share its unattacked drive.
    let (mut groups, mut places): (Vec<Vec<&SuiteTest>>, HashMap<_, usize>) = Default::default();
    for test in &suite.tests {
        let place =
            *places.entry((&test.scene, &test.scene_hash, &test.adversary, test.seed)).or_insert_with(|| {
                groups.push(Vec::new());
                groups.len() - 1
            });
        groups[place].push(test);
    }
    let driven = groups.par_iter().map(|tests| drive(&args.suite, &suite, &*rule, &ego, tests));
    // The first error in the order of the suite, whichever thread meets one first.
    let driven: Vec<Result<Vec<ResultRow>>> = driven.collect();
    let driven = driven.into_iter().collect::<Result<Vec<_>>>()?;
    let mut rows: Vec<ResultRow> = driven.into_iter().flatten().collect();
    let place: HashMap<&str, usize> =
        suite.tests.iter().enumerate().map(|(k, test)| (&*test.name, k)).collect();
    rows.sort_by_key(|row| place.get(row.test).copied());
    if let Some(file) = junit {
        let name = args.suite.display().to_string();
        let cases: Vec<Case> = rows.iter().map(|row| case(row, baseline.as_ref())).collect();
        file.write(junit::report(&name, &ego.label, &cases).as_bytes())?;
    }
    print(&rows, baseline.as_ref(), args)?;
    Ok(ended(&rows, baseline.as_ref()))
}

/// Reads a suite.
///
/// *Errors*: it is none, or not as it was made.
fn read(folder: &Path) -> Result<Suite> {
    let path = folder.join(FILE);
    let shown = path.display();
    if !path.is_file() && folder.join(RECORD).is_file() {
        bail!(
            "`{}` is no suite; if it is the output of a search, make one of it: sage suite {0} --out DIR",
            folder.display()
        );
    }
    let bytes = files::read(&path, LIMIT).with_context(|| format!("cannot read `{shown}`"))?;
    let suite: Suite = serde_json::from_slice(&bytes).with_context(|| format!("`{shown}` is no suite"))?;
    suite.check().map_err(|problem| anyhow!("`{shown}`: {problem}"))?;
    if suite.tests.is_empty() {
        bail!("`{shown}` has no tests");
    }
    if suite.suite < VERSION {
        progress::say(&format!(
            "note: `{shown}` was made before plans had limits of turns, and is evaluated as then"
        ));
    }
    Ok(suite.as_found())
}

/// The results of an earlier run.
///
/// *Errors*: the file holds no result of this suite, so that every failure would be excused.
fn earlier(path: &Path, suite: &Suite, ego: &str) -> Result<Earlier> {
    let shown = path.display();
    let text = files::read_text(path, LIMIT).with_context(|| format!("cannot read `{shown}`"))?;
    let row = |(k, line): (usize, &str)| -> Result<EarlierRow> {
        serde_json::from_str(line)
            .with_context(|| format!("`{shown}`, line {}: no result of `sage test --json`", k + 1))
    };
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let rows: Vec<EarlierRow> = lines.map(row).collect::<Result<_>>()?;
    if let Some(other) = rows.iter().find(|row| row.ego != ego) {
        let other = terminal::escaped_name(&other.ego);
        progress::say(&format!("note: `{shown}` holds results of `{other}`, not of `{ego}`"));
    }
    let earlier: Earlier = rows.into_iter().map(|row| ((row.test, row.plan_hash), row.result)).collect();
    let is_known = |test: &SuiteTest| earlier.contains_key(&(test.name.clone(), test.plan_hash.clone()));
    let unknown = suite.tests.iter().filter(|test| !is_known(test)).count();
    if unknown == suite.tests.len() {
        bail!("`{shown}` holds no result of a test of this suite");
    }
    if unknown > 0 {
        let tests = progress::count(unknown, "test");
        progress::say(&format!(
            "note: `{shown}` does not know {tests} of this suite; they count if they fail"
        ));
    }
    Ok(earlier)
}

/// Drives against all tests of one scene.
///
/// *Errors*: the scene is not the one that the suite was made with.
fn drive<'s>(
    folder: &Path,
    suite: &'s Suite,
    rule: &dyn Feasibility,
    ego: &'s Ego,
    tests: &[&'s SuiteTest],
) -> Result<Vec<ResultRow<'s>>> {
    let path = folder.join(SCENES).join(&tests[0].scene);
    let shown = path.display();
    let bytes = files::read(&path, MAX_SCENE_FILE).with_context(|| format!("cannot read `{shown}`"))?;
    if blake3::hash(&bytes).to_hex().as_str() != tests[0].scene_hash {
        bail!("`{shown}` is not the scene that the suite was made with; make the suite again");
    }
    let clock = Instant::now();
    let prepared = || -> Result<(Arc<SimScene>, u64)> {
        let scene = Recording::from_bytes(&path, bytes)?.scene.with_roles(None, Some(&tests[0].adversary))?;
        let index = SceneIndex::new(scene.map.clone());
        Ok((SimScene::new(Arc::new(scene), index)?, tests[0].seed))
    };
    let failed = |test: &'s SuiteTest, error: anyhow::Error, seconds| ResultRow {
        test: &test.name,
        plan_hash: &test.plan_hash,
        ego: &ego.label,
        result: TestResult::Error,
        found_with: &test.found.ego,
        cluster: &test.found.cluster,
        contact: None,
        clauses: Clauses::default(),
        missing: None,
        error: Some(format!("{error:#}")),
        seconds,
    };
    let (simulated, seed) = match caught(prepared) {
        Ok(prepared) => prepared,
        Err(error) => {
            let text = format!("{error:#}");
            return Ok(tests.iter().map(|test| failed(test, anyhow!("{text}"), 0.0)).collect());
        }
    };
    let unattacked = caught(|| {
        let test = ego.test(&simulated, seed)?;
        Ok((test.context()?, test))
    });
    let before = clock.elapsed().as_secs_f64() / tests.len() as f64;
    let one = |test: &&'s SuiteTest| {
        let clock = Instant::now();
        let evaluated = match &unattacked {
            Ok((ctx, driver)) => caught(|| Ok(suite::run(suite, driver, ctx, rule, &test.plan)?)),
            Err(error) => Err(anyhow!("{error:#}")),
        };
        let seconds = before + clock.elapsed().as_secs_f64();
        match evaluated {
            Ok(Some(evaluated)) => of_drive(suite, test, &ego.label, evaluated, seconds),
            Ok(None) => failed(test, anyhow!("the plan is not feasible by the rule of the suite"), seconds),
            Err(error) => failed(test, error, seconds),
        }
    };
    Ok(tests.iter().map(one).collect())
}

fn of_drive<'s>(
    suite: &Suite,
    test: &'s SuiteTest,
    ego: &'s str,
    evaluated: Evaluated,
    seconds: f64,
) -> ResultRow<'s> {
    let Evaluated { clauses, contact, .. } = evaluated;
    let missing = clauses.first_missing(suite.require);
    ResultRow {
        test: &test.name,
        plan_hash: &test.plan_hash,
        ego,
        result: if missing.is_none() { TestResult::Failed } else { TestResult::Passed },
        found_with: &test.found.ego,
        cluster: &test.found.cluster,
        contact,
        clauses,
        missing: missing.map(|clause| clause.name().to_owned()),
        error: None,
        seconds,
    }
}

impl ResultRow<'_> {
    /// What happened, in words.
    fn words(&self) -> String {
        let after = |met: &Met| format!("{:.1} s", met.step as f64 / 10.0);
        match (&self.error, &self.contact) {
            (Some(error), _) => error.clone(),
            (None, None) => "no contact".to_owned(),
            (None, Some(met)) => match &self.missing {
                None => format!("contact after {}, {:.1} m/s", after(met), met.impact_speed),
                Some(clause) => format!("contact after {}, {}", after(met), missing_words(clause)),
            },
        }
    }

    /// Whether it failed, and the baseline has the same.
    fn is_accepted(&self, baseline: Option<&Earlier>) -> bool {
        let before = baseline.and_then(|all| all.get(&(self.test.to_owned(), self.plan_hash.to_owned())));
        self.result == TestResult::Failed && before == Some(&TestResult::Failed)
    }
}

/// Why a contact is no failure of the driver, by the clause that does not hold.
fn missing_words(clause: &str) -> &'static str {
    match clause {
        "attack" => "there without the attack too, or with another road user first",
        "believable" => "not believable",
        "at-fault" => "the driver not at fault",
        _ => "no evasive manoeuvre found",
    }
}

fn case(row: &ResultRow, baseline: Option<&Earlier>) -> Case {
    let verdict = match row.result {
        TestResult::Passed => Verdict::Passed,
        TestResult::Failed if row.is_accepted(baseline) => Verdict::Accepted(row.words()),
        TestResult::Failed => Verdict::Failed(row.words()),
        TestResult::Error => Verdict::Error(row.words()),
    };
    Case { name: row.test.to_owned(), seconds: row.seconds, verdict }
}

fn print(rows: &[ResultRow], baseline: Option<&Earlier>, args: &TestArgs) -> Result<()> {
    if args.json {
        let mut out = Vec::new();
        for row in rows {
            terminal::write_json_line(&mut out, &serde_json::to_string(row)?)?;
        }
        return output::print(&String::from_utf8(out)?);
    }
    let heads = ["test", "result", "what happened", "found with", "cluster"];
    let mut table = Table { names: 3, ..Table::new("", &heads) };
    for row in rows {
        let result = match row.result {
            TestResult::Passed => "passed",
            TestResult::Failed if row.is_accepted(baseline) => "failed before",
            TestResult::Failed => "FAILED",
            TestResult::Error => "ERROR",
        };
        let cells = [result, &row.words(), row.found_with, row.cluster].map(terminal::escaped_name);
        table.row(terminal::escaped_name(row.test), cells);
    }
    output::print(&if args.wide { table.aligned() } else { table.terminal() })
}

/// Says how many tests passed. Done unless a test counts against the driver.
fn ended(rows: &[ResultRow], baseline: Option<&Earlier>) -> Outcome {
    let count = |result: TestResult| rows.iter().filter(|row| row.result == result).count();
    let [passed, failed, errors] = [TestResult::Passed, TestResult::Failed, TestResult::Error].map(count);
    // Only a failure excuses a failure: not an error, and not a test that the baseline does not know.
    let counts = |row: &&ResultRow| row.result == TestResult::Failed && !row.is_accepted(baseline);
    let new: Vec<&ResultRow> = rows.iter().filter(counts).collect();
    let mut text = format!("{passed} of {} passed, {failed} failed", progress::count(rows.len(), "test"));
    if errors > 0 {
        text += &format!(", {}", progress::count(errors, "error"));
    }
    if baseline.is_some() {
        text += &format!("; {} not in the baseline as failed", new.len());
        new.iter().for_each(|row| text += &format!("\n  {}", terminal::escaped_name(row.test)));
    }
    progress::say_lines(&text);
    if new.is_empty() && errors == 0 { Outcome::Done } else { Outcome::NotHeld }
}
