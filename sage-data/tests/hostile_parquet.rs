//! Broken and hostile scenarios of Argoverse 2: every error names the file and the column, and no file takes much memory.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod argoverse;

use std::{alloc::System, path::Path};

use argoverse::{Row, Shape, map, parquet, rows, write};
use sage_core::seed::Rng;
use sage_data::Recording;
use serde_json::{Value, json};

/// An allocation beyond the limit fails, which ends the test.
#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, LIMIT);
/// Limit where nothing is read.
const LIMIT: usize = 1 << 30;
/// Limit of the memory that a scenario takes beside four times its size, bytes.
const MEMORY: usize = 64 << 20;

/// The error of a scenario and its map, which are read in little memory.
fn error_of(root: &Path, scenario: &[u8], map: &str) -> Option<String> {
    let file = write(root, scenario, map);
    ALLOCATOR.set_limit(ALLOCATOR.allocated() + MEMORY + 5 * (scenario.len() + map.len())).unwrap();
    let read = Recording::read(&file);
    ALLOCATOR.set_limit(LIMIT).unwrap();
    let error = read.err()?.to_string();
    assert!(error.starts_with('`') && error.len() < 900 && !error.contains('\n'), "{error}");
    Some(error)
}

fn with(place: &str, value: Value) -> String {
    let mut map = map();
    *map.pointer_mut(place).unwrap() = value;
    map.to_string()
}

fn without(place: &str) -> String {
    let mut map = map();
    let (parent, key) = place.rsplit_once('/').unwrap();
    map.pointer_mut(parent).unwrap().as_object_mut().unwrap().remove(key).unwrap();
    map.to_string()
}

fn changed(change: impl Fn(usize, &mut Row)) -> Vec<u8> {
    let mut rows = rows();
    rows.iter_mut().enumerate().for_each(|(k, row)| change(k, row));
    parquet(&rows, &Shape::default())
}

/// One test, because the limit holds for all threads.
#[test]
fn broken_scenarios_are_named_and_take_little_memory() {
    let root = tempfile::tempdir().unwrap();
    rows_that_no_scenario_has(root.path());
    maps_that_no_scenario_has(root.path());
    broken_bytes(root.path());
}

