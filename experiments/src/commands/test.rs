//! `sage test`: drives a driver against a test suite.

pub(super) mod page;
mod record;
mod row;

use std::{collections::HashMap, path::Path, sync::Arc, time::Instant};

use advsage::{Registries, ego::Ego};
use anyhow::{Context as _, Result, anyhow, bail, ensure};
use rayon::prelude::*;
use sage_core::{files, objective::Feasibility, scene::SceneIndex};
use sage_data::{MAX_SCENE_FILE, Recording};
use sage_run::{
    Outcome,
    outcome::caught,
    output::{Folder, Inputs, OutputFile, RECORD},
    progress, terminal,
};
use sage_sim::{
    SimScene,
    search::{
        passing::{Asked, TestDrive},
        suite::{FILE, SCENES, Suite, SuiteTest},
    },
};

use crate::{cli::TestArgs, junit};

use page::Side;
use record::{DRIVES, RESULTS, RecordedDrive, TestRecord};
use row::{ResultHead, ResultRow, TestResult};

/// Size limit of a suite and of earlier results, bytes.
const LIMIT: u64 = 1 << 27;

const NOT_FEASIBLE: &str = "the plan is not feasible by the rule of the suite";

/// The result of a test, and the drive if it is kept.
type Tested<'s> = (ResultRow<'s>, Option<RecordedDrive>);

/// Results of an earlier run by the names and the plans of the tests.
type Earlier = HashMap<(String, String), TestResult>;

pub(crate) fn run(args: &TestArgs, registries: &Registries) -> Result<Outcome> {
    let ego = Ego::new(&args.planner.applied(&args.ego), registries)?;
    let suite = read(&args.suite)?;
    let ego = Ego { fault: suite.fault, ..ego.with_references(&suite.references, registries)? };
    let asked = Asked { no_contact: args.strict, comfort: args.comfort };
    let rule = registries
        .feasibilities
        .build(&suite.feasibility.name, &suite.feasibility.options.clone().into())
        .with_context(|| format!("`{}`", args.suite.join(FILE).display()))?;
    let baseline = args.baseline.as_deref().map(|path| earlier(path, &suite, &ego.label)).transpose()?;
    let folder = args.out.as_deref().map(|out| results_folder(args, out)).transpose()?;
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
    let driven = groups
        .par_iter()
        .map(|tests| drive(&args.suite, &suite, &*rule, &ego, tests, asked, args.out.is_some()));
    // The first error in the order of the suite, whichever thread meets one first.
    let driven: Vec<Result<Vec<Tested>>> = driven.collect();
    let driven = driven.into_iter().collect::<Result<Vec<_>>>()?;
    let mut driven: Vec<Tested> = driven.into_iter().flatten().collect();
    let place: HashMap<&str, usize> =
        suite.tests.iter().enumerate().map(|(k, test)| (&*test.name, k)).collect();
    driven.sort_by_key(|(row, _)| place.get(&*row.head.test).copied());
    let (rows, drives): (Vec<ResultRow>, Vec<Option<RecordedDrive>>) = driven.into_iter().unzip();
    if let Some(folder) = &folder {
        write_page(folder, args, &suite, &rows, drives)?;
    }
    if let Some(file) = junit {
        let name = args.suite.display().to_string();
        let cases: Vec<_> = rows.iter().map(|row| row.case(baseline.as_ref(), args)).collect();
        file.write(junit::report(&name, &ego.label, &cases).as_bytes())?;
    }
    row::print(&rows, baseline.as_ref(), args)?;
    Ok(row::ended(&rows, baseline.as_ref(), args))
}

/// The folder of the page, without what an earlier run has written there.
fn results_folder(args: &TestArgs, out: &Path) -> Result<Folder> {
    let folder = Folder::make_beside(&Inputs::of([&args.suite]), out, args.force)?;
    page::remove_old(&folder)?;
    for inner in [DRIVES, record::SCENES] {
        folder.inner(inner.as_ref())?;
    }
    Ok(folder)
}

