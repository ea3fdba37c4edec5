//! The page of tests: what one driver did in them, or two drivers beside each other.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use sage_core::{
    files,
    geometry::{Aabb, Point},
    motion::{HORIZON, NOW},
    scene::{Scene, Track},
    text::natural_order,
};
use sage_data::{MAX_SCENE_FILE, Recording};
use sage_run::{
    Outcome,
    output::{Folder, Inputs},
    progress,
};
use sage_sim::vehicle::Motion;
use sage_view::{
    html_page,
    listing::{
        self, ListedScene,
        car::{Car, path, shown_area},
        road,
    },
    player::{self, Meeting, Page, Panel},
};
use serde::Serialize;

use super::{
    record::{DRIVES, LIMIT_OF_RESULTS, RESULTS, RecordedDrive, SCENES, TestRecord},
    row::{ResultHead, TestResult},
};
use crate::commands::search::found::motions;

/// The page that lists all tests, and the folder of the pages of scenes.
pub(super) const FILE: &str = "index.html";
const PAGES: &str = "pages";
const FIELDS: &str = include_str!("fields.js");

/// Results of one driver in a suite.
pub(super) struct Side {
    folder: PathBuf,
    pub(super) records: Vec<TestRecord>,
}

#[derive(Serialize)]
struct Data<'a> {
    title: String,
    subtitle: String,
    scenes: Vec<ListedScene<'a>>,
    items: Vec<Item>,
}

/// A test on the page.
#[derive(Serialize)]
struct Item {
    scene: usize,
    page: String,
    name: String,
    /// The result, or how the two differ.
    result: &'static str,
    is_failure: bool,
    cluster: String,
    sentence: Option<String>,
    /// What each driver did.
    did: Vec<[String; 2]>,
    ego: Car,
    adversary: Car,
}

impl Side {
    /// Reads a folder of `sage test --out`.
    ///
    /// *Errors*: it is none, or not as it was written.
    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(RESULTS);
        let text = files::read_text(&path, LIMIT_OF_RESULTS)
            .with_context(|| format!("`{}` is no output of `sage test --out`", folder.display()))?;
        let record = |line: &str| -> Result<TestRecord> {
            let head: ResultHead =
                serde_json::from_str(line).with_context(|| format!("`{}`", path.display()))?;
            let record = TestRecord::read(folder, &head.test)?;
            ensure!(
                record.head.plan_hash == head.plan_hash,
                "`{}`: the drive of `{}` is of another plan",
                path.display(),
                head.test
            );
            Ok(record)
        };
        let records = text.lines().filter(|line| !line.trim().is_empty()).map(record);
        Ok(Self { folder: folder.to_owned(), records: records.collect::<Result<_>>()? })
    }

    /// Results that were just made.
    pub(super) fn of(folder: &Path, records: Vec<TestRecord>) -> Self {
        Self { folder: folder.to_owned(), records }
    }

    fn driver(&self) -> &str {
        self.records.first().map_or("", |record| &record.head.ego)
    }
}

/// Compares the results of two drivers, or of two versions of one, on one suite.
///
/// *Errors*: a folder is no output of `sage test --out`; they share no test.
pub(in crate::commands) fn compare(folders: &[PathBuf], out: &Path, force: bool) -> Result<Outcome> {
    let [a, b] = folders else {
        anyhow::bail!("--compare needs two outputs of `sage test --out`, and {} are given", folders.len());
    };
    let (first, mut second) = (Side::read(a)?, Side::read(b)?);
    let number = |record: &TestRecord| {
        let is_same = |other: &TestRecord| {
            (&other.head.test, &other.head.plan_hash) == (&record.head.test, &record.head.plan_hash)
        };
        first.records.iter().position(is_same)
    };
    let mut paired: Vec<(usize, TestRecord)> =
        second.records.into_iter().filter_map(|record| Some((number(&record)?, record))).collect();
    paired.sort_by_key(|(number, _)| *number);
    ensure!(!paired.is_empty(), "`{}` and `{}` share no test", a.display(), b.display());
    let in_both: Vec<usize> = paired.iter().map(|(number, _)| *number).collect();
    second.records = paired.into_iter().map(|(_, record)| record).collect();
    let mut first = first;
    let mut number = 0..;
    first.records.retain(|_| number.next().is_some_and(|number| in_both.contains(&number)));
    let folder = Folder::make_beside(&Inputs::of(folders), out, force)?;
    let counts = write(&folder, &[first, second])?;
    folder.finish()?;
    let words: Vec<String> = counts.iter().map(|(what, count)| format!("{count} {what}")).collect();
    progress::say(&format!("{}; open `{}`", words.join(", "), folder.path().join(FILE).display()));
    Ok(Outcome::Done)
}

