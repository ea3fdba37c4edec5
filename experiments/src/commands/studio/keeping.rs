//! The suite in which failures are kept.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
};

use advsage::{attacked_files::AttackFormats, references, rows::failure::FailureRow};
use anyhow::{Context as _, Result, ensure};
use sage_core::objective::PartSpec;
use sage_data::{Format, ReadOptions, Recording};
use sage_run::{input::scene_name, output::Folder};
use sage_sim::{
    avoidable::AvoidanceOptions,
    fault::FaultRule,
    search::{
        Requirement,
        suite::{FILE, Suite, VERSION},
    },
};
use serde_json::{Value, json};

use super::{
    choice::Choice,
    workshop::{Workshop, locked},
};
use crate::commands::{
    search::found::{FailureScene, json},
    suite::growing::GrowingSuite,
};

/// A suite that is made once the first failure is kept.
pub(super) struct Keeper {
    out: PathBuf,
    /// The suite that the folder held; without tests if it held none.
    before: Suite,
    growing: Mutex<Option<GrowingSuite>>,
}

impl Keeper {
    /// Checks the folder: a suite that it holds goes on.
    ///
    /// *Errors*: it holds something else, or a suite by other rules.
    pub(super) fn new(out: &Path, feasibility: PartSpec) -> Result<Self> {
        let empty = Suite {
            suite: VERSION,
            require: Requirement::default(),
            feasibility,
            avoidable: AvoidanceOptions::default(),
            references: references::default_names(),
            fault: FaultRule::default(),
            tests: Vec::new(),
        };
        let file = out.join(FILE);
        let before = if file.exists() {
            let suite: Suite = json(&file)?;
            suite.check().with_context(|| format!("`{}`", file.display()))?;
            let rules = Suite { tests: Vec::new(), ..suite.clone() };
            ensure!(
                rules == empty,
                "the suite `{}` is by other rules than the studio's; give another --out",
                out.display()
            );
            suite
        } else {
            let is_empty = fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
            ensure!(is_empty, "`{}` is not empty and holds no suite; give another --out", out.display());
            empty
        };
        Ok(Self { out: out.to_owned(), before, growing: Mutex::new(None) })
    }

    /// Adds a failure of a scene, and returns the name of its test and the number of tests.
    fn keep(&self, scene: &str, recording: &Recording, row: FailureRow) -> Result<(String, usize)> {
        let bytes = recording.to_native()?;
        let unchanged = Recording::from_bytes(scene.as_ref(), bytes.clone())?;
        let described = FailureScene::new(&unchanged, &row.head.adversary)?;
        let features = described.driven(&row).and_then(|driven| driven.features(&row))?;
        let mut growing = locked(&self.growing);
        if growing.is_none() {
            let folder = Folder::make(&self.out, !self.before.tests.is_empty())?;
            *growing =
                Some(GrowingSuite::new(folder, self.before.clone(), AttackFormats::One(Format::Native))?);
        }
        let growing = growing.as_mut().context("the suite was opened")?;
        let stored = growing.store(scene, &bytes)?;
        let name = growing.add(&unchanged, &stored, 1, &features, row)?;
        growing.write()?;
        Ok((name, growing.suite().tests.len()))
    }
}

impl Workshop<'_> {
    /// Keeps what the drivers of a choice fail at.
    ///
    /// *Errors*: nothing is kept; none of them fails; a system error.
    pub(super) fn keep(&self, choice: &Choice) -> Result<Value> {
        choice.check()?;
        let keeper =
            self.keeper.as_ref().context("start `sage studio` with --out FOLDER to keep failures")?;
        let judged = choice.drivers.iter().map(|&driver| self.judged(choice, driver));
        let failures = judged.collect::<Result<Vec<_>>>()?.into_iter().filter_map(|judged| judged.failure);
        let failures: Vec<FailureRow> = failures.collect();
        ensure!(!failures.is_empty(), "no driver here fails at this attack");
        let options = ReadOptions { without: choice.sorted_without(), ..ReadOptions::default() };
        let recording = self.scenes.recording(choice.scene, &options)?;
        let name = scene_name(Path::new(&self.names[choice.scene]))?;
        // The scene as altered is another one.
        let name = options.without.iter().fold(name, |name, id| format!("{name}-without-{id}"));
        let (mut kept, mut tests) = (Vec::new(), 0);
        for row in failures {
            let (test, count) = keeper.keep(&name, &recording, row)?;
            kept.push(test);
            tests = count;
        }
        // Two drivers that fail at the same plan have one test.
        kept.dedup();
        Ok(json!({"kept": kept, "tests": tests, "folder": keeper.out.display().to_string()}))
    }
}
