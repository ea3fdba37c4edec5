//! Makes MetaDrive values of a scenario and its map.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use sage_core::{
    motion::{DT, MAX_COORDINATE},
    scene::Note,
};

use super::{
    DATASET, edges,
    lanes::{Lane, features, flat},
    map_file::{LaneSegment, MapFile},
    rows::{self, Problem, Rows},
};
use crate::{
    Error, ReadOptions,
    json::explained,
    metadrive::{ASSUMED_SIZES, MAX_FRAMES, SceneValues, Values},
    parquet_files,
    pickle::{Document, Id},
    repairs::sizes::size_of_type,
};

/// Most corners of the drivable areas. Real maps have up to 5 000.
const MOST_CORNERS: usize = 20_000;
/// Most points of a side of a lane. Real ones have up to 100.
const MOST_POINTS: usize = 1000;
/// Most places at which outlines of drivable areas cross.
const MOST_CROSSINGS: usize = 20_000;
/// Most frames that the road users take together: a road user of one row has a place in each frame.
const MOST_FRAMES: usize = 150_000;
/// Type of vehicles in MetaDrive values.
const VEHICLE: &str = "VEHICLE";
/// Name of the ego.
const EGO: &str = "AV";

/// What a scenario becomes.
pub(crate) struct Made {
    pub(crate) document: Document,
    pub(crate) notes: Vec<Note>,
    /// Category of each road user, by id.
    pub(crate) categories: HashMap<String, i64>,
}

/// The values of a scenario, whose map lies beside it.
///
/// *Errors*: [`Error::Field`], [`Error::Json`], or [`Error::Read`] for the map.
pub(crate) fn document(path: &Path, bytes: Vec<u8>, options: &ReadOptions) -> Result<Made, Error> {
    let (bytes, map) = parquet_files::without_map(bytes);
    let size = bytes.len();
    let rows = rows::read(bytes).map_err(|Problem { column, found, expected }| Error::Field {
        path: path.to_owned(),
        field: column,
        found,
        expected,
    })?;
    let (map_path, text) = match map {
        Some(text) => (parquet_files::map_beside(path).unwrap_or_else(|| path.to_owned()), text),
        None => map_of(path, &rows)?,
    };
    let map: MapFile =
        serde_json::from_slice(&text).map_err(|error| explained::<MapFile>(&map_path, &text, error))?;
    let wrong = |field: &str, found: String, expected: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        expected: expected.to_owned(),
    };
    let ego = options.ego_track.as_deref().unwrap_or(EGO);
    if !rows.users.iter().any(|user| user.id == ego && kind_of(&user.kind) == VEHICLE) {
        let expected = "the vehicle `AV`, the ego; name another with --ego-track";
        return Err(wrong("track_id", format!("without a vehicle `{}`", ego.escape_debug()), expected));
    }
    let frames = frames(&rows, path)?;
    if rows.users.len().saturating_mul(frames) > MOST_FRAMES {
        let found = format!("{} road users in {frames} steps", rows.users.len());
        return Err(wrong("track_id", found, "at most 150000 places of road users in steps"));
    }
    let mut values = Values::with_capacity(size + text.len());
    let mut notes = Vec::new();
    let (tracks, sizes) = tracks(&rows, frames, path, &mut values)?;
    let tracks = values.entries(tracks);
    let features = map_features(&map, &map_path, &mut values, &mut notes)?;
    let features = values.entries(features);
    let raw = String::from_utf8(text).unwrap_or_default();
    let (raw, lights) = (values.text(&raw), values.entries(Vec::new()));
    let metadata = metadata(&rows, ego, frames, &sizes, &mut values);
    let own = match rows.scenario_id.is_empty() {
        true => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        false => rows.scenario_id.clone(),
    };
    values.set_scene(&own, DATASET, frames, SceneValues { tracks, lights, features, metadata });
    let mut document = values.document;
    // With the heights, which are not those of the road users.
    document.set(document.root(), "argoverse2_map", raw);
    document.set_file_size(document.values_size());
    let categories = rows.users.into_iter().map(|user| (user.id, user.category)).collect();
    Ok(Made { document, notes, categories })
}

/// The map beside a scenario.
fn map_of(path: &Path, rows: &Rows) -> Result<(PathBuf, Vec<u8>), Error> {
    let by_id = || {
        // An id is never a path into another folder.
        let id = Some(&rows.scenario_id).filter(|id| !id.contains(['/', '\\']))?;
        Some(path.with_file_name(format!("log_map_archive_{id}.json"))).filter(|map| map.is_file())
    };
    let map = parquet_files::map_beside(path).or_else(by_id).ok_or_else(|| Error::Field {
        path: path.to_owned(),
        field: "(map)".to_owned(),
        found: "no `log_map_archive_….json` of this scenario beside it".to_owned(),
        expected: "the folder of the scenario as it is published, with its map".to_owned(),
    })?;
    let text = parquet_files::read_map(&map)?;
    Ok((map, text))
}

