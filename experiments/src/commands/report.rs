//! `sage report`: a page of what searches have found, from their rows alone.

mod drives;
mod entry;

use std::collections::{BTreeMap, HashMap, HashSet};

use advsage::rows::{failure::FailureRow, search::SceneRow};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_core::{files, geometry::Aabb, statistics};
use sage_data::Recording;
use sage_run::{
    Outcome,
    outcome::{caught, without_defects},
    output::Folder,
    progress,
};
use sage_view::{
    html_page,
    listing::{
        self, ListedScene,
        road::{self, RoadLine},
    },
};
use serde::Serialize;

use super::search::{
    found::{FailureScene, Found, without_folders},
    summary::HARDLY,
};
use crate::cli::{FailureReportArgs, Keep};
use entry::Entry;

/// The page that lists all failures.
const FILE: &str = "index.html";
/// Folder of the pages of scenes.
const SCENES: &str = "scenes";
/// Most failures of a page, and of the page of a scene.
const MOST: usize = 20_000;
const MOST_OF_SCENE: usize = 100;
/// Size limit of an earlier report, bytes.
const LIMIT: u64 = 1 << 28;
/// Longest name of a page, bytes.
const LONGEST_NAME: usize = 80;

/// What the items of the page hold.
const FIELDS: &str = include_str!("report/fields.js");

#[derive(Serialize)]
struct Data<'a> {
    title: String,
    subtitle: String,
    scenes: Vec<ListedScene<'a>>,
    items: Vec<Entry>,
    without: Vec<Without<'a>>,
}

/// A scene in which a search found no failure.
#[derive(Serialize)]
struct Without<'a> {
    scene: &'a str,
    driver: String,
    reason: &'a str,
    /// Its drives, and a contact without any attack.
    note: Option<String>,
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
    if args.compare {
        return super::test::page::compare(&args.searches, &args.folder.out, args.folder.force);
    }
    let searches: Vec<Found> =
        args.searches.iter().map(|folder| Found::read(folder)).collect::<Result<_>>()?;
    let count: usize = searches.iter().flat_map(|search| &search.rows).map(|row| args.keep.count(row)).sum();
    ensure!(
        count <= MOST,
        "the searches hold {count} failures; a page shows at most {MOST}: give --keep mildest"
    );
    let rows = || searches.iter().flat_map(|search| search.rows.iter().map(move |row| (search, row)));
    for (search, row) in rows().filter(|(_, row)| row.failures() > 0) {
        let context = || format!("`{}`, scene `{}`", search.folder.display(), row.scene());
        search.unchanged(row).with_context(context)?;
    }
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    let earlier = files::read_text(&folder.path().join(FILE), LIMIT).map(|page| pages_of(&page));
    folder.inner(SCENES.as_ref())?;
    let named = page_names(rows().filter(|(_, row)| row.failures() > 0));
    let found: Vec<Result<OfScene>> = named
        .par_iter()
        .map(|(search, row, name)| {
            let context = || format!("`{}`, scene `{}`", search.folder.display(), row.scene());
            caught(|| of_scene(search, row, name, args.keep, &folder)).with_context(context)
        })
        .collect();
    let found = without_defects(found)?;
    let data = Data {
        title: format!("Failures of {}", drivers(rows().map(|(_, row)| row.ego())).join(", ")),
        subtitle: subtitle(&searches, found.len()),
        without: rows()
            .filter(|(_, row)| row.failures() == 0)
            .map(|(_, row)| Without {
                scene: row.scene(),
                driver: without_folders(row.ego()),
                reason: row.reason_words(),
                note: Some([Some(progress::count(row.drives, "drive")), row.contact_without_attack()])
                    .map(|notes| notes.into_iter().flatten().collect::<Vec<_>>().join("; ")),
            })
            .collect(),
        ..collected(found)?
    };
    let page = listing::page(&data.title, FIELDS, &data)?;
    // The list of an earlier report stays until this one is complete: it says which pages are in the way.
    let own = pages_of(&page);
    for page in earlier.unwrap_or_default().difference(&own) {
        folder.remove(&format!("{SCENES}/{page}"))?;
    }
    folder.write(FILE, page.as_bytes())?;
    folder.finish()?;
    progress::say(&format!(
        "{} of {}; open `{}`",
        progress::count(data.items.len(), "failure"),
        progress::count(searches.len(), "search"),
        folder.path().join(FILE).display()
    ));
    Ok(Outcome::Done)
}

