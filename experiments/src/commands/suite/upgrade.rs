//! Makes a suite of the present definitions of an earlier one: drives again against its tests, and keeps those that are
//! failures still.

use std::{collections::BTreeSet, path::Path, sync::Arc};

use advsage::{Registries, driver_spec::DriverSpec, ego::Ego, references};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_core::{
    files, generator::Proposal, objective::DrivableFeasibility, registry::Entry as _, scene::SceneIndex,
};
use sage_data::{MAX_SCENE_FILE, Recording};
use sage_run::{Outcome, outcome::caught, output::Folder, progress, terminal};
use sage_sim::{
    SimScene,
    search::{
        PlanDrives, Requirement, SearchOptions,
        suite::{FILE, Found, SCENES, Suite, SuiteTest, VERSION},
    },
};

use super::remove_old;
use crate::{
    cli::SuiteArgs,
    commands::{search::found::without_folders, test},
};

/// What becomes of a test: kept as the driver fails at it now, or why not.
type Driven = Result<SuiteTest, String>;

/// Drives a driver against the tests of a suite, and writes those that it fails at by the present definitions.
///
/// *Errors*: the suite cannot be read; none of its tests is left.
pub(super) fn run(
    args: &SuiteArgs,
    from: &Path,
    ego: &DriverSpec,
    registries: &Registries,
) -> Result<Outcome> {
    let mut suite = test::read_as_written(from)?;
    let ego = Ego { fault: suite.fault, ..Ego::new(&args.planner.applied(ego), registries)? };
    suite.require = Requirement::default();
    suite.suite = VERSION;
    suite.references = references::default_names();
    if suite.feasibility.name == DrivableFeasibility::NAME {
        suite.feasibility.options.clear();
    }
    let tests = std::mem::take(&mut suite.tests);
    let driven: Vec<Driven> = tests
        .par_iter()
        .map(|test| {
            caught(|| again(from, &suite, test, &ego, registries))
                .unwrap_or_else(|error| Err(format!("{error:#}")))
        })
        .collect();
    for (test, driven) in tests.iter().zip(driven) {
        match driven {
            Ok(kept) => suite.tests.push(kept),
            Err(why) => progress::say(&format!("dropped {}: {why}", terminal::escaped_name(&test.name))),
        }
    }
    ensure!(
        !suite.tests.is_empty(),
        "no test is left: `{}` fails at none of them by the present definitions",
        ego.label
    );
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    remove_old(&folder)?;
    folder.inner(SCENES.as_ref())?;
    let scenes: BTreeSet<&String> = suite.tests.iter().map(|test| &test.scene).collect();
    for scene in scenes {
        let file = from.join(SCENES).join(scene);
        let bytes = files::read(&file, MAX_SCENE_FILE)
            .with_context(|| format!("cannot read `{}`", file.display()))?;
        folder.write(&format!("{SCENES}/{scene}"), &bytes)?;
    }
    folder.write(FILE, &serde_json::to_vec(&suite)?)?;
    let out = folder.path().display();
    progress::say_lines(&format!(
        "`{out}`: {} of {} kept\nto drive against them: sage test {out} --ego POLICY",
        suite.tests.len(),
        progress::count(tests.len(), "test"),
    ));
    Ok(Outcome::Done)
}

/// Drives against a test again.
///
/// *Errors*: its scene is another, or the driver cannot drive there.
fn again(from: &Path, suite: &Suite, test: &SuiteTest, ego: &Ego, registries: &Registries) -> Result<Driven> {
    let path = from.join(SCENES).join(&test.scene);
    let bytes =
        files::read(&path, MAX_SCENE_FILE).with_context(|| format!("cannot read `{}`", path.display()))?;
    ensure!(
        blake3::hash(&bytes).to_hex().as_str() == test.scene_hash,
        "`{}` is not the scene that the suite was made with",
        path.display()
    );
    let scene = Recording::from_bytes(&path, bytes)?.scene.with_roles(None, Some(&test.adversary))?;
    let index = SceneIndex::new(scene.map.clone());
    let simulated = SimScene::new(Arc::new(scene), index)?;
    let driver = ego.test(&simulated, test.seed)?;
    let ctx = driver.context()?;
    let rule = &suite.feasibility;
    let rule = registries.feasibilities.build(&rule.name, &rule.options.clone().into())?;
    let options =
        SearchOptions { require: suite.require, avoidable: suite.avoidable, ..SearchOptions::default() };
    let mut drives = PlanDrives::new(&driver, &ctx, &*rule, &options)?;
    let Some(evaluated) = drives.evaluate(0, &Proposal::of(test.plan.clone()))? else {
        return Ok(Err("its plan is not feasible by the present rule".to_owned()));
    };
    if let Some(missing) = evaluated.clauses.first_missing(suite.require) {
        let met = evaluated.contact.is_some();
        return Ok(Err(if met {
            format!("the clause `{missing}` does not hold")
        } else {
            "no contact".to_owned()
        }));
    }
    let found = Found {
        ego: without_folders(&ego.label),
        contact: evaluated.contact,
        clauses: evaluated.clauses,
        ..test.found.clone()
    };
    Ok(Ok(SuiteTest { found, ..test.clone() }))
}
