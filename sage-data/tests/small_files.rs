//! Small files written by Python (`data/make_pickles.py`): every protocol and spelling, features of other
//! writers, and files with one error each.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use sage_core::scene::Note;
use std::{
    path::{Path, PathBuf},
    process::Command,
};

use insta::assert_snapshot;
use sage_core::{
    motion::NOW,
    scene::Neighbor,
    scene::{AdversaryOrigin, LightState, MapKind, TrackKind},
};
use sage_data::{
    Error, ReadOptions, Recording, folder,
    pickle::{Document, same},
};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name)
}

/// Files of every protocol, and of either name of numpy's module.
fn small() -> Vec<String> {
    (2..=5).flat_map(|p| ["core", "_core"].map(|core| format!("small_p{p}_{core}.pkl"))).collect()
}

#[test]
fn every_protocol_and_spelling_gives_the_same_scene() {
    let first = Recording::read(&data("small_p4_core.pkl")).unwrap();
    for name in small() {
        let other = Recording::read(&data(&name)).unwrap();
        assert_eq!(other.scene, first.scene, "{name}");
        let (a, b) = (first.document().unwrap().unwrap(), other.document().unwrap().unwrap());
        assert!(same(&a, a.root(), &b, b.root()), "{name}");
    }
}

#[test]
fn the_values_are_those_that_python_wrote() {
    let recording = Recording::read(&data("small_p2__core.pkl")).unwrap();
    let (scene, source) = (&recording.scene, recording.document().unwrap().unwrap());
    assert_eq!((&scene.id[..], scene.frames, scene.ego().id.as_str()), ("small", 14, "ego"));
    assert_eq!((scene.adversary, scene.adversary_origin), (Some(1), AdversaryOrigin::File));
    assert_eq!(scene.timestamps.len(), 14);
    // 5 m/s along x, float64.
    assert_eq!(scene.tracks[0].position[13], [6.5, 0.0, 0.75]);
    // Columns in Fortran order and big-endian.
    assert_eq!(scene.tracks[1].point(0), [20.0, 3.0]);
    assert_eq!(scene.tracks[1].heading[7], std::f64::consts::PI);
    // Rows as a list of tuples, invalid frames 2 and 11.
    assert_eq!(scene.tracks[2].kind, TrackKind::Cyclist);
    assert_eq!(scene.tracks[2].count_valid(0..14), 12);
    assert!(!scene.tracks[2].is_valid(2) && scene.tracks[2].velocity[2] == [0.0, 0.0]);
    assert_eq!(scene.tracks[3].kind, TrackKind::Other("TRAFFIC_CONE".into()));
    let kinds: Vec<&MapKind> = scene.map.features.iter().map(|f| &f.kind).collect();
    assert_eq!(
        kinds,
        [
            &MapKind::LaneSurfaceStreet,
            &MapKind::LaneSurfaceStreet,
            &MapKind::EdgeBoundary,
            &MapKind::EdgeMedian
        ]
    );
    // An int key, named by an int in a list. It is the second of the file and the first by id.
    assert_eq!(scene.map.features[0].id, "17");
    assert_eq!(scene.map.features[1].lane.as_ref().unwrap().exits, [0]);
    assert_eq!(scene.map.points_of(&scene.map.features[0])[1], [45.0, 1.0, 0.0]);
    assert_eq!(scene.map.points_of(&scene.map.features[3]), [[0.0, 9.0, 1.0], [30.0, 9.0, 1.0]]);
    let metadata = source.get(source.root(), "metadata").unwrap();
    let get = |key| source.get(metadata, key).unwrap();
    assert_eq!(source.number(get("scalar")), Some(1.5));
    assert_eq!(source.integer(get("whole")), Some(-7));
    assert_eq!(source.integer(get("negative")), Some(-(1i64 << 40)));
    assert_eq!(source.text(get("text")), Some("päth \u{1F697}"));
    assert_eq!(source.describe(get("raw")), "bytes");
}

#[test]
fn the_example_scene_has_its_documented_content() {
    let scene = Recording::read(&example("crossing.pkl")).unwrap().scene;
    assert_eq!(
        (scene.frames, scene.ego().id.as_str(), scene.adversary().unwrap().id.as_str()),
        (91, "ego", "crosser")
    );
    let feature = |id: &str| scene.map.features.iter().position(|f| f.id == id).unwrap();
    let lane = |id: &str| scene.map.features[feature(id)].lane.as_ref().unwrap();
    assert_eq!(lane("east").neighbors[0][0].lane, feature("west"));
    assert_eq!(lane("east").neighbors[0][0].other, [0, 120]);
    assert_eq!(lane("north").boundaries[0][0].feature, feature("yellow"));
    assert!(lane("north").exits.is_empty(), "a lane beyond the map is left out");
    assert!((lane("east").speed_limit.unwrap() - 13.41).abs() < 0.01);
    assert_eq!(lane("east").width[0], [1.75, 1.75]);
    let light = &scene.lights[0];
    assert_eq!((light.states[0], light.states[90]), (LightState::Go, LightState::Unknown));
    assert_eq!(light.stop_point, Some([1.75, -8.0, 0.0]));
}