/// What was searched, and what a reader must know of it.
fn subtitle(searches: &[Found], with_failure: usize) -> String {
    let rows = || searches.iter().flat_map(|search| &search.rows);
    let mut parts = vec![
        progress::count(searches.len(), "search"),
        progress::count(rows().count(), "searched scene"),
        format!("{with_failure} with a failure"),
        progress::count(rows().map(|row| row.drives).sum(), "drive"),
    ];
    if let Some(most) = rows().map(|row| row.budget).max() {
        parts.push(format!("at most {most} a scene"));
    }
    let counts = [
        (rows().map(|row| row.errors).sum(), "drive", "with an error of the driver"),
        (searches.iter().map(|search| search.failed).sum(), "scene", "failed and not shown"),
        (
            rows().filter(|row| row.unattacked_contact.is_some()).count(),
            "scene",
            "with a contact without any attack",
        ),
        (
            rows().filter(|row| row.unattacked_off_road == Some(true)).count(),
            "scene",
            "in which the driver leaves the road without any attack",
        ),
    ];
    let counts = counts.into_iter().filter(|(count, ..)| *count > 0);
    parts.extend(counts.map(|(count, what, said)| format!("{} {said}", progress::count(count, what))));
    let completions: Vec<f64> = rows().filter_map(|row| row.unattacked_completion).collect();
    if let Some(mean) = statistics::mean(&completions) {
        let hardly = if mean < HARDLY { ": it hardly drives, so a search finds little" } else { "" };
        parts.push(format!("without an attack {:.0} % of the routes{hardly}", 100.0 * mean));
    }
    parts.join(", ")
}

/// Names of the pages that a list names; only names as they are made here.
fn pages_of(page: &str) -> HashSet<String> {
    let data = html_page::data_of(page).unwrap_or_default();
    let failures = data["items"].as_array().map_or(&[][..], |all| all);
    let links = failures.iter().filter_map(|failure| failure["page"].as_str()?.split('#').next());
    let is_own = |name: &str| {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        name.ends_with(".html") && !name.starts_with('.') && name.chars().all(is_plain)
    };
    let names = links.filter_map(|link| link.strip_prefix(SCENES)?.strip_prefix('/'));
    names.filter(|name| is_own(name)).map(str::to_owned).collect()
}

/// Drivers, each once, in their order.
fn drivers<'a>(all: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut known = HashSet::new();
    all.map(without_folders).filter(|driver| known.insert(driver.clone())).collect()
}

/// The rows with the names of their pages, which are unique.
fn page_names<'a>(
    rows: impl Iterator<Item = (&'a Found<'a>, &'a SceneRow)>,
) -> Vec<(&'a Found<'a>, &'a SceneRow, String)> {
    let mut taken: HashMap<String, usize> = HashMap::new();
    let name = |(search, row): (&'a Found<'a>, &'a SceneRow)| {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
        let wished = format!("{}-{}", row.scene(), without_folders(row.ego()));
        let name: String = wished.chars().map(plain).take(LONGEST_NAME).collect();
        let name = name.trim_start_matches('-').to_owned();
        let before = taken.entry(name.to_lowercase()).or_default();
        *before += 1;
        // Names hold no `.`, which keeps numbers of equal names, and of further pages, apart.
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
    let mut numbers = keep.numbers(row);
    // The mildest and the worst one are side by side with the drive without an attack.
    numbers.sort_by_key(|number| (Some(*number) != row.mildest(), Some(*number) != row.worst()));
    for (k, numbers) in numbers.chunks(MOST_OF_SCENE).enumerate() {
        let page = if k == 0 { format!("{name}.html") } else { format!("{name}.{}.html", k + 1) };
        let read = |number: &usize| Ok((*number, search.failure(row, *number)?));
        let failures: Vec<(usize, FailureRow)> = numbers.iter().map(read).collect::<Result<_>>()?;
        let mut described = Vec::with_capacity(failures.len());
        for (number, failure) in &failures {
            let link = format!("{SCENES}/{}", html_page::link(&page));
            let (entry, of_entry) = Entry::new(&scene, row, *number, failure, &link)?;
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
        scenes.into_iter().zip(roads).map(|((_, row, _), road)| ListedScene { name: row.scene(), road });
    let scenes = scenes.collect();
    Ok(Data { title: String::new(), subtitle: String::new(), scenes, items: failures, without: Vec::new() })
}
