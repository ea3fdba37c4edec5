//! Drives one scene with all policies and attacks, and writes its files.

use std::{sync::Arc, time::Instant};

use anyhow::{Context as _, Result};
use sage_core::{
    files,
    motion::Trajectory,
    objective::{Context, ContextOptions, Scorer},
    scene::{Scene, SceneIndex, Track},
};
use sage_data::Recording;
use sage_sim::{SimScene, drive::Drive, episode::Episode, traffic::Plan};
use serde_json::{Map, Value};

use super::{
    Attacked, Simulation, attack_file,
    row::{AttackRow, Row, RowHead, step},
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
    let recording = Recording::from_bytes(&input.file, bytes).map_err(|error| fail(error.into()))?;
    let attacker = match &simulation.attacked {
        Attacked::Generated(attackers) => {
            let is_procedural =
                !attackers.needs_origin() || recording.is_procedural().map_err(|error| fail(error.into()))?;
            Some(attackers.attacker(is_procedural).map_err(Failure::Run)?)
        }
        _ => None,
    };
    let known = match simulation.attacked {
        Attacked::AsItIs => attack_file::provenance(&recording).map_err(fail)?,
        _ => Map::new(),
    };
    let clock = Instant::now();
    let adversary = simulation.args.options.adversary.as_deref();
    let scene = recording.scene.with_roles(None, adversary).map_err(|error| fail(error.into()))?;
    let drives = SceneDrives { simulation, run, name: &input.scene, source_hash: &source_hash, known };
    drives.simulate(Arc::new(scene), attacker.as_deref(), clock).map_err(fail)
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
        let Some(row) = Row::read(&path) else { return Ok(None) };
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
    Ok(page
        .is_ok_and(|page| page.is_file() && page.len() > 0)
        .then_some(SceneReport { lines, seconds: None }))
}

/// An attack on a driver with what its row says of it.
struct PlannedAttack {
    described: Map<String, Value>,
    label: String,
    /// `None` for the scene as it is.
    attack: Option<(Trajectory, AttackScores)>,
}

/// Scores of an attack against the drive that it was planned against.
struct AttackScores {
    feasible: bool,
    believable: Option<bool>,
    unbelievable: Vec<sage_core::objective::Reason>,
}

/// One drive with its row.
struct DrivenRow {
    ego: usize,
    label: String,
    episode: Episode,
    plan: Option<Arc<Plan>>,
    row: Row,
}

/// Drives one scene.
struct SceneDrives<'s> {
    simulation: &'s Simulation<'s>,
    run: &'s DatasetRun,
    name: &'s str,
    source_hash: &'s str,
    /// How the attack in the scene was generated, as far as its file says.
    known: Map<String, Value>,
}