/// Number of steps.
fn frames(rows: &Rows, path: &Path) -> Result<usize, Error> {
    let last = rows.step.iter().copied().max().unwrap_or(-1);
    let first = rows.step.iter().copied().min().unwrap_or(-1);
    let wrong = |step: i64| Error::Field {
        path: path.to_owned(),
        field: "timestep".to_owned(),
        found: step.to_string(),
        expected: format!("a step from 0 to {}", MAX_FRAMES - 1),
    };
    if first < 0 {
        return Err(wrong(first));
    }
    usize::try_from(last)
        .ok()
        .filter(|last| *last < MAX_FRAMES)
        .map(|last| last + 1)
        .ok_or_else(|| wrong(last))
}

/// Type in MetaDrive values. Motorcyclists and buses drive as cars do; what is no road user is an obstacle.
fn kind_of(name: &str) -> String {
    match name {
        "vehicle" | "bus" | "motorcyclist" => VEHICLE.to_owned(),
        other => other.to_ascii_uppercase(),
    }
}

fn tracks(
    rows: &Rows,
    frames: usize,
    path: &Path,
    values: &mut Values,
) -> Result<(Vec<(Id, Id)>, String), Error> {
    let mut steps: Vec<Vec<(usize, usize)>> = rows.users.iter().map(|_| Vec::new()).collect();
    for (row, (track, step)) in rows.track.iter().zip(&rows.step).enumerate() {
        steps[*track as usize].push((*step as usize, row));
    }
    let mut assumed: BTreeMap<&str, usize> = BTreeMap::new();
    let mut tracks = Vec::with_capacity(rows.users.len());
    for (user, mut own) in rows.users.iter().zip(steps) {
        own.sort_unstable();
        let wrong = |field: &str, found: String, expected: &str| Error::Field {
            path: path.to_owned(),
            field: format!("{field} of `{}`", user.id.escape_debug()),
            found,
            expected: expected.to_owned(),
        };
        if let Some(pair) = own.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(wrong("timestep", format!("step {} in two rows", pair[0].0), "one row in a step"));
        }
        let (mut place, mut speed, mut heading, mut valid) =
            (vec![0.0; 3 * frames], vec![0.0; 2 * frames], vec![0.0; frames], vec![0u8; frames]);
        for (step, row) in own {
            let [x, y, turned, vx, vy] = [0, 1, 2, 3, 4].map(|k| rows.motion[k][row]);
            let names = ["position_x", "position_y", "heading", "velocity_x", "velocity_y"];
            let mut all = names.into_iter().zip([x, y, turned, vx, vy]);
            if let Some((name, bad)) = all.find(|(_, value)| !(value.abs() <= MAX_COORDINATE)) {
                let name = format!("{name} in step {step}");
                return Err(wrong(&name, bad.to_string(), "a finite number"));
            }
            place[3 * step..][..2].copy_from_slice(&[x, y]);
            speed[2 * step..][..2].copy_from_slice(&[vx, vy]);
            (heading[step], valid[step]) = (turned, 1);
        }
        *assumed.entry(&user.kind).or_default() += 1;
        let [length, width, height] = size_of_type(&user.kind).map(|size| values.float(size));
        let (place, speed) = (values.doubles(&[frames, 3], &place), values.doubles(&[frames, 2], &speed));
        let (heading, valid) = (values.doubles(&[frames], &heading), values.bools(&valid));
        let state = values.dict([
            ("position", place),
            ("velocity", speed),
            ("heading", heading),
            ("valid", valid),
            ("length", length),
            ("width", width),
            ("height", height),
        ]);
        let (name, kind) = (values.text(&user.id), values.text(&kind_of(&user.kind)));
        let (length, dataset) = (values.int(frames as i64), values.word(DATASET));
        let (own, category) = (values.text(&user.kind), values.int(user.category));
        let metadata = values.dict([
            ("track_length", length),
            ("type", kind),
            ("object_id", name),
            ("dataset", dataset),
            ("object_type", own),
            ("object_category", category),
        ]);
        let track = values.dict([("type", kind), ("state", state), ("metadata", metadata)]);
        tracks.push((name, track));
    }
    let sizes = assumed.into_iter().map(|(kind, count)| {
        let [length, width, height] = size_of_type(kind);
        format!("{count} × {} {length} × {width} × {height} m", kind.escape_debug())
    });
    let sizes: Vec<String> = sizes.collect();
    let sizes = format!("the format has no sizes; assumed are {}", sizes.join(", "));
    Ok((tracks, sizes))
}

