//! Reads a scene, attacks it at all operating points, and fills and writes the rows and files.

use std::{path::Path, sync::Arc, time::Instant};

use advsage::{
    attacked_files::{self, AttackSummary, AttackedFiles},
    latest_start,
    prepared::Prepared,
    rows::{
        GeneratedBy,
        attack::{AttackRow, ChosenScores, LeftOutRow},
    },
};
use sage_core::{
    generator::Note,
    objective::{Context, Scorer, Scores},
    scene::SceneIndex,
};
use sage_data::{ReadOptions, Recording};
use sage_sim::avoidable::Avoidance;

use super::{
    job::Job,
    measured::{MeasuredAttack, measured},
    names::{page_file, picture_file, row_file},
    scored::{Candidates, ScoredCandidates},
    view::SceneView,
};
use crate::{
    Error, Result,
    output::{self, DatasetRun},
    scene_queue::{self, Line, SceneFile, SceneJob, SceneReport},
};

impl SceneJob for Job<'_> {
    type Error = Error;

    fn reading(&self) -> ReadOptions {
        self.options.reading.clone()
    }

    fn rows(&self, scene: &str) -> Vec<String> {
        self.variants().iter().map(|variant| row_file(scene, variant)).collect()
    }

    fn found(&self, _number: usize, path: &Path) -> Option<scene_queue::FoundRow> {
        let row = AttackRow::read(path)?;
        Some(scene_queue::FoundRow { line: row.line(None), source_hash: row.source_hash, files: row.files })
    }

    fn pages(&self, scene: &str) -> Vec<String> {
        if self.options.no_pages { Vec::new() } else { vec![picture_file(scene), page_file(scene)] }
    }

    fn work(&self, run: &DatasetRun, scene: &SceneFile, recording: Recording) -> Result<SceneReport> {
        SceneWriter::new(self, run, scene).attack(recording)
    }

    /// Rows that say why, so that the run is complete without the scene.
    fn leave_out(&self, run: &DatasetRun, scene: &SceneFile, reason: &str) -> Result<Vec<Line>> {
        SceneWriter::new(self, run, scene).leave_out(reason)
    }
}

/// Writes the attacks of one scene.
struct SceneWriter<'w> {
    job: &'w Job<'w>,
    run: &'w DatasetRun,
    scene: &'w str,
    source_hash: &'w str,
}

impl<'w> SceneWriter<'w> {
    fn new(job: &'w Job<'w>, run: &'w DatasetRun, scene: &'w SceneFile) -> Self {
        Self { job, run, scene: &scene.input.scene, source_hash: &scene.hash }
    }

    fn attack(&self, recording: Recording) -> Result<SceneReport> {
        let job = self.job;
        let generator = &job.generator;
        let adversary = &job.options.adversary;
        let recording = adversary.of(recording)?;
        let warnings = adversary.warnings(&recording.scene);
        let files = AttackedFiles::new(&recording, self.scene, job.options.format, job.scenario_options())?;
        files.check_names(job.variants().iter().map(|variant| &**variant))?;
        let scene = Arc::new(recording.scene);
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        let seed = generator.spec.seed;
        let drives = |scene: &_| job.ego.test(scene, seed);
        let prepared = Prepared::new(scene, &index, &*job.ego.policy, drives)?;
        let (test, ctx) = (&prepared.test, &prepared.ctx);
        let scene = ctx.scene().clone();
        let avoidance = Avoidance::new(ctx, job.options.avoidable.unwrap_or_default())?;
        let clock = Instant::now();
        let mut attacks = generator.built.attacks(ctx, prepared.against(), seed)?;
        let objective = &generator.selection.objective;
        if let Some(target) = job.options.latest_start {
            for (point, attack) in generator.points.iter().zip(&mut attacks) {
                let avoided =
                    latest_start::avoidable_candidates(attack, ctx, objective, point.mu, &avoidance);
                latest_start::choose(attack, &avoided, target);
            }
        }
        let seconds = clock.elapsed().as_secs_f64() / attacks.len() as f64;
        let scorer = Scorer::with(ctx, &generator.further);
        let mut scored = ScoredCandidates::new(ctx, scorer, objective, &avoidance);
        let measured = measured(&attacks, &mut scored, ctx, &job.ego, test.as_ref(), seed)?;
        let scenarios = files.scenarios(&scene);
        let mut lines = Vec::with_capacity(measured.len());
        let (mut written_files, command) = (Vec::new(), output::command());
        for ((point, variant), attack) in generator.points.iter().zip(job.variants()).zip(&measured) {
            let generated = job.generated_by(point);
            let written = attacked_files::Attack {
                trajectory: attack.attack.trajectory(),
                variant,
                generated: &generated,
                weights: generator.weights_name(),
                seed: job.generator.spec.seed,
                command: &command,
            };
            let mut scene_files = files.files(&scene, &written)?;
            let scores = &scored.get(attack.attack.trajectory())?.scores;
            if let Some(scenarios) = &scenarios {
                let facts = self.summary(ctx, attack, scores).and(&generated);
                scene_files.extend(files.scenario(scenarios, &scene, &written, &facts)?);
            }
            let candidates =
                if job.options.no_candidates { Vec::new() } else { scored.rows(attack.attack)? };
            let mut row = self.row(attack, scores, ctx, variant, generated, candidates);
            row.files = scene_files.iter().map(|(name, _)| name.clone()).collect();
            let name = row_file(self.scene, variant);
            lines.push(Line {
                text: row.line(Some(seconds)),
                row: name.clone(),
                seconds: Some(seconds),
                step_ms: None,
            });
            // The row is written last, because its presence means that its scene files are complete.
            scene_files.push((name, serde_json::to_vec(&row)?));
            written_files.append(&mut row.files);
            self.run.folder().write_all(&scene_files)?;
        }
        if !job.options.no_pages {
            let shown = SceneView { job, name: self.scene, ctx, measured: &measured };
            let (picture, page) = (shown.picture(), shown.page(&scored)?);
            self.run.folder().write_all(&[
                (picture_file(self.scene), picture.into_bytes()),
                (page_file(self.scene), page.into_bytes()),
            ])?;
        }
        Ok(SceneReport {
            lines,
            files: written_files,
            seconds: Some(seconds),
            warnings,
            failures: Vec::new(),
        })
    }

