//! `sage report`: a page of what searches have found, from their rows alone.

mod drives;
mod entry;
mod road;

use std::collections::{BTreeMap, HashMap, HashSet};

use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_core::geometry::Aabb;
use sage_data::Recording;
use serde::Serialize;

use super::search::{
    SceneRow,
    found::{FailureFile, FailureScene, Found},
};
use crate::{
    Outcome,
    cli::{FailureReportArgs, Keep},
    html_page,
    output::Folder,
    progress,
};
use entry::Entry;
use road::RoadLine;

/// The page that lists all failures.
const FILE: &str = "index.html";
/// Folder of the pages of scenes.
const SCENES: &str = "scenes";
/// Most failures of a page, and of the page of a scene.
const MOST: usize = 20_000;
const MOST_OF_SCENE: usize = 100;
/// Longest name of a page, bytes.
const LONGEST_NAME: usize = 80;

const PAGE: &str = include_str!("report/page.html");
const STYLE: &str = include_str!("report/style.css");
const SCRIPT: &str = concat!(include_str!("report/thumbnails.js"), include_str!("report/report.js"));

#[derive(Serialize)]
struct Data<'a> {
    title: String,
    subtitle: String,
    scenes: Vec<SceneEntry<'a>>,
    failures: Vec<Entry>,
    without: Vec<Without<'a>>,
}

#[derive(Serialize)]
struct SceneEntry<'a> {
    name: &'a str,
    road: Vec<RoadLine>,
}

/// A scene in which a search found no failure.
#[derive(Serialize)]
struct Without<'a> {
    scene: &'a str,
    driver: &'a str,
    reason: &'a str,
}

/// The failures of one scene of one search.
struct OfScene<'a> {
    search: &'a Found<'a>,
    row: &'a SceneRow,
    /// Hash of the unchanged scene: other searches may have searched it too.
    hash: blake3::Hash,
    entries: Vec<Entry>,
    /// Where the thumbnails look.
    area: Aabb,
}

pub(crate) fn run(args: &FailureReportArgs) -> Result<Outcome> {
    let searches: Vec<Found> =
        args.searches.iter().map(|folder| Found::read(folder)).collect::<Result<_>>()?;
    let count: usize = searches.iter().flat_map(|search| &search.rows).map(|row| args.keep.count(row)).sum();
    ensure!(
        count <= MOST,
        "the searches hold {count} failures; a page shows at most {MOST}: give --keep worst"
    );
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    folder.inner(SCENES.as_ref())?;
    let rows = || searches.iter().flat_map(|search| search.rows.iter().map(move |row| (search, row)));
    let named = page_names(rows().filter(|(_, row)| row.failures() > 0));
    // The first error in the order of the searches, whichever thread meets one first.
    let found: Vec<Result<OfScene>> = named
        .par_iter()
        .map(|(search, row, name)| {
            let context = || format!("`{}`, scene `{}`", search.folder.display(), row.scene());
            of_scene(search, row, name, args.keep, &folder).with_context(context)
        })
        .collect();
    let found = found.into_iter().collect::<Result<Vec<_>>>()?;
    let data = Data {
        title: format!("Failures of {}", drivers(rows().map(|(_, row)| row.ego())).join(", ")),
        subtitle: format!(
            "{}, {}, {} with a failure",
            progress::count(searches.len(), "search"),
            progress::count(rows().count(), "searched scene"),
            found.len()
        ),
        without: rows()
            .filter(|(_, row)| row.failures() == 0)
            .map(|(_, row)| Without { scene: row.scene(), driver: row.ego(), reason: row.reason_words() })
            .collect(),
        ..collected(found)?
    };
    let page = html_page::assembled(PAGE, [STYLE, SCRIPT, &data.title, &html_page::embedded(&data)?])?;
    folder.write(FILE, page.as_bytes())?;
    progress::say(&format!(
        "{} of {}; open `{}`",
        progress::count(data.failures.len(), "failure"),
        progress::count(searches.len(), "search"),
        folder.path().join(FILE).display()
    ));
    Ok(Outcome::Done)
}

/// Drivers, each once, in their order.
fn drivers<'a>(all: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut known = HashSet::new();
    all.filter(|driver| known.insert(*driver)).collect()
}

