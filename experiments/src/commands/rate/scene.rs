//! Rates the drivers in one scene.

use std::{path::Path, sync::Arc, time::Instant};

use advsage::{
    prepared::DriverInScene,
    rows::{
        rate::{RateOf, RateRow},
        search::RowHead,
    },
};
use anyhow::Result;
use sage_core::scene::SceneIndex;
use sage_data::{ReadOptions, Recording, checks};
use sage_run::{
    output::DatasetRun,
    scene_queue::{FoundRow, Line, SceneFile, SceneJob, SceneReport},
};
use sage_sim::SimScene;

use super::{Job, page_file, picture, picture_file, player};

impl SceneJob for Job<'_> {
    type Error = anyhow::Error;

    fn reading(&self) -> ReadOptions {
        self.args.reading.options()
    }

    fn rows(&self, scene: &str) -> Vec<String> {
        self.files(scene)
    }

    fn found(&self, _number: usize, path: &Path) -> Option<FoundRow> {
        let row = RateRow::read(path)?;
        Some(FoundRow { line: row.line(), source_hash: row.head.source_hash, files: row.files })
    }

    fn work(&self, run: &DatasetRun, scene: &SceneFile, recording: Recording) -> Result<SceneReport> {
        let warnings = checks::important(&recording.scene);
        let name = &scene.input.scene;
        let attacked = Arc::new(recording.scene.with_roles(None, self.args.adversary.as_deref())?);
        let index = SceneIndex::new(attacked.map.clone());
        let simulated = SimScene::new(attacked.clone(), index.clone())?;
        let clock = Instant::now();
        let nominal = self.rate.nominal(&attacked, &index)?;
        let mut all = Vec::new();
        let (mut lines, mut files) = (Vec::new(), Vec::new());
        for (ego, file) in self.egos.iter().zip(self.files(name)) {
            let failed = || format!("the policy `{}` cannot drive here", ego.label);
            let seed = self.args.seed;
            let driver = DriverInScene::new(&simulated, |scene| {
                ego.test(scene, seed).map_err(|error| advsage::Error::from(error).within(failed()))
            })?;
            let (inclusions, driven) = self.rate.drive(&driver, &nominal)?;
            let head = RowHead {
                run_hash: run.hash().to_owned(),
                scene: name.clone(),
                ego: ego.label.clone(),
                source_hash: scene.hash.clone(),
                seed,
                adversary: driver.ctx.adversary().id.clone(),
            };
            let of = RateOf {
                nominal: &nominal,
                rate: &self.rate,
                inclusions: &inclusions,
                driven: &driven,
                events: &self.args.event,
            };
            let mut row = RateRow::new(head, &of, &driver.test);
            let title = format!("{name}, {}", ego.label);
            let picture = picture::draw(&title, &driver.test.scene_as_driven(), &nominal, &row);
            let mut beside = vec![(picture_file(&file), picture.into_bytes())];
            let page = player::page(&row, &driver.test, &attacked)?;
            beside.extend(page.map(|page| (page_file(&file), page.into_bytes())));
            row.files = beside.iter().map(|(name, _)| name.clone()).collect();
            // The row is written after the files that it names.
            all.extend(beside);
            files.extend(row.files.iter().cloned());
            let seconds = Some(clock.elapsed().as_secs_f64());
            lines.push(Line { text: row.line(), row: file.clone(), seconds, step_ms: None });
            all.push((file, serde_json::to_vec(&row)?));
        }
        run.folder().write_all(&all)?;
        let seconds = Some(clock.elapsed().as_secs_f64() / self.egos.len() as f64);
        Ok(SceneReport { lines, files, seconds, warnings, failures: Vec::new() })
    }
}