fn all_good() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = small().iter().map(|name| data(name)).collect();
    files.extend([data("newest_p5.pkl"), example("crossing.pkl")]);
    files
}

#[test]
fn writing_loses_nothing() {
    for path in all_good() {
        let read = Recording::read(&path).unwrap();
        let again = Recording::from_bytes(&path, read.to_pickle().unwrap()).unwrap();
        assert_eq!(read.scene, again.scene, "{}", path.display());
        let (a, b) = (read.document().unwrap().unwrap(), again.document().unwrap().unwrap());
        assert!(same(&a, a.root(), &b, b.root()), "{}", path.display());
    }
}

#[test]
fn python_reads_equal_values_before_and_after_writing() {
    let folder = tempfile::tempdir().unwrap();
    let mut pairs = Vec::new();
    for (k, path) in all_good().into_iter().enumerate() {
        let written = folder.path().join(format!("{k}.pkl"));
        Recording::read(&path).unwrap().write(&written).unwrap();
        pairs.extend([path, written]);
    }
    match Command::new("python3").arg(data("compare.py")).args(&pairs).output() {
        Ok(run) if run.status.code() == Some(3) => eprintln!("left out: no numpy at hand"),
        Ok(run) => assert!(
            run.status.success(),
            "{}{}",
            String::from_utf8_lossy(&run.stdout),
            String::from_utf8_lossy(&run.stderr)
        ),
        Err(_) => eprintln!("left out: no python3 at hand"),
    }
}

#[test]
fn only_the_changed_future_changes() {
    for path in [data("small_p4_core.pkl"), example("crossing.pkl")] {
        let read = Recording::read(&path).unwrap();
        let mut changed = read.clone();
        let adversary = read.scene.adversary.unwrap();
        let track = &mut changed.scene.tracks[adversary];
        for frame in NOW + 1..read.scene.frames {
            // 32-bit floats represent halves exactly.
            track.position[frame][0] += 0.5 * frame as f64;
            track.heading[frame] = 0.5;
            track.velocity[frame] = [1.0, 2.0];
        }
        track.position.iter_mut().for_each(|p| p.iter_mut().for_each(|x| *x = f64::from(*x as f32)));
        let again = Recording::from_bytes(&path, changed.to_pickle().unwrap()).unwrap();
        assert_eq!(again.scene, changed.scene);
        assert_ne!(again.scene, read.scene);
        // The written columns have the file's types and shapes.
        let column = |r: &Recording, key: &str| {
            let d = r.document().unwrap().unwrap();
            let id = read.scene.tracks[adversary].id.clone();
            let track = d.get(d.get(d.root(), "tracks").unwrap(), &id).unwrap();
            d.describe(d.get(d.get(track, "state").unwrap(), key).unwrap())
        };
        for key in ["position", "heading", "velocity", "valid"] {
            assert_eq!(column(&again, key), column(&read, key));
        }
        let mut other = read.clone();
        other.scene.tracks.pop();
        assert!(matches!(other.to_pickle(), Err(Error::Field { .. })));
    }
}

#[test]
fn errors_name_the_file_field_and_value() {
    let names = std::fs::read_dir(data("broken")).unwrap().map(|entry| entry.unwrap().file_name());
    let mut broken: Vec<String> = names.map(|name| name.into_string().unwrap()).collect();
    broken.sort();
    let said = broken.iter().map(|name| {
        // Otherwise a bad value of a bystander only costs its track.
        let strict = ReadOptions { strict: true, ..ReadOptions::default() };
        let error = Recording::read_as(&data("broken").join(name), &strict).expect_err(name);
        error.to_string().replace(&data("broken").display().to_string(), "broken")
    });
    assert_snapshot!("broken_files", said.collect::<Vec<_>>().join("\n"));
}

#[test]
fn a_summary_lists_the_scene_files() {
    let files = folder::scene_files(&data("scenarionet")).unwrap();
    let names: Vec<_> =
        files.iter().map(|f| f.strip_prefix(data("scenarionet")).unwrap().to_owned()).collect();
    assert_eq!(names, [Path::new("part/sd_a.pkl"), Path::new("part/sd_b.pkl")]);
    let mut visited = Vec::new();
    folder::in_order(&files, Recording::read, |path, recording| {
        recording?;
        visited.push(path.to_owned());
        Ok::<(), Error>(())
    })
    .unwrap();
    assert_eq!(visited, files);
    let empty = tempfile::tempdir().unwrap();
    assert!(matches!(folder::scene_files(empty.path()), Err(Error::NoScenes { .. })));
}