/// The rows with the names of their pages, which are unique.
fn page_names<'a>(
    rows: impl Iterator<Item = (&'a Found<'a>, &'a SceneRow)>,
) -> Vec<(&'a Found<'a>, &'a SceneRow, String)> {
    let mut taken: HashMap<String, usize> = HashMap::new();
    let name = |(search, row): (&'a Found<'a>, &'a SceneRow)| {
        let plain = |c: char| if c.is_ascii_alphanumeric() || "._".contains(c) { c } else { '-' };
        let wished = format!("{}-{}", row.scene(), row.ego());
        let name: String = wished.chars().map(plain).take(LONGEST_NAME).collect();
        let name = name.trim_start_matches(['.', '-']).to_owned();
        let before = taken.entry(name.to_lowercase()).or_default();
        *before += 1;
        // `.` keeps a number apart from the names of other scenes.
        let name = if *before > 1 { format!("{name}..{before}") } else { name };
        (search, row, name)
    };
    rows.map(name).collect()
}

/// Describes the failures of a scene, and writes its pages.
fn of_scene<'a>(
    search: &'a Found<'a>,
    row: &'a SceneRow,
    name: &str,
    keep: Keep,
    folder: &Folder,
) -> Result<OfScene<'a>> {
    let source = search.unchanged(row)?;
    let bytes = sage_data::read_bytes(&source)?;
    let hash = blake3::hash(&bytes);
    let recording = Recording::from_bytes(&source, bytes)?;
    let scene = FailureScene::new(&recording, row.adversary())?;
    let (mut entries, mut area) = (Vec::new(), None::<Aabb>);
    for (k, numbers) in keep.numbers(row).chunks(MOST_OF_SCENE).enumerate() {
        let page = if k == 0 { format!("{name}.html") } else { format!("{name}.{}.html", k + 1) };
        let read = |number: &usize| Ok((*number, search.failure(row, *number)?));
        let failures: Vec<(usize, FailureFile)> = numbers.iter().map(read).collect::<Result<_>>()?;
        let mut described = Vec::with_capacity(failures.len());
        for (number, failure) in &failures {
            let link = format!("{SCENES}/{}", html_page::link(&page));
            let (entry, of_entry) = Entry::new(&scene, *number, failure, &link)?;
            area = Some(area.map_or(of_entry, |area| area.union(&of_entry)));
            described.push(entry);
        }
        let html = drives::page(&scene, row, &failures, &described)?;
        folder.write(&format!("{SCENES}/{page}"), html.as_bytes())?;
        entries.extend(described);
    }
    let area = area.context("it has no failure")?;
    Ok(OfScene { search, row, hash, entries, area })
}

/// Scenes and failures of all searches; a scene that several have searched is one.
fn collected(found: Vec<OfScene<'_>>) -> Result<Data<'_>> {
    let mut places: HashMap<blake3::Hash, usize> = HashMap::new();
    let mut scenes: BTreeMap<usize, (&Found, &SceneRow, Aabb)> = BTreeMap::new();
    let mut failures = Vec::new();
    for OfScene { search, row, hash, entries, area } in found {
        let next = places.len();
        let place = *places.entry(hash).or_insert(next);
        let scene = scenes.entry(place).or_insert((search, row, area));
        scene.2 = scene.2.union(&area);
        failures.extend(entries.into_iter().map(|entry| entry.of_scene(place)));
    }
    let scenes: Vec<(&Found, &SceneRow, Aabb)> = scenes.into_values().collect();
    let entry = |(search, row, area): &(&Found, &'_ SceneRow, Aabb)| -> Result<Vec<RoadLine>> {
        Ok(road::lines(&Recording::read(&search.unchanged(row)?)?.scene.map, area))
    };
    let roads: Vec<Vec<RoadLine>> = scenes.par_iter().map(entry).collect::<Result<_>>()?;
    let scenes =
        scenes.into_iter().zip(roads).map(|((_, row, _), road)| SceneEntry { name: row.scene(), road });
    let scenes = scenes.collect();
    Ok(Data { title: String::new(), subtitle: String::new(), scenes, failures, without: Vec::new() })
}
