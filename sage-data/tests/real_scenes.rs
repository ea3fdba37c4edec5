//! The 430 real scenes and two samples of the wider format. Needs `SAGE_DATA` (the unpacked
//! scenes) and `SAGE_SAMPLES` (the folder with `scenarionet/` and the table of counts).

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
};

use sage_core::{
    geometry::distance,
    motion::{HISTORY, HORIZON, NOW, Trajectory},
    objective::{
        Context, ContextOptions, DrivableFeasibility, Feasibility, Scorer, Violation,
        violation::{MEDIAN, OFF_ROAD},
    },
    scene::{MapKind, Scene, SceneIndex},
};
use sage_data::{
    Recording,
    checks::{Duplicates, Summary},
    folder,
    pickle::same,
};

fn summaries(files: &[PathBuf]) -> BTreeMap<String, Summary> {
    let mut duplicates = Duplicates::default();
    let mut rows = BTreeMap::new();
    let read = |path: &Path| {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        Recording::read(path).map(|r| Summary::of(&name, &r.scene))
    };
    folder::in_order(files, read, |_, summary| {
        let mut summary = summary?;
        duplicates.note(&mut summary);
        rows.insert(summary.scene.clone(), summary);
        Ok::<(), sage_data::Error>(())
    })
    .unwrap();
    rows
}

fn has(summary: &Summary, kind: &str) -> bool {
    summary.warnings.iter().any(|w| w.kind == kind)
}

#[test]
fn all_scenes_load_with_the_known_counts_and_warnings() {
    let (Some(data), Some(samples)) = (real::data(), real::samples()) else { return };
    let rows = summaries(&folder::scene_files(&data).unwrap());
    assert_eq!(rows.len(), 430);
    let table = std::fs::read_to_string(samples.join("womd_cat500_stats.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let mut compared = 0;
    for line in lines {
        let row: HashMap<&str, &str> = header.iter().copied().zip(line).collect();
        let Some(summary) = rows.get(row["scene"]) else { continue };
        let number = |key: &str| row[key].parse::<usize>().unwrap();
        let kind = |name: &str| summary.tracks[name];
        assert_eq!(summary.id, row["id"]);
        assert_eq!(summary.tracks.values().sum::<usize>(), number("tracks"), "{}", row["scene"]);
        assert_eq!(kind("VEHICLE"), number("vehicles"));
        assert_eq!(kind("PEDESTRIAN"), number("peds"));
        assert_eq!(kind("CYCLIST"), number("cyc"));
        assert_eq!(summary.map_features, number("map_features"));
        assert_eq!(summary.map_points, number("map_points"));
        assert_eq!(summary.lights, number("lights"));
        assert_eq!(summary.adversary.as_deref(), Some(row["adv"]));
        assert_eq!(summary.adversary_history, number("adv_hist"));
        assert_eq!(summary.adversary_future, number("adv_fut"));
        let missing = number("adv_hist") < HISTORY || number("adv_fut") < HORIZON;
        assert!(!missing || has(summary, "missing-frames"), "{}", row["scene"]);
        compared += 1;
    }
    assert_eq!(compared, 430);
    let duplicate =
        |scene: &str| rows[scene].warnings.iter().find(|w| w.kind == "duplicate").map(|w| w.detail.clone());
    assert_eq!(duplicate("311").as_deref(), Some("same content as scene 105"));
    assert_eq!(duplicate("447").as_deref(), Some("same content as scene 377"));
    assert_eq!(duplicate("465").as_deref(), Some("same content as scene 377"));
    assert_eq!(rows.values().filter(|s| has(s, "duplicate")).count(), 3);
    assert!(has(&rows["458"], "overpass") && !has(&rows["0"], "one-point-lanes"));
}

#[test]
fn the_wider_format_loads() {
    let Some(samples) = real::samples() else { return };
    let read = |name: &str| Recording::read(&samples.join("scenarionet").join(name)).unwrap().scene;
    let overpass = read("waymo_overpass.pkl");
    assert_eq!((overpass.frames, overpass.tracks.len(), overpass.lights.len()), (199, 45, 14));
    let summary = Summary::of("overpass", &overpass);
    assert!(has(&summary, "overpass") && has(&summary, "note"), "{:?}", summary.warnings);
    // Two objects of interest, neither of them the ego: the adversary is selected by conflict.
    assert_eq!(overpass.adversary_origin, sage_core::scene::AdversaryOrigin::Conflict);
    let nuscenes = read("nuscenes_0.pkl");
    assert_eq!((nuscenes.frames, nuscenes.tracks.len()), (201, 30));
    let [length, width, _] = nuscenes.ego().size[NOW];
    assert!(length > 4.0 && width < 2.0, "{length} × {width}");
    let summary = Summary::of("nuscenes", &nuscenes);
    assert!(has(&summary, "swapped-sizes") && has(&summary, "no-road-edges") && !has(&summary, "overpass"));
    assert_eq!(summary.tracks["TRAFFIC_CONE"], 5);
}

fn everything() -> Vec<PathBuf> {
    let mut files = real::data().map(|data| folder::scene_files(&data).unwrap()).unwrap_or_default();
    if let Some(samples) = real::samples() {
        files.extend(
            ["waymo_overpass.pkl", "nuscenes_0.pkl"].map(|name| samples.join("scenarionet").join(name)),
        );
    }
    files
}

#[test]
fn pickle_to_scene_to_pickle_loses_nothing_and_neither_does_a_native_file_between() {
    let files = everything();
    let read = |path: &Path| {
        let first = Recording::read(path).unwrap();
        let again = Recording::from_bytes(path, first.to_pickle().unwrap()).unwrap();
        let native = Recording::from_bytes(path, first.to_native().unwrap()).unwrap();
        let back = Recording::from_bytes(path, native.to_pickle().unwrap()).unwrap();
        let a = first.document().unwrap().unwrap();
        [again, native, back].iter().all(|other| {
            let b = other.document().unwrap().unwrap();
            first.scene == other.scene && same(&a, a.root(), &b, b.root())
        })
    };
    folder::in_order(&files, read, |path, equal| if equal { Ok(()) } else { Err(path.to_owned()) }).unwrap();
}

#[test]
fn python_reads_equal_values() {
    let files = everything();
    let compare = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/compare.py");
    let folder = tempfile::tempdir().unwrap();
    let mut skipped = false;
    // One process for several files: Python starts slowly, and disks are small.
    for (k, part) in files.chunks(40).enumerate() {
        if skipped {
            break;
        }
        let mut pairs = Vec::new();
        for (j, path) in part.iter().enumerate() {
            let written = folder.path().join(format!("{k}-{j}.pkl"));
            Recording::read(path).unwrap().write(&written).unwrap();
            pairs.extend([path.clone(), written]);
        }
        match Command::new("python3").arg(&compare).args(&pairs).output() {
            Ok(run) if run.status.code() == Some(3) => skipped = true,
            Ok(run) => assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stdout)),
            Err(_) => skipped = true,
        }
        pairs.iter().skip(1).step_by(2).for_each(|path| std::fs::remove_file(path).unwrap());
    }
    if skipped {
        eprintln!("left out: no python3 with numpy at hand");
    }
}