    fn leave_out(&self, reason: &str) -> Result<Vec<Line>> {
        let mut lines = Vec::new();
        for variant in self.job.variants() {
            let row = LeftOutRow {
                run_hash: self.run.hash().to_owned(),
                scene: self.scene.to_owned(),
                variant: variant.clone(),
                source_hash: self.source_hash.to_owned(),
                files: [],
                left_out: reason.to_owned(),
            };
            let (name, bytes) = (row_file(self.scene, variant), serde_json::to_vec(&row)?);
            self.run.folder().write(&name, &bytes)?;
            lines.push(Line { text: row.line(), row: name, seconds: None, step_ms: None });
        }
        Ok(lines)
    }

    /// What an OpenSCENARIO file says about its attack.
    fn summary<'f>(&self, ctx: &'f Context, attack: &MeasuredAttack, scores: &Scores) -> AttackSummary<'f> {
        let candidate = ctx.candidate(attack.attack.trajectory().clone());
        let violations = self.job.generator.selection.objective.rule().violations(&candidate, ctx);
        AttackSummary {
            seed: self.job.generator.spec.seed,
            adversary: &ctx.adversary().id,
            feasible: violations.is_empty(),
            collision_step: scores.collision_step,
            adversarial_reward: scores.adversarial_reward,
            kinematic_penalty: scores.kinematic_penalty,
            behavior_penalty: scores.behavior_penalty,
        }
    }

    fn row<'c>(
        &self,
        measured: &MeasuredAttack,
        scores: &Scores,
        ctx: &Context,
        variant: &str,
        generated: GeneratedBy,
        candidates: Candidates<'c>,
    ) -> AttackRow<Candidates<'c>> {
        let MeasuredAttack { attack, avoidable, references, outcome, counts, .. } = measured;
        let selected = ctx.candidate(attack.trajectory().clone());
        let violations = self.job.generator.selection.objective.rule().violations(&selected, ctx);
        AttackRow {
            run_hash: self.run.hash().to_owned(),
            scene: self.scene.to_owned(),
            variant: variant.to_owned(),
            source_hash: self.source_hash.to_owned(),
            files: Vec::new(),
            seed: self.job.generator.spec.seed,
            adversary: ctx.adversary().id.clone(),
            generated,
            trajectory: attack.trajectory().clone(),
            chosen: attack.chosen,
            feasible: violations.is_empty(),
            violations,
            outcome: *outcome,
            counts: counts.clone(),
            note: attack.note.as_ref().map(Note::to_string),
            extension: attack.extension.clone(),
            scores: ChosenScores {
                scores: scores.clone(),
                avoidable: avoidable.clone(),
                references: references.clone(),
            },
            candidates,
        }
    }
}
