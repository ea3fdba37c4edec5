//! The page that lists the attacked scenes of a run.

use advsage::rows::attack::{AttackRow, is_prevented};
use rayon::prelude::*;
use sage_core::{
    geometry::{Aabb, OrientedBox, Point},
    motion::{HORIZON, NOW},
    objective::Reason,
    scene::{Scene, Track},
};
use sage_data::{ReadOptions, Recording};
use sage_view::{
    html_page::link,
    listing::{
        self, ListedScene,
        car::{Car, path, shown_area},
        road::{self, RoadLine},
    },
};
use serde::Serialize;

use super::{
    job::Job,
    names::{INDEX, page_file, row_file},
};
use crate::{
    Result,
    output::Folder,
    scene_queue::{Input, is_row_of},
};

/// Most scenes and attacks of a page: tens of megabytes.
const MOST_SCENES: usize = 2000;
const MOST_ATTACKS: usize = 20_000;

/// What the items of the page hold.
const FIELDS: &str = include_str!("fields.js");

#[derive(Serialize)]
struct Data<'a> {
    title: String,
    subtitle: String,
    variants: Vec<String>,
    scenes: Vec<ListedScene<'a>>,
    items: Vec<Entry>,
}

/// An attack on the page.
#[derive(Serialize)]
struct Entry {
    /// Number of its scene.
    scene: usize,
    /// Number of its operating point.
    variant: usize,
    page: String,
    /// What came of it.
    outcome: String,
    is_attack: bool,
    is_believable: bool,
    adversary_id: String,
    /// More than `outcome` says: why it is so.
    why: String,
    contact_after: Option<f64>,
    impact: Option<f64>,
    reward: f64,
    realism: f64,
    latest_start: Option<f64>,
    avoidable: Option<bool>,
    prevented_by_r157: Option<bool>,
    ego: Car,
    adversary: Car,
}

/// A scene with its attacks.
struct Listed<'a> {
    name: &'a str,
    road: Vec<RoadLine>,
    entries: Vec<Entry>,
}

/// Writes the page of a run from its rows and its inputs. Scenes without rows are left out.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write(job: &Job, folder: &Folder, run_hash: &str, inputs: &[Input]) -> Result<()> {
    let options = &job.options.reading;
    let most = MOST_SCENES.min(MOST_ATTACKS / job.variants().len()).max(1);
    let listed_inputs = &inputs[..inputs.len().min(most)];
    let all: Vec<Option<Listed>> =
        listed_inputs.par_iter().map(|input| listed(job, folder, run_hash, input, options)).collect();
    let (mut scenes, mut items) = (Vec::new(), Vec::new());
    for Listed { name, road, entries } in all.into_iter().flatten() {
        items.extend(entries.into_iter().map(|entry| Entry { scene: scenes.len(), ..entry }));
        scenes.push(ListedScene { name, road });
    }
    let points = &job.generator.points;
    let label = |k: usize| points[k].long_label().replace("lambda ", "λ ");
    let data = Data {
        title: format!("Attacks by {}", job.generator.method),
        subtitle: match inputs.len() > most {
            true => format!("the first {most} of {} scenes, {}", inputs.len(), job.subtitle()),
            false => job.subtitle(),
        },
        variants: if points.len() > 1 { (0..points.len()).map(label).collect() } else { Vec::new() },
        scenes,
        items,
    };
    folder.write(INDEX, listing::page(&data.title, FIELDS, &data)?.as_bytes())
}

/// A scene with its attacks; `None` if it has no rows, or cannot be read any more.
fn listed<'a>(
    job: &Job,
    folder: &Folder,
    run_hash: &str,
    input: &'a Input,
    options: &ReadOptions,
) -> Option<Listed<'a>> {
    let rows: Vec<(usize, AttackRow)> = job
        .variants()
        .iter()
        .enumerate()
        .filter_map(|(variant, name)| {
            let path = folder.path().join(row_file(&input.scene, name));
            let row = if is_row_of(&path, run_hash) { AttackRow::read_head(&path) } else { None };
            Some((variant, row?))
        })
        .collect();
    let scene = Recording::read_as(&input.file, options).ok().filter(|_| !rows.is_empty())?.scene;
    let mut area = Aabb::EMPTY;
    let entries = rows.iter().filter_map(|(variant, row)| {
        let (entry, of_entry) = Entry::new(&scene, &input.scene, job, *variant, row)?;
        area = area.union(&of_entry);
        Some(entry)
    });
    let entries = entries.collect();
    Some(Listed { name: &input.scene, road: road::lines(&scene.map, &area), entries })
}

impl Entry {
    /// Describes an attack; `None` if its adversary is not in the scene. Also gives the area that its thumbnail shows.
    fn new(scene: &Scene, name: &str, job: &Job, variant: usize, row: &AttackRow) -> Option<(Self, Aabb)> {
        let recorded = scene.tracks.iter().find(|track| track.id == row.adversary)?;
        let (ego, adversary) = (scene.ego(), recorded.following(&row.trajectory));
        let step = row.scores.scores.collision_step.unwrap_or_else(|| nearest_step(ego, &adversary, scene));
        let frame = (NOW + step).min(scene.frames - 1);
        let boxes = [ego, &adversary].map(|track| box_at(track, frame));
        let points: Vec<Point> =
            (NOW + 1..=frame).filter(|f| ego.is_valid(*f)).map(|f| ego.point(f)).collect();
        let paths = [path(ego, &points, step), path(&adversary, row.trajectory.points(), step)];
        let [ego_box, adversary_box] = boxes;
        let (scores, avoidable) = (&row.scores.scores, &row.scores.avoidable);
        let entry = Self {
            scene: 0,
            variant,
            page: format!("{}#{}", link(&page_file(name)), job.variants()[variant]),
            outcome: row.outcome.words(),
            is_attack: row.outcome.is_attack(),
            is_believable: row.outcome.is_attack() && scores.unbelievable.is_empty(),
            adversary_id: row.adversary.clone(),
            why: why(row),
            contact_after: scores.collision_step.map(|step| step as f64 / 10.0),
            impact: scores.criticality.impact_speed,
            reward: scores.adversarial_reward,
            realism: scores.kinematic_penalty + scores.behavior_penalty,
            latest_start: avoidable.latest_start,
            avoidable: avoidable.avoidable,
            prevented_by_r157: is_prevented(&row.scores.references),
            ego: Car::new(&ego_box, &paths[0]),
            adversary: Car::new(&adversary_box, &paths[1]),
        };
        Some((entry, shown_area(&paths)))
    }
}

/// Why an outcome is as it is, in words; empty for a believable attack.
fn why(row: &AttackRow) -> String {
    if row.outcome.is_attack() {
        return row.scores.scores.unbelievable.iter().map(Reason::words).collect::<Vec<_>>().join(", ");
    }
    row.counts.cause(row.outcome).replace('`', "")
}

/// Step at which two tracks are nearest.
fn nearest_step(ego: &Track, adversary: &Track, scene: &Scene) -> usize {
    let steps = (1..=scene.horizon().min(HORIZON)).filter(|step| ego.is_valid(NOW + step));
    let gap =
        |step: &usize| sage_core::geometry::distance(ego.point(NOW + step), adversary.point(NOW + step));
    steps.min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(1)
}

/// Box of a track at a frame, or at the last before it that is valid.
fn box_at(track: &Track, frame: usize) -> OrientedBox {
    let known = (0..=frame).rev().find(|frame| track.is_valid(*frame)).unwrap_or(frame);
    track.oriented_box(known)
}
