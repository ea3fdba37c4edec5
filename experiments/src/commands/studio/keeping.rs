//! Keeps what the drivers of a choice fail at.

use std::path::Path;

use advsage::rows::failure::FailureRow;
use anyhow::{Context as _, Result, ensure};
use sage_data::ReadOptions;
use sage_run::input::scene_name;
use serde_json::{Value, json};

use super::{choice::Choice, workshop::Workshop};

impl Workshop<'_> {
    /// Keeps what the drivers of a choice fail at.
    ///
    /// *Errors*: nothing is kept; none of them fails; a system error.
    pub(super) fn keep(&self, choice: &Choice) -> Result<Value> {
        choice.check()?;
        let keeper =
            self.keeper.as_ref().context("start `sage studio` with --out FOLDER to keep failures")?;
        let verdicts = choice.drivers.iter().map(|&driver| self.verdict(choice, driver));
        let failures =
            verdicts.collect::<Result<Vec<_>>>()?.into_iter().filter_map(|verdict| verdict.failure);
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
