//! Drives one scene with all policies and attacks, and writes its files.

use std::{path::Path, sync::Arc, time::Instant};

use advsage::{
    as_cause,
    ego::Ego,
    rows::{
        GeneratedBy,
        drive::{DriveAttack, DriveRow, RowHead},
    },
};
use anyhow::{Context as _, Result};
use sage_core::scene::{Scene, SceneIndex, Track};
use sage_data::{ReadOptions, Recording, checks};
use sage_run::{
    output::DatasetRun,
    scene_queue::{FoundRow, Line, SceneFile, SceneJob, SceneReport},
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    drive::Drive,
    episode::Episode,
    policy::{Shown, StepTimes, Timed},
    traffic::Plan,
};
use sage_view::player::{self, Page, Panel, Sweep};

use super::{Attacked, Job, attacks::SceneAttacks};

/// Most drives of a driver that are shown side by side. More share a box with a slider.
const MOST_BESIDE: usize = 5;

/// Name of the page of a scene.
pub(super) fn page_file(scene: &str) -> String {
    format!("{scene}.html")
}

impl SceneJob for Job<'_> {
    type Error = anyhow::Error;

    fn reading(&self) -> ReadOptions {
        self.args.reading.options()
    }

    fn rows(&self, scene: &str) -> Vec<String> {
        self.files(scene).map(|(_, _, file)| file).collect()
    }

    fn found(&self, number: usize, path: &Path) -> Option<FoundRow> {
        let row = DriveRow::read(path)?;
        let variants = self.variants();
        let line = format!("{} (finished before)", row.line(&variants[number % variants.len()]));
        Some(FoundRow { line, source_hash: row.source_hash, files: Vec::new() })
    }

    fn pages(&self, scene: &str) -> Vec<String> {
        vec![page_file(scene)]
    }

    fn work(&self, run: &DatasetRun, scene: &SceneFile, recording: Recording) -> Result<SceneReport> {
        let name = &scene.input.scene;
        let options = &self.args.options;
        let wanted = options.adversary.as_deref();
        let placed = match &self.attacked {
            Attacked::FromFile(file) => file.generated().placed.clone(),
            _ => options.adversary().placed(),
        };
        let recording = match placed {
            Some(placed) => placed.of(recording)?,
            None => recording,
        };
        let (attacks, adversary) = SceneAttacks::of(&self.attacked, &recording, name, &scene.hash, wanted)?;
        let clock = Instant::now();
        let driven = recording.scene.with_roles(None, adversary.as_deref())?;
        let drives = SceneDrives { simulation: self, run, name, source_hash: &scene.hash, attacks };
        let warnings = checks::important(&driven);
        Ok(SceneReport { warnings, ..drives.simulate(Arc::new(driven), clock)? })
    }
}

/// One drive with its row, or one whose planner failed.
struct DrivenRow {
    ego: usize,
    /// Number among the drives of its driver.
    variant: usize,
    label: String,
    swept: Option<(&'static str, f64)>,
    plan: Option<Plan>,
    result: DriveResult,
    /// Mean time of a step of the driver in this scene, milliseconds.
    step_ms: Option<f64>,
}

enum DriveResult {
    Driven(Episode, Box<DriveRow>),
    Failed(PlannerFailure),
}

/// A planner that failed.
struct PlannerFailure {
    message: String,
    /// The message without scene and log, for the page.
    ending: String,
    /// The drive up to there, if it had begun.
    drive: Option<Box<Drive>>,
}

impl PlannerFailure {
    /// The failure of an error that is one of a planner.
    ///
    /// *Errors*: any other error.
    fn of(error: anyhow::Error) -> Result<Self> {
        let Some(sage_sim::Error::Planner { drive, log, problem, .. }) = error.chain().find_map(as_cause)
        else {
            return Err(error);
        };
        let drive = drive.clone().map(|mut drive| {
            let step = drive.motions.len() - 1;
            drive.shown.push(Shown { step, plan: Vec::new(), log: log.lines.join("\n") });
            drive
        });
        let ending = format!("No result: {problem}.");
        Ok(Self { message: format!("{error:#}"), ending, drive })
    }
}

/// Drives one scene.
struct SceneDrives<'s> {
    simulation: &'s Job<'s>,
    run: &'s DatasetRun,
    name: &'s str,
    source_hash: &'s str,
    attacks: SceneAttacks<'s>,
}