fn map_features(
    map: &MapFile,
    path: &Path,
    values: &mut Values,
    notes: &mut Vec<Note>,
) -> Result<Vec<(Id, Id)>, Error> {
    let sides = |lane: &LaneSegment| {
        let lines =
            [Some(&lane.left_lane_boundary), Some(&lane.right_lane_boundary), lane.centerline.as_ref()];
        lines.into_iter().flatten().map(Vec::len).max().unwrap_or(0)
    };
    if let Some(lane) = map.lane_segments.0.iter().find(|lane| sides(lane) > MOST_POINTS) {
        return Err(Error::Field {
            path: path.to_owned(),
            field: format!("lane_segments/{}", lane.id),
            found: format!("a lane with {} points on a side", sides(lane)),
            expected: format!("at most {MOST_POINTS}"),
        });
    }
    let lanes: Vec<Lane> = map.lane_segments.0.iter().map(Lane::new).collect();
    let derived = lanes.iter().filter(|lane| lane.is_derived()).count();
    if derived > 0 {
        notes.push(Note::Other(format!("centre lines of {derived} lanes are derived from their boundaries")));
    }
    let areas: Vec<Vec<[f64; 2]>> = map
        .drivable_areas
        .0
        .iter()
        .map(|area| area.area_boundary.iter().map(|p| p.place()).collect())
        .collect();
    let motor: Vec<Vec<[f64; 2]>> = lanes.iter().filter(|lane| lane.is_motor()).map(Lane::polygon).collect();
    let wrong = |field: &str, found: String, expected: String| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        expected,
    };
    for (field, rings) in [("drivable_areas", &areas), ("lane_segments", &motor)] {
        if let Some(bad) = rings.iter().flatten().flatten().find(|x| !(x.abs() <= MAX_COORDINATE)) {
            let expected = format!("finite numbers within ±{MAX_COORDINATE:e}");
            return Err(wrong(field, format!("with a coordinate {bad}"), expected));
        }
    }
    let corners: usize = areas.iter().map(Vec::len).sum();
    if corners > MOST_CORNERS {
        let expected = format!("at most {MOST_CORNERS}");
        return Err(wrong("drivable_areas", format!("with {corners} corners"), expected));
    }
    if edges::crosses_more_than(&areas, MOST_CROSSINGS) {
        let expected = "outlines that cross seldom, as those of roads".to_owned();
        return Err(wrong("drivable_areas", format!("with more than {MOST_CROSSINGS} crossings"), expected));
    }
    let edges = edges::edges(&areas, &motor).ok_or_else(|| {
        let expected = "lanes along the road, not to and fro across it".to_owned();
        wrong("drivable_areas", "beside too many sides of lanes".to_owned(), expected)
    })?;
    let mut all = features(&lanes, &map.pedestrian_crossings.0, values);
    for (k, edge) in edges.iter().enumerate() {
        let kind = values.word("ROAD_EDGE_BOUNDARY");
        let line = flat(edge, values);
        let feature = values.dict([("type", kind), ("polyline", line)]);
        all.push((values.text(&format!("edge-{k}")), feature));
    }
    Ok(all)
}

fn metadata(rows: &Rows, ego: &str, frames: usize, sizes: &str, values: &mut Values) -> Id {
    let times: Vec<f64> = (0..frames).map(|frame| frame as f64 * DT).collect();
    let seconds = values.doubles(&[frames], &times);
    let index = rows.users.iter().position(|user| user.id == ego).unwrap_or(0);
    let (coordinate, dataset, processed) =
        (values.word("argoverse2"), values.word(DATASET), values.bool(false));
    let (ego, length, index) = (values.text(ego), values.int(frames as i64), values.int(index as i64));
    let [id, focal, city] =
        [&rows.scenario_id, &rows.focal_track_id, &rows.city].map(|text| values.text(text));
    let sizes = values.text(sizes);
    values.dict([
        ("coordinate", coordinate),
        ("ts", seconds),
        ("metadrive_processed", processed),
        ("sdc_id", ego),
        ("dataset", dataset),
        ("scenario_id", id),
        ("track_length", length),
        ("sdc_track_index", index),
        ("focal_track_id", focal),
        ("city", city),
        (ASSUMED_SIZES, sizes),
    ])
}