/// How the results of a test differ.
fn change(results: &[TestResult]) -> &'static str {
    let passed = |k: usize| results.get(k).map(|result| *result == TestResult::Passed);
    match (passed(0), passed(1)) {
        (Some(true), None) => "passed",
        (Some(false), None) if results[0] == TestResult::Error => "error",
        (_, None) => "failed",
        (Some(false), Some(true)) => "fixed",
        (Some(true), Some(false)) => "new failure",
        (Some(true), Some(true)) => "passes in both",
        _ => "still failing",
    }
}

/// Writes the pages of one side, or of two with the same tests in the same order. Returns how many tests have which result.
///
/// *Errors*: a scene is missing.
pub(super) fn write(folder: &Folder, sides: &[Side]) -> Result<BTreeMap<&'static str, usize>> {
    folder.inner(PAGES.as_ref())?;
    let tests = sides[0].records.len();
    let mut by_scene: BTreeMap<(&str, &str), Vec<usize>> = BTreeMap::new();
    for (number, record) in sides[0].records.iter().enumerate() {
        by_scene.entry((&record.scene, &record.adversary)).or_default().push(number);
    }
    let mut by_scene: Vec<_> = by_scene.into_iter().collect();
    by_scene.sort_by(|a, b| natural_order(a.0.0, b.0.0));
    let (mut counts, mut items, mut scenes) = (BTreeMap::new(), Vec::with_capacity(tests), Vec::new());
    for (place, ((file, adversary), numbers)) in by_scene.iter().enumerate() {
        let name = file.strip_suffix(".scene").unwrap_or(file);
        let source = sides[0].folder.join(SCENES).join(file);
        let bytes = files::read(&source, MAX_SCENE_FILE)
            .with_context(|| format!("cannot read `{}`", source.display()))?;
        let scene = Recording::from_bytes(&source, bytes)?.scene.with_roles(None, Some(adversary))?;
        let page = format!("{}.html", place + 1);
        let mut area: Option<Aabb> = None;
        for number in numbers {
            let records: Vec<&TestRecord> = sides.iter().map(|side| &side.records[*number]).collect();
            let results: Vec<TestResult> = records.iter().map(|record| record.head.result).collect();
            let result = change(&results);
            *counts.entry(result).or_default() += 1;
            let (cars, of_item) = cars(&scene, records.last().context("no side")?)?;
            area = Some(area.map_or(of_item, |area| area.union(&of_item)));
            let [ego, adversary] = cars;
            items.push(Item {
                scene: place,
                page: format!("{PAGES}/{page}#{}", html_page::link(&records[0].head.test)),
                name: records[0].head.test.clone(),
                result,
                is_failure: !matches!(result, "passed" | "fixed" | "passes in both"),
                cluster: records[0].cluster.clone(),
                sentence: records[0].sentence.clone(),
                did: records.iter().map(|r| [r.head.ego.clone(), r.words.clone()]).collect(),
                ego,
                adversary,
            });
        }
        folder.write(&format!("{PAGES}/{page}"), scene_page(&scene, name, sides, numbers)?.as_bytes())?;
        let road = road::lines(&scene.map, &area.context("a scene without tests")?);
        scenes.push(ListedScene { name, road });
    }
    let drivers: Vec<&str> = sides.iter().map(Side::driver).collect();
    let title = match &drivers[..] {
        [one] => format!("Tests of {one}"),
        all => format!("Tests of {}", all.join(" and ")),
    };
    let words: Vec<String> = counts.iter().map(|(what, count)| format!("{count} {what}")).collect();
    let subtitle = format!("{}: {}", progress::count(tests, "test"), words.join(", "));
    let data = Data { title, subtitle, scenes, items };
    folder.write(FILE, listing::page(&data.title, FIELDS, &data)?.as_bytes())?;
    Ok(counts)
}