#[test]
fn files_that_are_not_pickles_are_refused_with_the_cause() {
    let parse = |bytes: &[u8]| Document::parse(bytes.to_vec()).map(|_| ()).unwrap_err().kind.to_string();
    let files: [&[u8]; 7] = [
        b"",
        b"PK\x03\x04",
        b"\x80\x06N.",
        b"\x80\x04",
        b"\x80\x04cos\nsystem\n.",
        b"\x80\x04\x97.",
        b"\x80\x04]\x94h\x00a.",
    ];
    let said = files.map(|bytes| format!("\"{}\" -> {}", bytes.escape_ascii(), parse(bytes)));
    assert_snapshot!("files_that_are_not_pickles", said.join("\n"));
}

#[test]
fn splits_are_lists_of_scenes_and_notes_are_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("splits.json");
    std::fs::write(&path, r#"{"note": "x", "dev": [3, "a"], "val": []}"#).unwrap();
    let splits = sage_data::split::read_splits(&path).unwrap();
    assert_eq!(splits["dev"], ["3", "a"]);
    assert!(splits["val"].is_empty() && !splits.contains_key("note"));
    std::fs::write(&path, r#"{"dev": [[1]]}"#).unwrap();
    let error = sage_data::split::read_splits(&path).unwrap_err().to_string();
    assert_snapshot!(error.replace(&folder.path().display().to_string(), "[folder]"), @"`[folder]/splits.json`: field `dev` is [1]; expected a scene number or name");
}

#[test]
fn python_opens_native_files_with_one_import() {
    const PROGRAM: &str = "import sys\n\
        try:\n\
        \x20   from safetensors import safe_open\n\
        \x20   import numpy\n\
        except ImportError:\n\
        \x20   sys.exit(3)\n\
        scene = safe_open(sys.argv[1], 'np')\n\
        assert scene.get_tensor('tracks.position').shape == (5, 91, 3)\n\
        assert scene.get_tensor('tracks.valid').dtype == bool\n\
        assert 'sage-scene' in scene.metadata()\n";
    let folder = tempfile::tempdir().unwrap();
    let native = folder.path().join("crossing.safetensors");
    Recording::read(&example("crossing.pkl")).unwrap().write(&native).unwrap();
    match Command::new("python3").args(["-c", PROGRAM]).arg(&native).output() {
        Ok(run) if run.status.code() == Some(3) => eprintln!("left out: no numpy and safetensors at hand"),
        Ok(run) => assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr)),
        Err(_) => eprintln!("left out: no python3 at hand"),
    }
}

#[test]
fn no_native_file_starts_like_a_pickle() {
    let mut recording = Recording::read(&data("small_p4_core.pkl")).unwrap();
    let header = |recording: &Recording| {
        let bytes = recording.to_native().unwrap();
        let length = u64::from_le_bytes(*bytes.first_chunk().unwrap());
        assert_eq!(Recording::from_bytes(Path::new("x"), bytes).unwrap().scene, recording.scene);
        length
    };
    // 0x10280: the bytes 0x80 0x02 of a pickle. Headers grow by eight bytes.
    let forbidden = 0x1_0280;
    recording.scene.notes.push(Note::Other(String::new()));
    let missing = (forbidden - header(&recording)) as usize;
    let lengths: Vec<u64> = (0..24)
        .map(|more| {
            *recording.scene.notes.last_mut().unwrap() = Note::Other("n".repeat(missing - 12 + more));
            header(&recording)
        })
        .collect();
    assert!(lengths.contains(&(forbidden - 8)) && lengths.contains(&(forbidden + 8)), "{lengths:?}");
    assert!(!lengths.contains(&forbidden), "{lengths:?}");
}

#[test]
fn lane_links_to_points_that_do_not_exist_are_left_out_or_refused() {
    let recording = Recording::read(Path::new("../examples/crossing.pkl")).unwrap();
    let map = recording.scene.map.clone();
    let (own, lane) = map.features.iter().enumerate().find(|(_, f)| f.lane.is_some()).unwrap();
    let beyond = lane.points.len();
    let link = |own_range: [usize; 2], other_range: [usize; 2]| {
        let mut scene = recording.scene.clone();
        let mut map = (*map).clone();
        let neighbor = Neighbor { lane: own, own: own_range, other: other_range };
        map.features[own].lane.as_mut().unwrap().neighbors[0].push(neighbor);
        scene.map = map.into();
        Recording::procedural(scene)
    };
    let read = |bytes: Vec<u8>| Recording::from_bytes(Path::new("x"), bytes);
    assert!(read(link([0, beyond - 1], [0, beyond - 1]).to_native().unwrap()).is_ok());
    for (own_range, other_range) in [([0, beyond], [0, 0]), ([0, 0], [beyond, 0]), ([1 << 40, 0], [0, 0])] {
        let linked = link(own_range, other_range);
        let error = read(linked.to_native().unwrap()).unwrap_err().to_string();
        assert!(
            error.contains("`lane.links`") && error.contains("ranges of points that these have"),
            "{error}"
        );
        let scene = read(linked.to_pickle().unwrap()).unwrap().scene;
        assert!(
            scene.notes.iter().any(|note| note.to_string().starts_with("1 lane links name points")),
            "{:?}",
            scene.notes
        );
        assert_eq!(scene.map, map);
    }
}
