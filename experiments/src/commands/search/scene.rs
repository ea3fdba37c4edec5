//! Searches one scene and writes its files.

use std::{path::Path, sync::Arc, time::Instant};

use advsage::{
    attacked_files::{Attack, AttackFormats, AttackedFiles, Scenarios},
    operating_point::RowKey,
    prepared::DriverInScene,
    rows::{
        GeneratedBy,
        contact::step,
        evaluated::EvaluatedRow,
        failure::{FailureOf, FailureRow},
        plan::PlanRow,
        search::{
            DrivenRow, DrivesFile, RowHead, SceneRow, drives_file, failure_name, row_file, unchanged_file,
        },
    },
};
use anyhow::{Result, anyhow};
use sage_core::scene::{Scene, SceneIndex};
use sage_data::{ReadOptions, Recording};
use sage_run::{
    output::{self, DatasetRun},
    scene_queue::{FoundRow, Line, SceneFile, SceneJob, SceneReport},
};
use sage_sim::{
    SimScene,
    policy::{StepTimes, Timed},
    search::{Pool, Reason, SearchResult},
    vehicle::Motion,
};
use sage_view::player::shown_part;
use serde_json::json;

use super::{picture, searcher::Searcher};

/// Name of the picture of a scene.
pub(super) fn picture_file(scene: &str) -> String {
    format!("{scene}.svg")
}

impl SceneJob for Searcher<'_> {
    type Error = anyhow::Error;

    fn reading(&self) -> ReadOptions {
        self.args.reading.options()
    }

    fn rows(&self, scene: &str) -> Vec<String> {
        vec![row_file(scene)]
    }

    fn found(&self, _number: usize, path: &Path) -> Option<FoundRow> {
        // Another --budget continues the run: with a smaller one the row stays.
        let row = SceneRow::read(path).filter(|row| row.covers(self.options.budget))?;
        Some(FoundRow { line: row.line(None), source_hash: row.head.source_hash, files: row.files })
    }

    fn work(&self, run: &DatasetRun, scene: &SceneFile, recording: Recording) -> Result<SceneReport> {
        let one = OneScene { searcher: self, run, name: &scene.input.scene, source_hash: &scene.hash };
        one.search(recording)
    }
}

/// Searches one scene.
struct OneScene<'s> {
    searcher: &'s Searcher<'s>,
    run: &'s DatasetRun,
    name: &'s str,
    source_hash: &'s str,
}

