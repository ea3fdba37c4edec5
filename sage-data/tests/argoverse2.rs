//! Scenarios of Argoverse 2: files of every shape, edges, the adversary, and a published scenario.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod argoverse;
mod real;

use std::path::Path;

use argoverse::{ID, Shape, map, parquet, rows, write};
use sage_core::{
    geometry::{Point, distance},
    scene::{Map, MapKind, Scene, TrackKind},
};
use sage_data::{ReadOptions, Recording, folder};

fn read(scenario: &[u8]) -> Result<Recording, String> {
    read_as(scenario, &map().to_string(), &ReadOptions::default())
}

fn read_as(scenario: &[u8], map: &str, options: &ReadOptions) -> Result<Recording, String> {
    let root = tempfile::tempdir().unwrap();
    Recording::read_as(&write(root.path(), scenario, map), options)
        .map_err(|error| error.to_string().replace(&*root.path().to_string_lossy(), "."))
}

fn lines(map: &Map, is: impl Fn(&MapKind) -> bool) -> Vec<Vec<Point>> {
    let features = map.features.iter().filter(|feature| is(&feature.kind));
    features.map(|feature| map.points_of(feature).iter().map(|p| [p[0], p[1]]).collect()).collect()
}

fn cross([a, b]: [Point; 2], [c, d]: [Point; 2]) -> bool {
    let side = |p: Point, q: Point, r: Point| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

fn sides(line: &[Point]) -> impl Iterator<Item = [Point; 2]> {
    line.windows(2).map(|w| [w[0], w[1]])
}

/// Whether any edge cuts a line.
fn is_cut(line: &[Point], edges: &[Vec<Point>]) -> bool {
    edges.iter().flat_map(|edge| sides(edge)).any(|edge| sides(line).any(|side| cross(side, edge)))
}

#[test]
fn files_of_every_shape_are_one_scene() {
    let plain = read(&parquet(&rows(), &Shape::default())).unwrap().scene;
    assert_eq!((plain.id.as_str(), plain.frames, plain.ego().id.as_str()), (ID, 91, "AV"));
    let mut shuffled = rows();
    for k in 0..shuffled.len() {
        let other = (k * 7919 + 13) % shuffled.len();
        shuffled.swap(k, other);
    }
    let shapes = [
        Shape { groups: 7, ..Shape::default() },
        Shape { dictionary: true, ..Shape::default() },
        Shape { snappy: false, ..Shape::default() },
        Shape { dictionary: true, snappy: false, groups: 3, ..Shape::default() },
        Shape { optional: false, ..Shape::default() },
        Shape { without: vec!["focal_track_id"], ..Shape::default() },
    ];
    for (number, shape) in shapes.into_iter().enumerate() {
        // Seeds of the fuzz target.
        if let Some(folder) = std::env::var_os("SAGE_CORPUS") {
            let file = Path::new(&folder).join(format!("{number}.parquet"));
            std::fs::write(file, parquet(&rows()[..60], &shape)).unwrap();
        }
        let scene = read(&parquet(&rows(), &shape)).unwrap().scene;
        let without_notes = |scene: &Scene| Scene { notes: Vec::new(), ..scene.clone() };
        assert!(without_notes(&scene) == without_notes(&plain), "{} groups", shape.groups);
        let mut scene = read(&parquet(&shuffled, &shape)).unwrap().scene;
        // Road users come in the order of the file.
        let order = |id: &str| plain.tracks.iter().position(|track| track.id == id);
        scene.tracks.sort_by_key(|track| order(&track.id));
        assert!(scene.tracks == plain.tracks && scene.map == plain.map);
    }
    let single = read(&parquet(&rows(), &Shape { single: true, ..Shape::default() })).unwrap().scene;
    for (track, of) in single.tracks.iter().zip(&plain.tracks) {
        assert_eq!(track.valid, of.valid);
        assert!(track.position.iter().zip(&of.position).all(|(a, b)| (a[0] - b[0]).abs() < 1e-4));
    }
}

#[test]
fn motion_is_that_of_the_file_around_now() {
    let rows = rows();
    for now in [None, Some(10), Some(29), Some(49)] {
        let options = ReadOptions { now, ..ReadOptions::default() };
        let scene = read_as(&parquet(&rows, &Shape::default()), &map().to_string(), &options).unwrap().scene;
        let first = now.unwrap_or(20) - 10;
        assert_eq!(scene.frames, 91.min(110 - first));
        assert_eq!(
            scene.notes.iter().any(|note| note.to_string().contains("of 80 frames follow")),
            now == Some(49)
        );
        for (id, _, _, step, [x, y, heading, vx, vy]) in &rows {
            let track = scene.tracks.iter().find(|track| track.id == *id).unwrap();
            let Some(frame) = (*step as usize).checked_sub(first).filter(|frame| *frame < scene.frames)
            else {
                continue;
            };
            assert!(track.valid[frame]);
            assert_eq!((track.position[frame], track.heading[frame]), ([*x, *y, 0.0], *heading));
            assert_eq!(track.velocity[frame], [*vx, *vy]);
        }
        let counted: usize =
            scene.tracks.iter().map(|track| track.valid.iter().filter(|valid| **valid).count()).sum();
        let inside =
            rows.iter().filter(|row| (first as i64..(first + scene.frames) as i64).contains(&row.3)).count();
        assert_eq!(counted, inside);
    }
    let error = read_as(
        &parquet(&rows, &Shape::default()),
        &map().to_string(),
        &ReadOptions { now: Some(9), ..ReadOptions::default() },
    );
    assert!(error.unwrap_err().contains("--now 10 to 109"));
}

#[test]
fn who_is_who() {
    let scene = read(&parquet(&rows(), &Shape::default())).unwrap().scene;
    let track = |id: &str| scene.tracks.iter().find(|track| track.id == id).unwrap();
    assert_eq!(scene.adversary.map(|k| scene.tracks[k].id.as_str()), Some("1"));
    for (id, kind, size) in [
        ("3", TrackKind::Vehicle, [12.0, 2.6, 3.2]),
        ("5", TrackKind::Vehicle, [2.2, 0.9, 1.6]),
        ("4", TrackKind::Pedestrian, [0.7, 0.7, 1.75]),
        ("6", TrackKind::Other("STATIC".to_owned()), [1.0; 3]),
        ("7", TrackKind::Other("RIDERLESS_BICYCLE".to_owned()), [1.75, 0.6, 1.1]),
    ] {
        assert_eq!((&track(id).kind, track(id).size[20]), (&kind, size), "{id}");
    }
    assert_eq!(scene.notes.iter().filter(|note| note.to_string().starts_with("no-size")).count(), 1);
    let focal = scene.clone().with_roles(None, Some("focal")).unwrap();
    assert_eq!(focal.adversary, scene.tracks.iter().position(|track| track.id == "5"));
    // Without a scored one, an unscored one that is there all the time; a fragment is none.
    let unscored: Vec<_> = rows()
        .into_iter()
        .map(|mut row| {
            row.2 = row.2.min(1);
            row
        })
        .collect();
    let found = read(&parquet(&unscored, &Shape::default())).unwrap().scene;
    assert!(found.adversary.is_some_and(|k| ["1", "5"].contains(&&*found.tracks[k].id)));
    let fragments: Vec<_> = rows()
        .into_iter()
        .map(|mut row| {
            row.2 = 0;
            row
        })
        .collect();
    assert_eq!(read(&parquet(&fragments, &Shape::default())).unwrap().scene.adversary, None);
}

#[test]
fn the_map_is_flat_linked_and_bounded_with_the_road_on_the_left() {
    let scene = read(&parquet(&rows(), &Shape::default())).unwrap().scene;
    let map = &scene.map;
    assert!(map.points.iter().all(|p| p[2] == 0.0));
    let feature = |id: &str| map.features.iter().position(|feature| feature.id == id).unwrap();
    let lane = map.features[feature("11")].lane.as_deref().unwrap();
    assert_eq!((&lane.exits, lane.neighbors[0][0].lane), (&vec![feature("12")], feature("13")));
    assert!(lane.width.iter().all(|width| (width[0] - 1.75).abs() < 1e-9 && (width[1] - 1.75).abs() < 1e-9));
    assert_eq!(map.points_of(&map.features[feature("12")]), [[150.0, 200.0, 0.0], [250.0, 200.0, 0.0]]);
    assert_eq!(map.features[feature("15")].kind, MapKind::LaneBike);
    let edges = lines(map, MapKind::is_edge);
    let motor = lines(map, MapKind::is_motor_lane);
    assert!(motor.iter().all(|lane| !is_cut(lane, &edges)));
    // Right of the lanes the road ends 1.25 m beside them; the edge has the road on its left, so it leads eastwards.
    let right =
        edges.iter().flat_map(|edge| sides(edge)).find(|[a, b]| a[1] == 197.0 && b[1] == 197.0).unwrap();
    assert!(right[0][0] < right[1][0]);
    // A path off the road is cut.
    assert!(is_cut(&[[100.0, 200.0], [100.0, 190.0]], &edges));
}

#[test]
fn folders_names_and_other_formats() {
    let root = tempfile::tempdir().unwrap();
    let file = write(root.path(), &parquet(&rows(), &Shape::default()), &map().to_string());
    assert_eq!(folder::scene_files(root.path()).unwrap(), std::slice::from_ref(&file));
    assert_eq!(folder::scene_name(&file).unwrap(), ID);
    let recording = Recording::read(&file).unwrap();
    let same = |bytes: Vec<u8>| {
        let read = Recording::from_bytes(Path::new("some.file"), bytes).unwrap().scene;
        let plain = |scene: &Scene| Scene { notes: Vec::new(), ..scene.clone() };
        assert_eq!(read.adversary.map(|k| read.tracks[k].id.clone()), Some("1".to_owned()));
        let roles = |scene: &Scene| Scene {
            adversary: None,
            adversary_origin: recording.scene.adversary_origin,
            ..plain(scene)
        };
        assert!(roles(&read) == roles(&recording.scene));
    };
    same(recording.to_pickle().unwrap());
    same(recording.to_native().unwrap());
    assert_eq!(recording.dataset().unwrap().as_deref(), Some("argoverse2"));
    let json = recording.to_gpudrive().unwrap();
    let again = Recording::from_bytes(Path::new("some.json"), json.json).unwrap().scene;
    // Bytes that are read to be hashed hold the map too.
    let bytes = sage_data::read_bytes(&file).unwrap();
    assert!(bytes.len() > parquet(&rows(), &Shape::default()).len() + map().to_string().len());
    let other = root.path().join("elsewhere.parquet");
    assert!(Recording::from_bytes(&other, bytes).unwrap().scene == recording.scene);
    let error = read_as(
        &parquet(&rows(), &Shape::default()),
        &map().to_string(),
        &ReadOptions { ego_track: Some("4".to_owned()), ..ReadOptions::default() },
    );
    assert!(error.unwrap_err().contains("without a vehicle `4`"));
    assert_eq!((again.ego().id.as_str(), again.frames), ("AV", 91));
    assert!(json.notes.keys().any(|note| note.contains("STATIC")));
    assert!(
        again.notes.iter().any(|note| note.to_string().starts_with("no-size")),
        "what is assumed stays so"
    );
}

#[test]
fn the_published_scenario_is_read_as_it_is() {
    let Some(root) = real::reference("formats/argoverse2") else { return };
    let files = folder::scene_files(&root).unwrap();
    let recording = Recording::read(&files[0]).unwrap();
    let scene = &recording.scene;
    let id = "0a1e6f0a-1817-4a98-b02e-db8c9327d151";
    assert_eq!((scene.id.as_str(), scene.frames, scene.tracks.len()), (id, 91, 58));
    // Another interface of the library, row by row.
    use parquet::{
        file::{reader::FileReader, serialized_reader::SerializedFileReader},
        record::Field,
    };
    let table = SerializedFileReader::new(std::fs::File::open(&files[0]).unwrap()).unwrap();
    let mut seen = 0;
    for row in table.get_row_iter(None).unwrap() {
        let row: std::collections::HashMap<String, Field> = row.unwrap().into_columns().into_iter().collect();
        let number = |name: &str| if let Field::Double(x) = row[name] { x } else { panic!("{name}") };
        let (Field::Str(id), Field::Long(step)) = (&row["track_id"], &row["timestep"]) else { panic!() };
        let track = scene.tracks.iter().find(|track| track.id == *id).unwrap();
        let Some(frame) = usize::try_from(*step - 10).ok().filter(|frame| *frame < 91) else { continue };
        assert!(track.valid[frame]);
        let found = [
            track.position[frame][0],
            track.position[frame][1],
            track.heading[frame],
            track.velocity[frame][0],
            track.velocity[frame][1],
        ];
        let names = ["position_x", "position_y", "heading", "velocity_x", "velocity_y"];
        names.iter().zip(found).for_each(|(name, found)| assert!((number(name) - found).abs() < 1e-9));
        seen += 1;
    }
    assert_eq!(
        seen,
        scene.tracks.iter().map(|track| track.valid.iter().filter(|valid| **valid).count()).sum::<usize>()
    );
    let edges = lines(&scene.map, MapKind::is_edge);
    let motor = lines(&scene.map, MapKind::is_motor_lane);
    assert_eq!((motor.len(), motor.iter().filter(|lane| is_cut(lane, &edges)).count()), (34, 0));
    let length: f64 = edges.iter().flat_map(|edge| sides(edge)).map(|[a, b]| distance(a, b)).sum();
    assert!(length > 500.0, "{length} m of edges");
    let vehicles = || scene.tracks.iter().filter(|track| track.kind == TrackKind::Vehicle);
    let (mut boxes, mut touching, mut driven) = (0, 0, 0);
    for track in vehicles() {
        let moves = (0..91).any(|f| track.valid[f] && track.velocity[f][0].hypot(track.velocity[f][1]) > 1.0);
        for frame in (0..91).filter(|frame| track.valid[*frame]) {
            let area = track.oriented_box(frame);
            let touches = edges.iter().any(|edge| sides(edge).any(|[a, b]| area.intersects_segment(a, b)));
            (boxes, touching, driven) =
                (boxes + 1, touching + usize::from(touches), driven + usize::from(touches && moves));
        }
    }
    // Parked cars stand at the kerb.
    assert_eq!((boxes, touching, driven), (1483, 279, 0));
    let cut = vehicles().filter(|track| {
        let path: Vec<Point> = (0..91).filter(|f| track.valid[*f]).map(|f| track.point(f)).collect();
        is_cut(&path, &edges)
    });
    assert_eq!(cut.map(|track| track.id.clone()).collect::<Vec<_>>(), Vec::<String>::new());
}
