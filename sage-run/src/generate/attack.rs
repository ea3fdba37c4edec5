//! Reads a scene, attacks it at all operating points, and writes the results.

use std::{num::NonZeroUsize, path::Path, sync::Arc, time::Instant};

use advsage::{
    attacked_files::{self, AttackedFiles, Facts},
    is_contact_now, latest_start,
    prepared::Prepared,
    rows::{
        attack::{CandidateRow, ChosenScores, LeftOutRow, VariantRow, prevented},
        found_attack::FoundRow,
    },
};
use anyhow::{Context as _, Result, anyhow};
use sage_core::{
    files,
    generator::Note,
    objective::{Context, Scorer, Scores},
    scene::SceneIndex,
};
use sage_data::{Recording, checks};
use sage_sim::avoidable::Avoidance;
use serde_json::{Map, Value};

use super::{
    measured::{MeasuredAttack, measured},
    names::{page_file, picture_file, row_file},
    plan::Plan,
    scored::ScoredCandidates,
    view::SceneView,
};
use crate::{
    output::{self, DatasetRun},
    scene_queue::{Failure, Line, SceneReport},
};

/// Attacks a scene at all operating points and writes its files, unless they exist.
///
/// *Errors*: [`Failure`].
pub(super) fn attack_scene(
    plan: &Plan,
    run: &DatasetRun,
    file: &Path,
    scene: &str,
) -> Result<SceneReport, Failure> {
    let fail = |error: anyhow::Error| Failure::Scene(error);
    let bytes = sage_data::read_bytes(file).map_err(|error| fail(error.into()))?;
    let source_hash = plan.options.reading.source_hash(&bytes)[..16].to_owned();
    if let Some(found) = finished(plan, run, file, scene, &source_hash).map_err(fail)? {
        return Ok(found);
    }
    let recording =
        Recording::from_bytes_as(file, bytes, &plan.options.reading).map_err(|error| fail(error.into()))?;
    let writer = SceneWriter { plan, run, scene, source_hash: &source_hash };
    writer.attack(recording).map_err(|error| match error.chain().any(is_contact_now) {
        true => {
            let reason = format!("{error:#}");
            match writer.leave_out(&reason) {
                Ok(lines) => Failure::LeftOut { reason, lines },
                Err(error) => fail(error),
            }
        }
        false => fail(error),
    })
}

/// The lines of a scene whose files all exist; `None` if any is missing.
///
/// *Errors*: the rows are of another input file with the same name.
fn finished(
    plan: &Plan,
    run: &DatasetRun,
    file: &Path,
    scene: &str,
    source_hash: &str,
) -> Result<Option<SceneReport>> {
    let folder = run.folder().path();
    // No scene file is empty.
    let exists =
        |name: &String| std::fs::metadata(folder.join(name)).is_ok_and(|f| f.is_file() && f.len() > 0);
    let mut lines = Vec::with_capacity(plan.variants().len());
    let mut files = Vec::new();
    for variant in plan.variants() {
        let name = row_file(scene, variant);
        let path = folder.join(&name);
        // A row of another run remains after --force with fewer scenes or shards.
        let Some(row) = FoundRow::read(&path).filter(|row| row.run_hash == run.hash()) else {
            return Ok(None);
        };
        if row.source_hash != source_hash {
            return Err(anyhow!(
                "`{}` was generated from another `{}`; remove it to do the scene again, or name another --out",
                path.display(),
                file.display()
            ));
        }
        if !row.files.iter().all(exists) {
            return Ok(None);
        }
        lines.push(Line { text: row.line(), row: name, seconds: None });
        files.extend(row.files);
    }
    let has_pages = || exists(&picture_file(scene)) && exists(&page_file(scene));
    Ok((plan.options.no_pages || has_pages()).then(|| SceneReport::found(lines, files)))
}

/// Writes the attacks of one scene.
struct SceneWriter<'w> {
    plan: &'w Plan<'w>,
    run: &'w DatasetRun,
    scene: &'w str,
    source_hash: &'w str,
}

