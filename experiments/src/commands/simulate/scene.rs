//! Drives one scene with all policies and attacks, and writes its files.

use std::{sync::Arc, time::Instant};

use anyhow::{Context as _, Result};
use sage_core::{
    files,
    scene::{Scene, SceneIndex, Track},
};
use sage_data::{Recording, checks};
use sage_sim::{SimScene, attack_test::AttackTest, drive::Drive, episode::Episode, traffic::Plan};

use serde_json::{Map, Value};

use super::{
    Simulation,
    attacks::SceneAttacks,
    row::{AttackRow, DriveRow, RowHead},
};
use crate::{
    ego::Ego,
    output::DatasetRun,
    player::{self, Panel},
    scene_queue::{Failure, Input, Line, SceneReport, is_row_of},
};

/// Name of the page of a scene.
pub(super) fn page_file(scene: &str) -> String {
    format!("{scene}.html")
}

/// Drives a scene and writes its rows and its page, unless they exist.
///
/// *Errors*: [`Failure`].
pub(super) fn simulate_scene(
    simulation: &Simulation,
    run: &DatasetRun,
    input: &Input,
) -> Result<SceneReport, Failure> {
    let fail = |error: anyhow::Error| Failure::Scene(error);
    let bytes = sage_data::read_bytes(&input.file).map_err(|error| fail(error.into()))?;
    let source_hash = blake3::hash(&bytes).to_hex()[..16].to_owned();
    if let Some(found) = finished(simulation, run, input, &source_hash).map_err(fail)? {
        return Ok(found);
    }
    let recording = Recording::from_bytes_as(&input.file, bytes, &simulation.args.reading.options())
        .map_err(|error| fail(error.into()))?;
    let wanted = simulation.args.options.adversary.as_deref();
    let (attacks, adversary) =
        SceneAttacks::of(&simulation.attacked, &recording, &input.scene, &source_hash, wanted)?;
    let clock = Instant::now();
    let scene = recording.scene.with_roles(None, adversary.as_deref()).map_err(|error| fail(error.into()))?;
    let drives = SceneDrives { simulation, run, name: &input.scene, source_hash: &source_hash, attacks };
    let warnings = checks::important(&scene);
    let report = drives.simulate(Arc::new(scene), clock).map_err(|error| match error.downcast_ref() {
        Some(sage_core::Error::ContactNow { .. }) => {
            Failure::LeftOut { reason: format!("{error:#}"), lines: Vec::new() }
        }
        _ => fail(error),
    })?;
    Ok(SceneReport { warnings, ..report })
}

/// The lines of a scene whose files all exist; `None` if any is missing.
///
/// *Errors*: the rows are of another input file with the same name.
fn finished(
    simulation: &Simulation,
    run: &DatasetRun,
    input: &Input,
    source_hash: &str,
) -> Result<Option<SceneReport>> {
    let folder = run.folder().path();
    let mut lines = Vec::new();
    for (_, variant, file) in simulation.files(&input.scene) {
        let path = folder.join(&file);
        if !is_row_of(&path, run.hash()) {
            return Ok(None);
        }
        let Some(row) = DriveRow::read(&path) else { return Ok(None) };
        anyhow::ensure!(
            row.source_hash == source_hash,
            "`{}` is of another `{}`; give --force to replace it, or name another --out",
            path.display(),
            input.file.display()
        );
        lines.push(Line {
            text: format!("{} (finished before)", row.line(variant)),
            row: file,
            seconds: None,
        });
    }
    let page = std::fs::metadata(folder.join(page_file(&input.scene)));
    Ok(page.is_ok_and(|page| page.is_file() && page.len() > 0).then(|| SceneReport::found(lines)))
}

/// One drive with its row.
struct DrivenRow {
    ego: usize,
    label: String,
    episode: Episode,
    plan: Option<Plan>,
    /// Step of the planned contact with the drive before.
    contact: Option<usize>,
    row: DriveRow,
}

/// Drives one scene.
struct SceneDrives<'s> {
    simulation: &'s Simulation<'s>,
    run: &'s DatasetRun,
    name: &'s str,
    source_hash: &'s str,
    attacks: SceneAttacks<'s>,
}