impl SceneDrives<'_> {
    fn simulate(
        &self,
        scene: Arc<Scene>,
        attacker: Option<&crate::attackers::Attacker>,
        clock: Instant,
    ) -> Result<SceneReport> {
        let index = SceneIndex::new(scene.map.clone());
        let simulated = SimScene::new(scene.clone(), index.clone())?;
        let seed = self.simulation.args.options.seed;
        let mut rows: Vec<DrivenRow> = Vec::new();
        let mut unattacked: Vec<Option<Drive>> = Vec::new();
        for (number, ego) in self.simulation.egos.iter().enumerate() {
            let failed = || format!("the policy `{}` cannot drive here", ego.label);
            let before = match self.simulation.attacked {
                Attacked::AsItIs => None,
                _ => Some(ego.unattacked(&simulated, seed).with_context(failed)?),
            };
            let attacks = self.attacks(&scene, &index, ego, before.as_ref(), attacker)?;
            for planned in attacks {
                let plan =
                    planned.attack.as_ref().map(|(trajectory, _)| Plan::of_adversary(&scene, trajectory));
                let plan = plan.transpose()?.map(Arc::new);
                let episode =
                    Episode::run(&simulated, plan.clone(), &*ego.policy, seed).with_context(failed)?;
                let row = self.row(&scene, ego, &episode, before.as_ref(), &planned)?;
                rows.push(DrivenRow { ego: number, label: planned.label, episode, plan, row });
            }
            unattacked.push(before);
        }
        let seconds = clock.elapsed().as_secs_f64() / rows.len().max(1) as f64;
        self.write(&scene, &rows, &unattacked, seconds)
    }

    /// The attacks on a driver; one without an attack for the scene as it is.
    fn attacks(
        &self,
        scene: &Arc<Scene>,
        index: &Arc<SceneIndex>,
        ego: &Ego,
        before: Option<&Drive>,
        attacker: Option<&crate::attackers::Attacker>,
    ) -> Result<Vec<PlannedAttack>> {
        let context = || {
            let recorded = before.map_or_else(|| scene.clone(), |drive| ego.recorded(scene, drive));
            Context::new(&recorded, index, &ContextOptions::default())
        };
        let scores = |ctx: &Context, trajectory: &Trajectory| {
            let scores = Scorer::new(ctx).scores(&ctx.candidate(trajectory.clone()));
            let (feasible, believable) = (scores.feasible, scores.believable);
            AttackScores { feasible, believable, unbelievable: scores.unbelievable }
        };
        match (&self.simulation.attacked, attacker) {
            (Attacked::Generated(attackers), Some(attacker)) => {
                let ctx = context()?;
                let attacks =
                    attacker.built.generator.attacks(&ctx, &attacker.built.points, attackers.args.seed)?;
                let planned = attacks.into_iter().zip(&attacker.points).map(|(attack, point)| {
                    attack.check(ctx.scene())?;
                    let trajectory = attack.trajectory().clone();
                    let scores = scores(&ctx, &trajectory);
                    let label = if attacker.built.facts.uses_operating_point() {
                        point.long_label()
                    } else {
                        attackers.method.to_string()
                    };
                    let described = attackers.describe(point);
                    Ok(PlannedAttack { described, label, attack: Some((trajectory, scores)) })
                });
                planned.collect()
            }
            (Attacked::FromFile(file), _) => {
                let trajectory = file.trajectory(scene, self.name, self.source_hash)?;
                let scores = scores(&context()?, &trajectory);
                let described = described(file.described());
                Ok(vec![PlannedAttack {
                    described,
                    label: String::new(),
                    attack: Some((trajectory, scores)),
                }])
            }
            _ => {
                let described = described(self.known.clone());
                Ok(vec![PlannedAttack { described, label: String::new(), attack: None }])
            }
        }
    }

    fn row(
        &self,
        scene: &Scene,
        ego: &Ego,
        episode: &Episode,
        before: Option<&Drive>,
        planned: &PlannedAttack,
    ) -> Result<Row> {
        let attack = match (&planned.attack, before) {
            (Some((trajectory, scores)), Some(before)) => {
                let adversary = scene.adversary_index()?;
                Some(AttackRow {
                    adversary: scene.tracks[adversary].id.clone(),
                    trajectory: trajectory.clone(),
                    feasible: scores.feasible,
                    believable: scores.believable,
                    unbelievable: scores.unbelievable.clone(),
                    verdict: episode.verdict(adversary, scores.feasible, before),
                    unattacked_contact: before.contacts.first().map(|contact| step(contact.step)),
                })
            }
            _ => None,
        };
        let head = RowHead {
            run_hash: self.run.hash(),
            scene: self.name,
            ego: &ego.label,
            described: planned.described.clone(),
            source_hash: self.source_hash,
            seed: self.simulation.args.options.seed,
        };
        Ok(Row::new(head, episode, scene, attack))
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
                let id = adversary.map(|track| &*track.id);
                Panel {
                    name: names.into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", "),
                    episode: &driven.episode,
                    adversary: own,
                    unattacked: unattacked[driven.ego].as_ref(),
                    note: driven.row.note(),
                    ending: driven.row.ending(id),
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
        Ok(SceneReport { lines, seconds: Some(seconds) })
    }
}

/// A description whose fields `method` and `lambda` are there, null if they are not known.
fn described(mut known: Map<String, Value>) -> Map<String, Value> {
    for key in ["method", "lambda"] {
        known.entry(key).or_insert(Value::Null);
    }
    known
}
