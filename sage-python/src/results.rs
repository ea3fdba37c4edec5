//! Results as the commands record and show them: the rows of their files without what belongs to a run, pages and pictures.

use std::sync::Arc;

use advsage::{
    planned_attack::PlannedAttack,
    rows::{
        contact::step,
        drive::{DriveRow, RowHead},
        failure::{FailureOf, FailureRow},
        search::{RowHead as SearchHead, SceneRow},
    },
    scenario_files,
    search::PlanSources,
};
use sage_core::{
    generator::Extension,
    motion::Trajectory,
    objective::{Context, ContextOptions},
    scene::{Scene, SceneData},
};
use sage_data::{
    Recording,
    openscenario::{Export, Options},
};
use sage_run::Result;
use sage_sim::{
    attack_test::{AttackPath, AttackTest},
    drive::Drive,
    episode::{Episode, Verdict},
    search::{Pool, SearchOptions, SearchResult},
    traffic::Plan,
};
use sage_view::{
    drawing::{self, Picture, drawn_path},
    player::{self, Page},
};
use serde_json::Value;

/// Fields of rows that say which run and file they are of.
const OF_RUN: [&str; 4] = ["run_hash", "source_hash", "files", "variant"];

/// A drive, and what attacked it.
pub(crate) struct DriveResult<'a> {
    /// The scene.
    pub(crate) scene: &'a Scene,
    /// Its name.
    pub(crate) name: &'a str,
    /// The driver.
    pub(crate) ego: &'a str,
    /// Seed of the drive.
    pub(crate) seed: u64,
    /// The drive.
    pub(crate) episode: &'a Episode,
    /// What attacked it; `None` for the scene as it is.
    pub(crate) attack: Option<AttackOfDrive<'a>>,
}

/// An attack on a driver.
#[derive(Clone, Copy)]
pub(crate) struct AttackOfDrive<'a> {
    /// The scene with the drive before the attack, which the attack was planned against.
    pub(crate) ctx: &'a Context,
    /// That drive.
    pub(crate) before: &'a Drive,
    /// The adversary's plan.
    pub(crate) trajectory: &'a Trajectory,
    /// Whether the driver falls for it.
    pub(crate) verdict: Verdict,
    /// What the generator adds to the attack.
    pub(crate) extension: Option<&'a Extension>,
}

impl DriveResult<'_> {
    fn drive_row(&self) -> Result<DriveRow> {
        let attack = self.attack.map(|attack| -> Result<_> {
            let path = AttackPath::of(attack.trajectory.clone());
            let planned = PlannedAttack::of(attack.ctx, path).extended(attack.extension.cloned());
            Ok(planned.row(attack.verdict, self.episode, attack.before)?)
        });
        let head = RowHead {
            run_hash: "",
            scene: self.name,
            ego: self.ego,
            generated: None,
            source_hash: "",
            seed: self.seed,
        };
        Ok(DriveRow::new(head, self.episode, self.scene, attack.transpose()?))
    }

    /// The row of `sage simulate`.
    ///
    /// *Errors*: those of the search for evasive manoeuvres.
    pub(crate) fn row(&self) -> Result<Value> {
        Ok(without_run(serde_json::to_value(self.drive_row()?)?))
    }

    /// How the drive ended, in words.
    ///
    /// *Errors*: as [`DriveResult::row`].
    pub(crate) fn ending(&self) -> Result<String> {
        Ok(self.drive_row()?.ending())
    }

    /// The page that plays it, with the drive before the attack beside it.
    ///
    /// *Errors*: as [`DriveResult::row`].
    pub(crate) fn page(&self) -> Result<String> {
        let row = self.drive_row()?;
        let plan = self.attack.map(|attack| Plan::of_adversary(self.scene, attack.trajectory)).transpose()?;
        let logged = self.scene.adversary.map(|k| &self.scene.tracks[k]);
        let adversary = plan.as_ref().map(|plan| &plan.motion).or(logged);
        let unattacked = self.attack.map(|attack| player::shown_part(attack.before));
        let panel = row.panel(self.ego.to_owned(), self.episode, adversary, unattacked);
        let page = Page {
            scene: self.scene,
            title: self.name,
            subtitle: "",
            panels: &[panel],
            paths: &[],
            columns: 1,
            back: None,
        };
        Ok(player::page(&page)?)
    }
}

/// Rows of a search of one scene: that of the scene, and one for each failure.
///
/// *Errors*: none but those of JSON.
pub(crate) fn search_rows(
    head: &SearchHead,
    options: &SearchOptions,
    before: &AttackTest,
    pool: &Pool,
    result: &SearchResult,
    plans: &PlanSources,
) -> Result<(Value, Vec<Value>)> {
    let failures = (0..result.failures.len()).map(|number| {
        let found = FailureOf { pool, result, number };
        let source = plans.source(pool.plans[found.evaluated().plan].source);
        let row = FailureRow::new(head, found, None, source);
        Ok(without_run(serde_json::to_value(row)?))
    });
    let failures = failures.collect::<Result<_>>()?;
    let mut row = SceneRow::new(head.clone(), options, pool, result, |number| plans.source(number));
    row.unattacked_contact = before.unattacked().contacts.first().map(|contact| step(contact.step));
    let unattacked = before.unattacked_drive();
    row.unattacked_completion = unattacked.completion;
    row.unattacked_off_road = unattacked.is_off_road();
    row.unattacked_off_plan = unattacked.off_plan;
    Ok((without_run(serde_json::to_value(row)?), failures))
}

/// Draws a scene with candidates of its adversary, each with its first contact with the ego.
///
/// *Errors*: candidates of a scene that cannot be attacked.
pub(crate) fn picture(data: &SceneData, candidates: Vec<(String, Trajectory)>) -> Result<String> {
    let mut drawn = Vec::with_capacity(candidates.len());
    if !candidates.is_empty() {
        let scene: &Arc<Scene> = &data.scene;
        let ctx = Context::new(scene, &data.index, &ContextOptions::default())?;
        drawn.extend(candidates.into_iter().map(|(name, trajectory)| drawn_path(name, &ctx, trajectory)));
    }
    let picture = Picture { title: data.name.clone(), candidates: drawn, ..Picture::default() };
    Ok(drawing::draw(&data.scene, &picture))
}

/// A recording as an OpenSCENARIO file: name and text of its OpenDRIVE map, and the text of the scenario.
///
/// *Errors*: a native file whose source is damaged.
pub(crate) fn scenario(recording: &Recording) -> Result<(String, String, String)> {
    let options = Options { license: scenario_files::license(recording)?, ..Options::default() };
    let export = Export::new(&recording.scene, options);
    let scenario = export.scenario(&recording.scene, &scenario_files::provenance(recording)?);
    let network = export.network();
    Ok((network.file_name(), network.xml.clone(), scenario))
}

pub(crate) fn without_run(mut row: Value) -> Value {
    if let Some(fields) = row.as_object_mut() {
        fields.retain(|name, _| !OF_RUN.contains(&&**name));
        // Rows of failures are files of the run too.
        for named in ["worst", "mildest", "likeliest"] {
            if let Some(failure) = fields.get_mut(named).and_then(Value::as_object_mut) {
                failure.remove("row");
            }
        }
    }
    row
}