/// Logged futures that are complete and move at least 4 m: their number, and how many violate each rule.
#[test]
fn recorded_drivers_rarely_violate_a_rule() {
    let Some(data) = real::data() else { return };
    let evaluate = |path: &Path| {
        let scene = Recording::read(path).unwrap().scene;
        let index = SceneIndex::new(scene.map.clone());
        let (ego, adversary) = (scene.ego, scene.adversary.unwrap());
        let mut found = Vec::new();
        for (one, other) in [(ego, adversary), (adversary, ego)] {
            let track = &scene.tracks[one];
            let whole =
                track.count_valid(NOW..NOW + HORIZON + 1) == HORIZON + 1 && scene.tracks[other].is_valid(NOW);
            if !whole || distance(track.point(NOW), track.point(NOW + HORIZON)) < 4.0 {
                continue;
            }
            let mut turned = scene.clone();
            (turned.ego, turned.adversary) = (other, Some(one));
            let Ok(ctx) = Context::new(&Arc::new(turned), &index, &ContextOptions::default()) else {
                continue;
            };
            let points = (NOW + 1..=NOW + HORIZON).map(|f| track.point(f)).collect();
            let log = ctx.candidate(Trajectory::new("log", points).unwrap());
            let scores = Scorer::new(&ctx).scores(&log);
            let off_road = |v: &Violation| v.rule == OFF_ROAD;
            let lanes_only = without_edges(&ctx);
            let beyond_lanes =
                DrivableFeasibility::default().violations(&log, &lanes_only).iter().any(off_road);
            let touches_median = scores.violations_drivable.iter().any(|v| v.rule == MEDIAN);
            found.push([!scores.feasible, !scores.feasible_drivable, touches_median, beyond_lanes]);
        }
        found
    };
    let (mut n, mut counts) = (0, [0; 4]);
    folder::in_order(&folder::scene_files(&data).unwrap(), evaluate, |_, found| {
        n += found.len();
        for one in found {
            counts.iter_mut().zip(one).for_each(|(count, is)| *count += usize::from(is));
        }
        Ok::<(), ()>(())
    })
    .unwrap();
    let [paper, drivable, medians, lanes] = counts;
    println!(
        "{n} logged futures: {paper} violate the rule `paper`, {drivable} the rule `drivable`; {medians} touch a median; {lanes} are off the road if the lanes bound it"
    );
    assert!(n > 800 && drivable < n / 15 && paper < n / 20 && medians < 5 && lanes < n / 20, "{counts:?}");
}

/// The same scene without the edges of its map.
fn without_edges(ctx: &Context) -> Context {
    let mut map = (*ctx.scene().map).clone();
    map.features.retain(|f| !matches!(f.kind, MapKind::EdgeBoundary | MapKind::EdgeMedian));
    let scene = Scene { map: map.into(), ..(**ctx.scene()).clone() };
    let index = SceneIndex::new(scene.map.clone());
    Context::new(&Arc::new(scene), &index, &ContextOptions::default()).unwrap()
}