fn rows_that_no_scenario_has(root: &Path) {
    let map = map().to_string();
    let bytes = parquet(&rows(), &Shape::default());
    assert_eq!(error_of(root, &bytes, &map), None);
    let lacking = |name: &'static str| parquet(&rows(), &Shape { without: vec![name], ..Shape::default() });
    let cases: [(Vec<u8>, &str, &str); 19] = [
        (lacking("track_id"), "track_id", "missing"),
        (lacking("object_type"), "object_type", "missing"),
        (lacking("timestep"), "timestep", "missing"),
        (lacking("position_x"), "position_x", "missing"),
        (lacking("velocity_y"), "velocity_y", "missing"),
        (lacking("heading"), "heading", "missing"),
        (changed(|_, row| row.3 = 7), "timestep", "step 7 in two rows"),
        (changed(|k, row| row.3 -= i64::from(k == 5) * 9), "timestep", "-4"),
        (changed(|k, row| row.3 += i64::from(k == 5) * 1_000_000_000), "timestep", "1000000005"),
        (changed(|k, row| row.3 += i64::from(k == 5) * 39_000), "track_id", "road users in 39006 steps"),
        (changed(|_, row| row.0 = row.0.replace("AV", "EGO")), "track_id", "--ego-track"),
        (changed(|k, row| row.4[0] = if k == 3 { f64::NAN } else { row.4[0] }), "position_x", "NaN"),
        (changed(|k, row| row.4[1] = if k == 3 { f64::INFINITY } else { row.4[1] }), "position_y", "inf"),
        (changed(|k, row| row.4[2] = if k == 3 { 1e300 } else { row.4[2] }), "heading", "a finite number"),
        (
            changed(|k, row| row.4[3] = if k == 3 { -1e300 } else { row.4[3] }),
            "velocity_x",
            "a finite number",
        ),
        (
            changed(|k, row| row.4[0] += if k == 30 { 5000.0 } else { 0.0 }),
            "position",
            "from the position before",
        ),
        (changed(|_, row| row.3 += if row.0 == "AV" { 50 } else { 0 }), "metadata/sdc_id", "valid at"),
        (parquet(&[], &Shape::default()), "", "no rows"),
        (b"PAR1".to_vec(), "", "no scenario that can be read"),
    ];
    let mut wrong = Vec::new();
    for (bytes, field, expected) in cases {
        let error = error_of(root, &bytes, &map).unwrap_or_else(|| "it is read".to_owned());
        if !(error.contains(field) && error.contains(expected)) {
            wrong.push(format!("{field}, {expected}: {error}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    // A text in all rows takes its bytes once.
    let long = changed(|_, row| row.0 = format!("{}{}", row.0, "x".repeat(300)));
    assert!(error_of(root, &long, &map).unwrap().contains("track_id"));
    std::fs::remove_file(root.join(argoverse::ID).join(format!("log_map_archive_{}.json", argoverse::ID)))
        .unwrap();
    let file = root.join(argoverse::ID).join(format!("scenario_{}.parquet", argoverse::ID));
    std::fs::write(&file, &bytes).unwrap();
    let error = Recording::read(&file).unwrap_err().to_string();
    assert!(error.contains("no `log_map_archive_"), "{error}");
}

fn maps_that_no_scenario_has(root: &Path) {
    let bytes = parquet(&rows(), &Shape::default());
    let star = |count: usize| -> Value {
        let turn = |k: usize| 2.0 * std::f64::consts::PI * (k * (count / 2 - 1)) as f64 / count as f64;
        (0..count)
            .map(|k| json!({"x": 100.0 * turn(k).cos(), "y": 100.0 * turn(k).sin()}))
            .collect::<Vec<_>>()
            .into()
    };
    let lane = "/lane_segments/11";
    let at = |key: &str| format!("{lane}/{key}");
    let cases: [(String, &str, &str); 25] = [
        (String::new(), "log_map", "EOF"),
        ("[]".to_owned(), "log_map", "a map of Argoverse 2"),
        ("{".repeat(100_000), "log_map", "at line 1"),
        (format!("{{\"other\": {}", "[".repeat(1_000_000)), "log_map", "at line 1"),
        (without("/lane_segments"), "log_map", "missing field `lane_segments`"),
        (without("/drivable_areas"), "log_map", "missing field `drivable_areas`"),
        (without(&at("left_lane_boundary")), "lane_segments", "missing field `left_lane_boundary`"),
        (without(&at("lane_type")), "lane_segments", "missing field `lane_type`"),
        (without(&at("id")), "lane_segments", "missing field `id`"),
        (with("/lane_segments", json!([])), "lane_segments", "an object of features"),
        (with("/lane_segments/11", json!(7)), "lane_segments", "a lane segment"),
        (with(&at("left_lane_boundary"), json!({})), "left_lane_boundary", "a sequence"),
        (with(&at("left_lane_boundary"), json!([{"x": 1}])), "left_lane_boundary", "missing field `y`"),
        (with(&at("left_lane_boundary"), json!([7])), "left_lane_boundary", "a point"),
        (with(&at("left_lane_boundary/0/x"), json!("a")), "left_lane_boundary/0/x", "expected f64"),
        (with(&at("left_lane_boundary/0/x"), json!(1e300)), "lane_segments", "within"),
        (with(&at("id"), json!("eleven")), "lane_segments", "expected i64"),
        (with(&at("id"), json!(12)), "map_features", "twice"),
        (with(&at("left_lane_boundary"), star(2000)), "lane_segments/11", "2000 points"),
        (with(&at("successors"), json!("12")), "successors", "a sequence"),
        (with(&at("lane_type"), json!(1)), "lane_type", "a string"),
        (with("/drivable_areas/1/area_boundary/0/x", json!(1e300)), "drivable_areas", "within"),
        (with("/drivable_areas/1/area_boundary", star(30_000)), "drivable_areas", "30004 corners"),
        (with("/drivable_areas/1/area_boundary", star(1000)), "drivable_areas", "crossings"),
        (with("/pedestrian_crossings/21/edge1", json!(null)), "edge1", "a sequence"),
    ];
    let mut wrong = Vec::new();
    for (map, field, expected) in cases {
        let error = error_of(root, &bytes, &map).unwrap_or_else(|| "it is read".to_owned());
        if !(error.contains(field) && error.contains(expected)) {
            wrong.push(format!("{field}, {expected}: {error}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    // Lanes that follow one another in a circle, neighbours and lanes that are not there, and lanes of a point are read.
    for map in [
        with(&at("successors"), json!([11])),
        with(&at("predecessors"), json!([12, 11])),
        with(&at("left_neighbor_id"), json!(11)),
        with(&at("left_neighbor_id"), json!(999)),
        with(&at("left_lane_boundary"), json!([{"x": 1.0, "y": 2.0}])),
        with(&at("left_lane_mark_type"), json!("PURPLE")),
        with(&at("lane_type"), json!("TRAM")),
        with("/drivable_areas", json!({})),
        with("/drivable_areas/1/area_boundary", star(20)),
        with("/drivable_areas/1/area_boundary", json!([])),
    ] {
        assert_eq!(error_of(root, &bytes, &map), None);
    }
}

fn broken_bytes(root: &Path) {
    let map = map().to_string();
    let shapes = [
        Shape::default(),
        Shape { dictionary: true, groups: 3, ..Shape::default() },
        Shape { snappy: false, ..Shape::default() },
    ];
    for (number, shape) in shapes.iter().enumerate() {
        let whole = parquet(&rows(), shape);
        for share in 0..40 {
            assert!(error_of(root, &whole[..whole.len() * share / 40], &map).is_some(), "{share} of 40");
        }
        let mut rng = Rng::new(number as u64, "parquet", "mutation");
        for _ in 0..1500 {
            let mut bytes = whole.clone();
            // The footer decides what is read where.
            let footer = rng.below(2) == 0;
            let from = if footer { bytes.len() - bytes.len().min(2500) } else { 0 };
            for _ in 0..1 + rng.below(4) {
                let at = from + rng.below(bytes.len() - from);
                bytes[at] =
                    if rng.below(2) == 0 { rng.bits() as u8 } else { bytes[at] ^ (1 << rng.below(8)) };
            }
            // It is an error or a scene.
            let _ = error_of(root, &bytes, &map);
        }
    }
}