/// Both cars at the contact, or at the end of the drive; and the area that the thumbnail shows.
fn cars(scene: &Scene, record: &TestRecord) -> Result<([Car; 2], Aabb)> {
    let adversary = scene.adversary()?.following(&record.plan);
    let poses = record.drive.as_ref().map(|drive| &drive.poses[..]).unwrap_or_default();
    let step = poses.len().saturating_sub(NOW + 1).clamp(1, HORIZON);
    let positions: Vec<Point> = match poses.get(NOW + 1..) {
        Some(poses) if !poses.is_empty() => poses.iter().map(|[x, y, _]| [*x, *y]).collect(),
        _ => vec![scene.ego().point(NOW)],
    };
    let paths = [path(scene.ego(), &positions, step), path(&adversary, record.plan.points(), step)];
    let area = shown_area(&paths);
    let frame = (NOW + step).min(scene.frames - 1);
    let mut own = scene.ego().oriented_box(NOW);
    if let Some([x, y, heading]) = poses.last() {
        own = sage_core::geometry::OrientedBox::new(
            [*x, *y],
            *heading,
            2.0 * own.half_length,
            2.0 * own.half_width,
        );
    }
    let other = adversary.oriented_box(if adversary.is_valid(frame) { frame } else { NOW });
    Ok(([Car::new(&own, &paths[0]), Car::new(&other, &paths[1])], area))
}

/// What a panel of a test shows.
struct Parts<'p> {
    record: &'p TestRecord,
    drive: &'p RecordedDrive,
    motions: Vec<Motion>,
    unattacked: Vec<Motion>,
    adversary: Track,
}

fn scene_page(scene: &Scene, title: &str, sides: &[Side], numbers: &[usize]) -> Result<String> {
    let mut parts = Vec::new();
    for number in numbers {
        for side in sides {
            let record = &side.records[*number];
            // A drive that ended in an error has no panel; the list says what it was.
            let Some(drive) = &record.drive else { continue };
            parts.push(Parts {
                record,
                drive,
                motions: motions(&drive.poses),
                unattacked: motions(&drive.unattacked),
                adversary: scene.adversary()?.following(&record.plan),
            });
        }
    }
    let panel = |part: &'_ Parts| -> (String, String, Option<Meeting>) {
        let record = part.record;
        let name = if sides.len() > 1 {
            format!("{}: {}", record.head.ego, record.head.test)
        } else {
            record.head.test.clone()
        };
        let sentence = record.sentence.as_ref().map_or(String::new(), |words| format!(" {words}"));
        (name, format!("{}.{sentence}", record.words), part.drive.contact.as_ref().map(|c| c.meeting()))
    };
    let described: Vec<_> = parts.iter().map(panel).collect();
    let panels: Vec<Panel> = parts
        .iter()
        .zip(described)
        .map(|(part, (name, note, contact))| {
            let is_failed = part.record.head.result != TestResult::Passed;
            Panel {
                name,
                id: part.record.head.test.clone(),
                sweep: None,
                motions: &part.motions,
                end: part.motions.len().saturating_sub(1),
                shown: &part.drive.shown,
                contact,
                adversary: Some(&part.adversary),
                unattacked: Some(&part.unattacked[..]).filter(|motions| !motions.is_empty()),
                evasion: None,
                verdict: Some(is_failed),
                is_failed: false,
                others: Vec::new(),
                marks: Vec::new(),
                badge: Some(if is_failed { "failed" } else { "passed" }),
                ending: note.clone(),
                note,
            }
        })
        .collect();
    let back = format!("../{FILE}");
    let page = Page {
        scene,
        title,
        subtitle: "tests of a suite",
        panels: &panels,
        paths: &[],
        columns: if sides.len() > 1 { 2 } else { 3 },
        back: Some(&back),
    };
    Ok(player::page(&page)?)
}

/// Removes what an earlier run has written into a folder of results.
///
/// *Errors*: a system error.
pub(super) fn remove_old(folder: &Folder) -> Result<()> {
    if !folder.path().join(RESULTS).is_file() {
        return Ok(());
    }
    folder.remove(RESULTS)?;
    for (inner, ending) in [(DRIVES, ".json"), (PAGES, ".html"), (SCENES, ".scene")] {
        let Ok(entries) = std::fs::read_dir(folder.path().join(inner)) else { continue };
        for entry in entries {
            let name = entry?.file_name().to_string_lossy().into_owned();
            if name.ends_with(ending) {
                folder.remove(&format!("{inner}/{name}"))?;
            }
        }
    }
    Ok(())
}