impl OneScene<'_> {
    fn search(&self, recording: Recording) -> Result<SceneReport> {
        let searcher = self.searcher;
        let args = searcher.args;
        let clock = Instant::now();
        let adversary = args.attack.adversary();
        let recording = adversary.of(recording)?;
        let warnings = adversary.warnings(&recording.scene);
        let files = AttackedFiles::new(&recording, self.name, args.format, searcher.scenario_options())?;
        files.check_names([&*failure_name(searcher.options.budget)].into_iter())?;
        let scene = Arc::new(recording.scene.clone());
        let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
        let failed = || format!("the policy `{}` cannot drive here", searcher.ego.label);
        let times = Arc::new(StepTimes::default());
        let policy = Timed::new(&*searcher.ego.policy, times.clone());
        let drives = |scene: &_| {
            let clock = Instant::now();
            let test = searcher.ego.test_of(&policy, scene, args.attack.generator.seed);
            searcher.estimate.tell(&searcher.ego.label, args.budget, clock.elapsed());
            test.map_err(|error| advsage::Error::from(error).within(failed()))
        };
        let driver = DriverInScene::new(&simulated, drives)?;
        let (pool, result) = searcher.search(&driver, args.attack.generator.seed)?;
        let DriverInScene { test, ctx } = driver;
        if result.reason == Some(Reason::Error) {
            let first =
                result.driven.first().and_then(|evaluated| evaluated.error.clone()).unwrap_or_default();
            return Err(anyhow!("every attacked drive ended in an error; the first: {first}"));
        }
        let head = RowHead {
            run_hash: self.run.hash().to_owned(),
            scene: self.name.to_owned(),
            ego: searcher.ego.label.clone(),
            source_hash: self.source_hash.to_owned(),
            seed: args.attack.generator.seed,
            adversary: ctx.adversary().id.clone(),
        };
        let source = |number| searcher.plans().source(number);
        let mut row = SceneRow::new(head, &searcher.options, &pool, &result, source);
        row.unattacked_contact = test.unattacked().contacts.first().map(|contact| step(contact.step));
        let unattacked = test.unattacked_drive();
        row.unattacked_completion = unattacked.completion;
        row.unattacked_off_road = unattacked.is_off_road();
        row.unattacked_off_plan = unattacked.off_plan;
        let pose = |motion: &Motion| [motion.position[0], motion.position[1], motion.heading];
        row.unattacked_path = shown_part(test.unattacked()).iter().map(pose).collect();
        // In the written scenes the ego keeps its recording, so that any driver meets the attack on the same route.
        row.files = self.write_failures(&files, &scene, &row.head, &pool, &result)?;
        let mut written = Vec::new();
        if !result.failures.is_empty() && args.format != AttackFormats::Rows {
            written.push((unchanged_file(self.name), recording.to_native()?));
        }
        written.push((drives_file(self.name), serde_json::to_vec(&self.drives(&row.head, &pool, &result))?));
        let picture = picture::draw(self.name, &test.scene_as_driven(), &pool, &result);
        written.push((picture_file(self.name), picture.into_bytes()));
        row.files.extend(written.iter().map(|(name, _)| name.clone()));
        // Several failures share the map of their scenarios.
        row.files.sort();
        row.files.dedup();
        // The row is written last, because its presence means that the other files are complete.
        written.push((row_file(self.name), serde_json::to_vec(&row)?));
        self.run.folder().write_all(&written)?;
        let seconds = clock.elapsed().as_secs_f64();
        let line = Line {
            text: row.line(Some(seconds)),
            row: row_file(self.name),
            seconds: Some(seconds),
            step_ms: times.mean(),
        };
        Ok(SceneReport {
            lines: vec![line],
            files: row.files,
            seconds: Some(seconds),
            warnings,
            failures: Vec::new(),
        })
    }

    /// Writes the rows and scenes of all failures, one after the other: a search may have very many. Returns their names.
    fn write_failures(
        &self,
        files: &AttackedFiles,
        scene: &Scene,
        head: &RowHead,
        pool: &Pool,
        result: &SearchResult,
    ) -> Result<Vec<String>> {
        let scenarios = files.scenarios(scene);
        let mut names = Vec::new();
        for number in 0..result.failures.len() {
            let found = FailureOf { pool, result, number };
            let written = self.one_failure(files, scenarios.as_ref(), scene, head, found)?;
            self.run.folder().write_all(&written)?;
            names.extend(written.into_iter().map(|(name, _)| name));
        }
        Ok(names)
    }

    fn one_failure(
        &self,
        files: &AttackedFiles,
        scenarios: Option<&Scenarios>,
        scene: &Scene,
        head: &RowHead,
        found: FailureOf,
    ) -> Result<Vec<(String, Vec<u8>)>> {
        let evaluated = found.evaluated();
        let searcher = self.searcher;
        let key = searcher.plans().source(found.pool.plans[evaluated.plan].source);
        let generated = self.generated_by(key);
        let mut row = FailureRow::new(head, found, Some(generated.clone()), key);
        let attack = Attack {
            trajectory: &row.trajectory,
            variant: &row.variant,
            generated: &generated,
            weights: searcher.weights_name(),
            seed: head.seed,
            command: &output::command(),
        };
        let mut all = files.files(scene, &attack)?;
        if let Some(scenarios) = scenarios {
            let mut facts = generated.to_map();
            facts.insert("seed".to_owned(), json!(head.seed));
            facts.insert("adversary".to_owned(), json!(head.adversary));
            let after = evaluated.contact.as_ref().map(|met| met.step as f64 / 10.0);
            facts.insert("contact_after_seconds".to_owned(), json!(after));
            facts.insert("adversarial_reward".to_owned(), json!(evaluated.reward));
            all.extend(files.scenario(scenarios, scene, &attack, &facts)?);
        }
        row.files = all.iter().map(|(name, _)| name.clone()).collect();
        all.push((row_file(&format!("{}-{}", self.name, row.variant)), serde_json::to_vec(&row)?));
        Ok(all)
    }

    /// How a plan was generated; `key` is its source.
    fn generated_by(&self, key: Option<&RowKey>) -> GeneratedBy {
        let merger = &self.searcher.args.attack.generator.merger;
        let of_plan = key.map_or_else(
            || GeneratedBy { merger: Some(merger.to_string()), ..GeneratedBy::default() },
            |key| GeneratedBy::at(&key.part(), merger, key.point.as_ref()),
        );
        let options = of_plan.options.clone().filter(|options| !options.is_empty());
        let placed = self.searcher.args.attack.adversary().placed();
        GeneratedBy { options, search: Some(self.searcher.options), placed, ..of_plan }
    }

    fn drives<'r>(&'r self, head: &'r RowHead, pool: &'r Pool, result: &'r SearchResult) -> DrivesFile<'r> {
        let row = |evaluated: &'r sage_sim::search::Evaluated| {
            let plan = &pool.plans[evaluated.plan];
            DrivenRow {
                plan: PlanRow::new(pool, evaluated.plan, self.searcher.plans().source(plan.source)),
                evaluated: EvaluatedRow::of(evaluated),
                latest_start: evaluated.latest_start,
                error: evaluated.error.as_deref(),
                trajectory: &plan.proposal.trajectory,
            }
        };
        DrivesFile { head, drives: result.driven.iter().map(row).collect() }
    }
}
