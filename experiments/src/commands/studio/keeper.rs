//! The suite in which failures are kept.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
};

use super::locked::locked;
use crate::commands::{
    search::found::{FailureScene, json},
    suite::growing::GrowingSuite,
};
use advsage::{attacked_files::AttackFormats, references, rows::failure::FailureRow};
use anyhow::{Context as _, Result, ensure};
use sage_core::objective::PartSpec;
use sage_data::{Format, Recording};
use sage_run::output::Folder;
use sage_sim::{
    avoidable::AvoidanceOptions,
    fault::FaultRule,
    search::{
        Requirement,
        suite::{FILE, Suite, VERSION},
    },
};

/// A suite that is made once the first failure is kept.
pub(super) struct Keeper {
    pub(super) out: PathBuf,
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
    ///
    /// *Errors*: a failure that is not as a search writes it, or a system error.
    pub(super) fn keep(
        &self,
        scene: &str,
        recording: &Recording,
        row: FailureRow,
    ) -> Result<(String, usize)> {
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