/// Writes the page of the tests, with the results, drives and scenes that it is made of.
fn write_page(
    folder: &Folder,
    args: &TestArgs,
    suite: &Suite,
    rows: &[ResultRow],
    drives: Vec<Option<RecordedDrive>>,
) -> Result<()> {
    let mut records = Vec::with_capacity(rows.len());
    for ((test, row), drive) in suite.tests.iter().zip(rows).zip(drives) {
        let source = args.suite.join(SCENES).join(&test.scene);
        folder
            .write(&format!("{}/{}", record::SCENES, test.scene), &files::read(&source, MAX_SCENE_FILE)?)?;
        let record = TestRecord::new(test, row, drive);
        folder.write(&TestRecord::file(&test.name), &serde_json::to_vec(&record)?)?;
        records.push(record);
    }
    page::write(folder, &[Side::of(folder.path(), records)])?;
    folder.write(RESULTS, row::lines(rows)?.as_bytes())?;
    folder.finish()?;
    progress::say(&format!("open `{}`", folder.path().join(page::FILE).display()));
    Ok(())
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
    Ok(suite)
}

/// The results of an earlier run.
///
/// *Errors*: the file holds no result of this suite, so that every failure would be excused.
fn earlier(path: &Path, suite: &Suite, ego: &str) -> Result<Earlier> {
    let shown = path.display();
    let text = files::read_text(path, LIMIT).with_context(|| format!("cannot read `{shown}`"))?;
    let row = |(k, line): (usize, &str)| -> Result<ResultHead> {
        serde_json::from_str(line)
            .with_context(|| format!("`{shown}`, line {}: no result of `sage test --json`", k + 1))
    };
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let rows: Vec<ResultHead> = lines.map(row).collect::<Result<_>>()?;
    if let Some(other) = rows.iter().find(|row| row.suite != suite.suite) {
        // An option is wrong: exit status 2.
        let text = format!(
            "`{shown}` holds results of a suite of version {}, and this one is of version {}: they mean different things; drive again without --baseline for results to compare with\n",
            other.suite, suite.suite
        );
        return Err(clap::Error::raw(clap::error::ErrorKind::ValueValidation, text).into());
    }
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
    suite: &Suite,
    rule: &dyn Feasibility,
    ego: &'s Ego,
    tests: &[&'s SuiteTest],
    asked: Asked,
    keeps_drives: bool,
) -> Result<Vec<Tested<'s>>> {
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
    let failed = |test, error: &anyhow::Error, seconds| {
        (ResultRow::failed(suite, test, &ego.label, error, seconds), None)
    };
    let (simulated, seed) = match caught(prepared) {
        Ok(prepared) => prepared,
        Err(error) => {
            return Ok(tests.iter().map(|test| failed(*test, &error, 0.0)).collect());
        }
    };
    let unattacked: Result<_> = caught(|| {
        let test = ego.test(&simulated, seed)?;
        Ok((test.context()?, test))
    });
    let before = clock.elapsed().as_secs_f64() / tests.len() as f64;
    let one = |test: &&'s SuiteTest| {
        let clock = Instant::now();
        let row: Result<_> = caught(|| {
            let (ctx, driver) = unattacked.as_ref().map_err(|error| anyhow!("{error:#}"))?;
            let seconds = || before + clock.elapsed().as_secs_f64();
            ensure!(rule.is_feasible(&ctx.candidate(test.plan.clone()), ctx), NOT_FEASIBLE);
            let watching = driver.watching()?;
            let (driven, outcome) = TestDrive::new(driver, &watching, &test.plan)?;
            let recorded = keeps_drives.then(|| RecordedDrive::of(&outcome, driver));
            Ok((ResultRow::measured(suite, test, &ego.label, driven, asked, seconds()), recorded))
        });
        row.unwrap_or_else(|error| failed(test, &error, before + clock.elapsed().as_secs_f64()))
    };
    Ok(tests.iter().map(one).collect())
}