impl SceneDrives<'_> {
    fn simulate(&self, scene: Arc<Scene>, clock: Instant) -> Result<SceneReport> {
        let index = SceneIndex::new(scene.map.clone());
        let simulated = SimScene::new(scene.clone(), index.clone())?;
        let mut rows: Vec<DrivenRow> = Vec::new();
        let mut unattacked: Vec<Option<Drive>> = Vec::new();
        for number in 0..self.simulation.egos.len() {
            let before = match self.drives_of(number, &scene, &simulated, &mut rows) {
                Ok(before) => before,
                Err(error) => {
                    // Without its unchanged drive there are no attacks on it.
                    let result = DriveResult::Failed(PlannerFailure::of(error)?);
                    let label = String::new();
                    let (swept, plan, step_ms) = (None, None, None);
                    rows.push(DrivenRow { ego: number, variant: 0, label, swept, plan, result, step_ms });
                    None
                }
            };
            unattacked.push(before);
        }
        let seconds = clock.elapsed().as_secs_f64() / rows.len().max(1) as f64;
        self.write(&scene, &rows, &unattacked, seconds)
    }

    /// All drives of one driver. Returns its drive before the attacks, if it is attacked.
    ///
    /// *Errors*: the scene cannot be attacked or driven; a planner that fails in the unchanged scene.
    fn drives_of(
        &self,
        number: usize,
        scene: &Arc<Scene>,
        simulated: &Arc<SimScene>,
        rows: &mut Vec<DrivenRow>,
    ) -> Result<Option<Drive>> {
        let (ego, seed) = (&self.simulation.egos[number], self.simulation.args.options.generator.seed);
        let failed = || format!("the policy `{}` cannot drive here", ego.label);
        let (times, first) = (Arc::new(StepTimes::default()), rows.len());
        let policy = Timed::new(&*ego.policy, times.clone());
        let test = self.attacks.has_attack().then(|| AttackTest::new(&policy, simulated, seed));
        let test = test.transpose().with_context(failed)?;
        for (variant, planned) in self.attacks.planned(test.as_ref())?.into_iter().enumerate() {
            let (label, swept, generated) = (planned.label, planned.swept, planned.generated);
            let plan =
                planned.attack.as_ref().map(|a| Plan::of_adversary(scene, &a.path.trajectory)).transpose()?;
            let driven = match (planned.attack, &test) {
                (Some(attack), Some(test)) => test
                    .attack_along(attack.path.clone(), attack.feasible)
                    .with_context(failed)
                    .and_then(|outcome| {
                        let row = attack.row(outcome.verdict, &outcome.episode, test.unattacked())?;
                        Ok((outcome.episode, Some(row)))
                    }),
                _ => Episode::run(simulated, None, &policy, seed)
                    .with_context(failed)
                    .map(|episode| (episode, None)),
            };
            let result = match driven {
                Ok((episode, attack)) => {
                    let row = self.row(scene, ego, &episode, generated, attack);
                    DriveResult::Driven(episode, Box::new(row))
                }
                Err(error) => DriveResult::Failed(PlannerFailure::of(error)?),
            };
            rows.push(DrivenRow { ego: number, variant, label, swept, plan, result, step_ms: None });
        }
        rows[first..].iter_mut().for_each(|row| row.step_ms = times.mean());
        self.simulation.times[number].add_all(&times);
        Ok(test.map(|test| test.unattacked().clone()))
    }

    fn row(
        &self,
        scene: &Scene,
        ego: &Ego,
        episode: &Episode,
        generated: GeneratedBy,
        attack: Option<DriveAttack>,
    ) -> DriveRow {
        let head = RowHead {
            run_hash: self.run.hash(),
            scene: self.name,
            ego: &ego.label,
            generated: Some(generated),
            source_hash: self.source_hash,
            seed: self.simulation.args.options.generator.seed,
        };
        DriveRow::new(head, episode, scene, attack)
    }

    /// The panel of a drive; `None` if its planner failed before it began.
    fn panel<'r>(
        &'r self,
        driven: &'r DrivenRow,
        unattacked: &'r [Option<Drive>],
        adversary: Option<&'r Track>,
        is_sweep: bool,
    ) -> Option<Panel<'r>> {
        let egos = &self.simulation.egos;
        let own: Option<&Track> = driven.plan.as_ref().map(|plan| &plan.motion).or(adversary);
        let label = driven.label.replace("lambda ", "λ ");
        let names = [&*egos[driven.ego].label, &*label];
        let name = names.into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ");
        let unattacked = unattacked[driven.ego].as_ref().map(player::shown_part);
        let sweep = driven.swept.filter(|_| is_sweep);
        let sweep = sweep.map(|(axis, value)| Sweep { group: driven.ego, axis, value });
        Some(match &driven.result {
            DriveResult::Driven(episode, row) => Panel { sweep, ..row.panel(name, episode, own, unattacked) },
            DriveResult::Failed(failure) => {
                let drive = failure.drive.as_deref()?;
                Panel {
                    name,
                    id: String::new(),
                    sweep,
                    motions: player::shown_part(drive),
                    end: drive.motions.len() - 1,
                    shown: &drive.shown,
                    contact: None,
                    adversary: own,
                    unattacked,
                    evasion: None,
                    verdict: None,
                    is_failed: true,
                    others: Vec::new(),
                    marks: Vec::new(),
                    badge: None,
                    note: String::new(),
                    ending: failure.ending.clone(),
                }
            }
        })
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
        let per_ego = rows.len() / egos.len().max(1);
        let panel = |driven| self.panel(driven, unattacked, adversary, per_ego > MOST_BESIDE);
        let panels: Vec<Panel> = rows.iter().filter_map(panel).collect();
        let columns = if per_ego > 1 { per_ego } else { rows.len() };
        let page = player::page(&Page {
            scene,
            title: self.name,
            subtitle: &self.simulation.subtitle,
            panels: &panels,
            paths: &[],
            columns,
            back: None,
        })?;
        let mut all = vec![(page_file(self.name), page.into_bytes())];
        let (mut lines, mut failures) = (Vec::new(), Vec::new());
        let names: Vec<(usize, &str, String)> = self.simulation.files(self.name).collect();
        for driven in rows {
            let mut of_ego = names.iter().filter(|(ego, ..)| *ego == driven.ego);
            let Some((_, variant, file)) = of_ego.nth(driven.variant) else { continue };
            match &driven.result {
                DriveResult::Driven(_, row) => {
                    let time = driven.step_ms.map(|ms| format!(" ({ms:.3} ms a step)"));
                    let text = row.line(variant) + &time.unwrap_or_default();
                    all.push((file.clone(), serde_json::to_vec(row)?));
                    let (row, step_ms) = (file.clone(), driven.step_ms);
                    lines.push(Line { text, row, seconds: Some(seconds), step_ms });
                }
                DriveResult::Failed(failure) => failures.push(failure.message.clone()),
            }
        }
        self.run.folder().write_all(&all)?;
        Ok(SceneReport { lines, files: Vec::new(), seconds: Some(seconds), warnings: Vec::new(), failures })
    }
}