impl SceneDrives<'_> {
    fn simulate(&self, scene: Arc<Scene>, clock: Instant) -> Result<SceneReport> {
        let index = SceneIndex::new(scene.map.clone());
        let simulated = SimScene::new(scene.clone(), index.clone())?;
        let seed = self.simulation.args.options.seed;
        let mut rows: Vec<DrivenRow> = Vec::new();
        let mut unattacked: Vec<Option<Drive>> = Vec::new();
        for (number, ego) in self.simulation.egos.iter().enumerate() {
            let failed = || format!("the policy `{}` cannot drive here", ego.label);
            let test = self.attacks.has_attack().then(|| AttackTest::new(&*ego.policy, &simulated, seed));
            let test = test.transpose().with_context(failed)?;
            for planned in self.attacks.planned(test.as_ref())? {
                let (label, described) = (planned.label, planned.described);
                let (episode, attack) = match (planned.attack, &test) {
                    (Some(attack), Some(test)) => {
                        let outcome =
                            test.attack(&attack.trajectory, attack.feasible).with_context(failed)?;
                        (outcome.episode, Some((attack, outcome.verdict, test.unattacked())))
                    }
                    _ => (Episode::run(&simulated, None, &*ego.policy, seed).with_context(failed)?, None),
                };
                let contact = attack.as_ref().and_then(|(attack, ..)| attack.contact);
                let plan = attack.as_ref().map(|(a, ..)| Plan::of_adversary(&scene, &a.trajectory));
                let plan = plan.transpose()?;
                let attack = attack.map(|(attack, verdict, before)| attack.row(verdict, before));
                let row = self.row(&scene, ego, &episode, described, attack);
                rows.push(DrivenRow { ego: number, label, episode, plan, contact, row });
            }
            unattacked.push(test.map(|test| test.unattacked().clone()));
        }
        let seconds = clock.elapsed().as_secs_f64() / rows.len().max(1) as f64;
        self.write(&scene, &rows, &unattacked, seconds)
    }

    fn row(
        &self,
        scene: &Scene,
        ego: &Ego,
        episode: &Episode,
        described: Map<String, Value>,
        attack: Option<AttackRow>,
    ) -> DriveRow {
        let head = RowHead {
            run_hash: self.run.hash(),
            scene: self.name,
            ego: &ego.label,
            described,
            source_hash: self.source_hash,
            seed: self.simulation.args.options.seed,
        };
        DriveRow::new(head, episode, scene, attack)
    }

    /// Writes the page, then the rows: their presence means that the page is complete.
    fn write(
        &self,
        scene: &Scene,
        rows: &[DrivenRow],
        unattacked: &[Option<Drive>],
        seconds: f64,
    ) -> Result<SceneReport> {
        let egos = &self.simulation.egos;
        let adversary = scene.adversary.map(|k| &scene.tracks[k]);
        let panels: Vec<Panel> = rows
            .iter()
            .map(|driven| {
                let own: Option<&Track> = driven.plan.as_ref().map(|plan| &plan.motion).or(adversary);
                let label = driven.label.replace("lambda ", "λ ");
                let names = [&*egos[driven.ego].label, &*label];
                Panel {
                    name: names.into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", "),
                    episode: &driven.episode,
                    adversary: own,
                    unattacked: unattacked[driven.ego].as_ref(),
                    evasion: driven
                        .contact
                        .and_then(|contact| driven.row.attack.as_ref()?.avoidable.evasion(contact))
                        .map(|(_, rows)| rows),
                    note: driven.row.note(),
                    verdict: driven.row.verdict().map(|verdict| verdict.is_attack),
                    ending: driven.row.ending(),
                }
            })
            .collect();
        let per_ego = rows.len() / egos.len().max(1);
        let columns = if per_ego > 1 { per_ego } else { rows.len() };
        let titles = [self.name, &self.simulation.subtitle];
        let page = player::page(scene, titles, &panels, columns)?;
        let mut all = vec![(page_file(self.name), page.into_bytes())];
        let mut lines = Vec::new();
        for (driven, (_, variant, file)) in rows.iter().zip(self.simulation.files(self.name)) {
            let text = format!("{} ({:.0} ms)", driven.row.line(variant), 1e3 * seconds);
            all.push((file.clone(), serde_json::to_vec(&driven.row)?));
            lines.push(Line { text, row: file, seconds: Some(seconds) });
        }
        let written = files::write_all(
            self.run.folder().path(),
            all.iter().map(|(name, bytes)| (&name[..], &bytes[..])),
        );
        written.or_else(|(path, error)| {
            Err(error).with_context(|| format!("cannot write `{}`", path.display()))
        })?;
        Ok(SceneReport { lines, seconds: Some(seconds), warnings: Vec::new() })
    }
}