impl SceneWriter<'_> {
    fn attack(&self, recording: Recording) -> Result<SceneReport> {
        let plan = self.plan;
        let generator = &plan.generator;
        let warnings = checks::important(&recording.scene);
        let files = AttackedFiles::new(&recording, self.scene, plan.formats())?;
        files.check_names(plan.variants().iter().map(|variant| &**variant))?;
        let scene = Arc::new(recording.scene.with_roles(None, plan.options.adversary.as_deref())?);
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        let seed = generator.spec.seed;
        let drives = |scene: &_| plan.ego.test(scene, seed);
        let prepared = Prepared::new(scene, &index, &*plan.ego.policy, drives)?;
        let (test, ctx) = (&prepared.test, &prepared.ctx);
        let scene = ctx.scene().clone();
        let avoidance = Avoidance::new(ctx, plan.options.avoidable.unwrap_or_default())?;
        let clock = Instant::now();
        let mut attacks = generator.built.attacks(ctx, prepared.against(), seed)?;
        let objective = &generator.selection.objective;
        if let Some(target) = plan.options.latest_start {
            for (point, attack) in generator.points.iter().zip(&mut attacks) {
                let avoided = latest_start::avoided(attack, ctx, objective, point.mu, &avoidance);
                latest_start::choose(attack, &avoided, target);
            }
        }
        let seconds = clock.elapsed().as_secs_f64() / attacks.len() as f64;
        let scorer = Scorer::with(ctx, &generator.further);
        let mut scored = ScoredCandidates::new(ctx, scorer, objective, &avoidance);
        let measured = measured(&attacks, &mut scored, ctx, (&plan.ego, test.as_ref()), seed)?;
        let scenarios = files.scenarios(&scene);
        let mut lines = Vec::with_capacity(measured.len());
        let (mut written_files, command) = (Vec::new(), output::command());
        for ((point, variant), attack) in generator.points.iter().zip(plan.variants()).zip(&measured) {
            let described = plan.describe(point);
            let written = attacked_files::Attack {
                trajectory: attack.attack.trajectory(),
                variant,
                described: &described,
                weights: generator.weights_name(),
                seed: plan.generator.spec.seed,
                command: &command,
            };
            let mut scene_files = files.files(&scene, &written)?;
            let scores = &scored.get(attack.attack.trajectory())?.scores;
            if let Some(scenarios) = &scenarios {
                let facts = self.facts(ctx, attack, scores).and(&described);
                scene_files.extend(files.scenario(scenarios, &scene, &written, &facts)?);
            }
            let candidates =
                if plan.options.no_candidates { Vec::new() } else { scored.rows(attack.attack)? };
            let row = self.row((attack, scores, candidates), ctx, variant, described, &scene_files);
            lines.push(Line {
                text: row.line(seconds),
                row: row_file(self.scene, variant),
                seconds: Some(seconds),
            });
            let mut all: Vec<(&str, &[u8])> =
                scene_files.iter().map(|(name, bytes)| (&name[..], &bytes[..])).collect();
            // The row is written last, because its presence means that its scene files are complete.
            let (name, bytes) = (row_file(self.scene, variant), serde_json::to_vec(&row)?);
            all.push((&name, &bytes));
            self.write(&all)?;
            written_files.extend(scene_files.into_iter().map(|(name, _)| name));
        }
        if !plan.options.no_pages {
            let shown = SceneView { plan, name: self.scene, ctx, measured: &measured };
            let (picture, page) = (shown.picture(), shown.page(&scored)?);
            self.write(&[
                (&picture_file(self.scene), picture.as_bytes()),
                (&page_file(self.scene), page.as_bytes()),
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

    /// Writes rows that say why the scene is left out, so that the run is complete without it.
    fn leave_out(&self, reason: &str) -> Result<Vec<Line>> {
        let mut lines = Vec::new();
        for variant in self.plan.variants() {
            let row = LeftOutRow {
                run_hash: self.run.hash(),
                scene: self.scene,
                variant,
                source_hash: self.source_hash,
                files: [],
                left_out: reason,
            };
            let (name, bytes) = (row_file(self.scene, variant), serde_json::to_vec(&row)?);
            self.write(&[(&name, &bytes)])?;
            lines.push(Line { text: row.line(), row: name, seconds: None });
        }
        Ok(lines)
    }

    /// What an OpenSCENARIO file says about its attack.
    fn facts<'f>(&self, ctx: &'f Context, attack: &MeasuredAttack, scores: &Scores) -> Facts<'f> {
        let candidate = ctx.candidate(attack.attack.trajectory().clone());
        let violations = self.plan.generator.selection.objective.rule().violations(&candidate, ctx);
        Facts {
            seed: self.plan.generator.spec.seed,
            adversary: &ctx.adversary().id,
            feasible: violations.is_empty(),
            collision_step: scores.collision_step,
            adversarial_reward: scores.adversarial_reward,
            kinematic_penalty: scores.kinematic_penalty,
            behavior_penalty: scores.behavior_penalty,
        }
    }

    fn row<'r>(
        &'r self,
        (measured, scores, candidates): (&'r MeasuredAttack, &'r Scores, Vec<CandidateRow<'r>>),
        ctx: &'r Context,
        variant: &'r str,
        described: Map<String, Value>,
        scene_files: &[(String, Vec<u8>)],
    ) -> VariantRow<'r> {
        let MeasuredAttack { attack, avoidable, references, outcome, counts, .. } = measured;
        let selected = ctx.candidate(attack.trajectory().clone());
        let violations = self.plan.generator.selection.objective.rule().violations(&selected, ctx);
        VariantRow {
            run_hash: self.run.hash(),
            scene: self.scene,
            variant,
            source_hash: self.source_hash,
            files: scene_files.iter().map(|(name, _)| name.clone()).collect(),
            seed: self.plan.generator.spec.seed,
            adversary: &ctx.adversary().id,
            described,
            trajectory: attack.trajectory(),
            chosen: attack.chosen,
            feasible: violations.is_empty(),
            violations,
            outcome: *outcome,
            counts,
            note: attack.note.as_ref().map(Note::to_string),
            queries: NonZeroUsize::new(attack.queries),
            scores: ChosenScores { scores, avoidable, references, r157_avoids: prevented(references) },
            candidates,
        }
    }

    fn write(&self, all: &[(&str, &[u8])]) -> Result<()> {
        let written = files::write_all(self.run.folder().path(), all.iter().copied());
        written
            .or_else(|(path, error)| Err(error).with_context(|| format!("cannot write `{}`", path.display())))
    }
}
