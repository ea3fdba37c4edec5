//! JSON of GPUDrive: read and written as the rules of docs/formats.md say, from Waymo's records and back.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::{
    f64::consts::{PI, TAU},
    io::Write,
    path::{Path, PathBuf},
    process::Command,
};

use sage_core::scene::{Scene, Track, TrackKind};
use sage_data::{
    ReadOptions, Recording, VariantWriter, folder,
    procedural::{self, Kind},
    stream::Inputs,
};
use serde_json::{Value, json};

fn synthetic() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/womd_synthetic.tfrecord")
}

fn scenes(shard: &Path) -> Vec<Recording> {
    let inputs = Inputs::under(&[shard.to_owned()]).unwrap();
    inputs.items().map(|item| item.read(&ReadOptions::default()).unwrap()).collect()
}

fn made(number: u64) -> Recording {
    Recording::procedural(procedural::generate(Kind::FourWay, 0, number).unwrap())
}

fn json_of(recording: &Recording) -> Vec<u8> {
    recording.to_gpudrive().unwrap().json
}

fn value_of(recording: &Recording) -> Value {
    serde_json::from_slice(&json_of(recording)).unwrap()
}

fn read(bytes: &[u8]) -> Result<Recording, String> {
    read_as(bytes, &ReadOptions::default())
}

fn read_as(bytes: &[u8], options: &ReadOptions) -> Result<Recording, String> {
    Recording::from_bytes_as(Path::new("some.json"), bytes.to_vec(), options)
        .map_err(|error| error.to_string())
}

/// What the format keeps of a scene is the same, bit for bit; headings up to whole turns.
fn assert_kept(read: &Scene, original: &Scene, tolerance: f64) {
    assert_eq!((read.frames, read.ego().id.clone()), (original.frames, original.ego().id.clone()));
    for track in &read.tracks {
        let of = original.tracks.iter().find(|other| other.id == track.id).unwrap();
        assert_eq!((&track.kind, &track.valid), (&of.kind, &of.valid));
        let last = of.valid.iter().rposition(|valid| *valid).unwrap();
        for frame in (0..read.frames).filter(|frame| track.valid[*frame]) {
            assert_eq!(track.position[frame], of.position[frame]);
            assert_eq!(track.velocity[frame], of.velocity[frame]);
            assert_eq!(track.size[frame], of.size[last]);
            let turned = (track.heading[frame] - of.heading[frame] + PI).rem_euclid(TAU) - PI;
            assert!(turned.abs() <= tolerance, "{} and {}", track.heading[frame], of.heading[frame]);
            assert!((-PI..=PI).contains(&of.heading[frame]) || (-PI..PI).contains(&track.heading[frame]));
        }
    }
    for feature in &read.map.features {
        let of = original.map.features.iter().find(|other| other.id == feature.id).unwrap();
        assert_eq!(read.map.points[feature.points.clone()], original.map.points[of.points.clone()]);
    }
    assert_eq!(read.lights.len(), original.lights.len());
    for light in &read.lights {
        let of = original.lights.iter().find(|other| other.lane == light.lane).unwrap();
        assert_eq!((light.stop_point, &light.states), (of.stop_point, &of.states));
    }
}

#[test]
fn scenes_come_back() {
    let mut all = scenes(&synthetic());
    all.extend((0..3).map(made));
    if let Some(path) = real::reference("formats/womd_genuine.tfrecord") {
        all.extend(scenes(&path));
    }
    for recording in &all {
        let bytes = json_of(recording);
        let again = read(&bytes).unwrap();
        assert_kept(&again.scene, &recording.scene, 1e-12);
        assert_eq!(again.dataset().unwrap(), recording.dataset().unwrap());
        assert!(json_of(&again) == bytes, "written twice, `{}` has other bytes", recording.scene.id);
    }
}

#[test]
fn an_independent_script_makes_the_same_of_the_same_records() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/gpudrive/from_protos.py");
    let shards = [Some(synthetic()), real::reference("formats/womd_genuine.tfrecord")];
    for shard in shards.into_iter().flatten() {
        let recordings = scenes(&shard);
        let adversary = |recording: &Recording| {
            let track = recording.scene.adversary?;
            recording.scene.tracks[track].id.parse::<i64>().ok()
        };
        let adversaries = json!(recordings.iter().map(adversary).collect::<Vec<_>>()).to_string();
        let ran = Command::new("python3").arg(&script).arg(&shard).arg(&adversaries).output();
        let Some(output) = ran.ok().filter(|output| output.status.success()) else {
            let has_numpy = Command::new("python3").args(["-c", "import numpy"]).output();
            assert!(!has_numpy.is_ok_and(|found| found.status.success()), "the script fails");
            let _ = writeln!(std::io::stderr(), "left out: no python3 with numpy at hand");
            return;
        };
        let expected: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(expected.len(), recordings.len());
        for (recording, expected) in recordings.iter().zip(expected) {
            let mut found = value_of(recording);
            found.as_object_mut().unwrap().remove("sage");
            assert_same(&found, &expected, &recording.scene.id);
        }
    }
}

/// Equal, headings to 1e-12.
fn assert_same(found: &Value, expected: &Value, at: &str) {
    match (found, expected) {
        (Value::Object(a), Value::Object(b)) => {
            let keys = |map: &serde_json::Map<String, Value>| {
                let mut keys: Vec<String> = map.keys().cloned().collect();
                keys.sort();
                keys
            };
            assert_eq!(keys(a), keys(b), "{at}");
            a.iter().for_each(|(key, value)| assert_same(value, &b[key], &format!("{at}/{key}")));
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{at}");
            a.iter().zip(b).enumerate().for_each(|(k, (a, b))| assert_same(a, b, &format!("{at}/{k}")));
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            let limit = if at.contains("/heading/") { 1e-12 } else { 0.0 };
            assert!((a - b).abs() <= limit, "{at}: {a} and {b}");
        }
        _ => assert_eq!(found, expected, "{at}"),
    }
}

#[test]
fn the_sample_is_written_as_it_was_read() {
    let Some(path) = real::reference("formats/gpudrive/tfrecord-00000-of-01000_4.json") else { return };
    let original: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let recording = Recording::read(&path).unwrap();
    let mut found = value_of(&recording);
    assert_eq!(found.as_object_mut().unwrap().remove("sage"), Some(json!({})));
    let by_id = |value: &Value| {
        let mut objects = value["objects"].as_array().unwrap().clone();
        objects.sort_by_key(|object| object["id"].as_i64());
        objects
    };
    assert_eq!(by_id(&found), by_id(&original));
    for key in ["name", "scenario_id", "roads", "tl_states"] {
        assert_eq!(found[key], original[key], "{key}");
    }
    assert_eq!(found["metadata"]["objects_of_interest"], original["metadata"]["objects_of_interest"]);
    let predicted = |value: &Value| -> Vec<Value> {
        let list = value["metadata"]["tracks_to_predict"].as_array().unwrap();
        list.iter()
            .map(|one| value["objects"][one["track_index"].as_u64().unwrap() as usize]["id"].clone())
            .collect()
    };
    assert_eq!(predicted(&found), predicted(&original));
    assert_eq!(found["objects"][0]["id"], original["objects"][80]["id"], "the ego is first");
}

/// The same in the old dialect: degrees, no ids, no metadata.
fn in_the_old_dialect(mut value: Value) -> Value {
    value.as_object_mut().unwrap().retain(|key, _| key != "metadata" && key != "sage");
    for object in value["objects"].as_array_mut().unwrap() {
        let valid = object["valid"].clone();
        let map = object.as_object_mut().unwrap();
        map.retain(|key, _| key != "id" && key != "mark_as_expert");
        for (frame, valid) in valid.as_array().unwrap().iter().enumerate() {
            if valid == true {
                let heading = map["heading"][frame].as_f64().unwrap();
                map["heading"][frame] = heading.to_degrees().into();
            } else {
                map["heading"][frame] = 1e-4.into();
                map["position"][frame] = json!({"x": 1e-4, "y": 1e-4, "z": 1e-4});
                map["velocity"][frame] = json!({"x": 1e-4, "y": 1e-4});
            }
        }
    }
    for road in value["roads"].as_array_mut().unwrap() {
        if road["type"] == "driveway" {
            road["map_element_id"] = json!(-1);
        }
    }
    value
}

#[test]
fn the_old_dialect_needs_an_ego_and_is_the_same_scene() {
    for recording in scenes(&synthetic()) {
        let present = read(&json_of(&recording)).unwrap().scene;
        let old = in_the_old_dialect(value_of(&recording)).to_string();
        let error = read(old.as_bytes()).unwrap_err();
        assert!(error.contains("old dialect") && error.contains("--ego-track"), "{error}");
        let options = |id: &str| ReadOptions { ego_track: Some(id.to_owned()), ..ReadOptions::default() };
        let found = read_as(old.as_bytes(), &options("0")).unwrap();
        assert!(
            found.scene.notes.iter().any(|note| note.to_string().contains("old dialect")),
            "{:?}",
            found.scene.notes
        );
        for (k, track) in found.scene.tracks.iter().enumerate() {
            assert_eq!(track.id, k.to_string());
            assert_eq!(track.position, present.tracks[k].position);
            let turned = track.heading.iter().zip(&present.tracks[k].heading);
            turned.for_each(|(a, b)| assert!((a - b).abs() < 1e-12, "{a} and {b}"));
        }
        let error = read_as(old.as_bytes(), &options("999")).unwrap_err();
        assert!(error.contains("without a vehicle `999`"), "{error}");
    }
}

#[test]
fn the_unit_of_headings_is_told_by_the_values() {
    let recording = &made(0);
    let scene = read(&json_of(recording)).unwrap().scene;
    let options = |id: &str| ReadOptions { ego_track: Some(id.to_owned()), ..ReadOptions::default() };
    let headings = |scene: &Scene| scene.tracks.iter().flat_map(|t| t.heading.clone()).collect::<Vec<f64>>();
    // Radians without metadata, as some writers leave them out.
    let mut radians = value_of(recording);
    radians.as_object_mut().unwrap().remove("metadata");
    // Its ids are numbers without the key `sage`.
    radians.as_object_mut().unwrap().remove("sage");
    let ego = radians["objects"][0]["id"].to_string();
    let found = read_as(radians.to_string().as_bytes(), &options(&ego)).unwrap().scene;
    assert_eq!(headings(&found), headings(&scene));
    // Radians of more than a turn, as Waymo's own are.
    let mut turned = value_of(recording);
    for object in turned["objects"].as_array_mut().unwrap() {
        for heading in object["heading"].as_array_mut().unwrap() {
            *heading = (heading.as_f64().unwrap() + 2.0 * TAU).into();
        }
    }
    let found = read(turned.to_string().as_bytes()).unwrap().scene;
    let is_off = |(a, b): (f64, f64)| a != 0.0 && (a - b - 2.0 * TAU).abs() > 1e-9;
    assert!(!headings(&found).into_iter().zip(headings(&scene)).any(is_off));
    // Degrees with metadata.
    let mut degrees = value_of(recording);
    for object in degrees["objects"].as_array_mut().unwrap() {
        for heading in object["heading"].as_array_mut().unwrap() {
            *heading = heading.as_f64().unwrap().to_degrees().into();
        }
    }
    let found = read(degrees.to_string().as_bytes()).unwrap().scene;
    assert!(headings(&found).iter().zip(headings(&scene)).all(|(a, b)| (a - b).abs() < 1e-12));
    assert!(found.notes.iter().any(|note| note.to_string().contains("degrees")));
}

#[test]
fn ids_that_collide_and_lights_without_heights() {
    let recording = &scenes(&synthetic())[0];
    let mut value = value_of(recording);
    let first = value["roads"][0]["id"].clone();
    value["roads"][1]["id"] = first;
    let lane = value["tl_states"].as_object().unwrap().keys().next().unwrap().clone();
    value["tl_states"][&lane].as_object_mut().unwrap().remove("z");
    let taken = value["objects"][1]["id"].clone();
    value["objects"][taken.as_u64().map_or(2, |_| 2)].as_object_mut().unwrap().remove("id");
    let scene = read(value.to_string().as_bytes()).unwrap().scene;
    assert!(
        scene.notes.iter().any(|note| note.to_string().contains("1 roads have the id")),
        "{:?}",
        scene.notes
    );
    let light = scene.lights.iter().find(|light| light.lane == lane).unwrap();
    assert_eq!(light.stop_point.map(|p| p[2]), Some(0.0));
    value["tl_states"][&lane]["x"] = json!([1.0, 2.0, 3.0]);
    assert!(read(value.to_string().as_bytes()).unwrap_err().contains("3 entries"));
}

#[test]
fn lights_keep_their_lane_when_ids_are_numbered() {
    let recording = &scenes(&synthetic())[0];
    let mut value = value_of(recording);
    // Texts as ids, as a scene of another data set has them.
    for road in value["roads"].as_array_mut().unwrap() {
        road["id"] = json!(format!("lane-{}", road["id"]));
    }
    let lanes: Vec<String> = value["roads"]
        .as_array()
        .unwrap()
        .iter()
        .map(|road| road["id"].as_str().unwrap().to_owned())
        .collect();
    let mut lights = value["tl_states"].as_object().unwrap().clone();
    lights.retain(|id, _| lanes.contains(&format!("lane-{id}")));
    value["tl_states"] = lights.into_iter().map(|(id, light)| (format!("lane-{id}"), light)).collect();
    let named = read(value.to_string().as_bytes()).unwrap();
    assert!(!named.scene.lights.is_empty());
    let again = read(&json_of(&named)).unwrap();
    assert_kept(&again.scene, &named.scene, 1e-12);
    assert!(json_of(&again) == json_of(&named));
}

#[test]
fn another_ego_is_chosen_and_written() {
    let recording = &scenes(&synthetic())[0];
    let is_other = |track: &&Track| {
        track.kind == TrackKind::Vehicle && track.id != recording.scene.ego().id && track.is_valid(10)
    };
    let other = recording.scene.tracks.iter().find(is_other).unwrap().id.clone();
    let options = ReadOptions { ego_track: Some(other.clone()), ..ReadOptions::default() };
    for bytes in [recording.to_pickle().unwrap(), recording.to_native().unwrap(), json_of(recording)] {
        let chosen = read_as(&bytes, &options).unwrap();
        assert_eq!(chosen.scene.ego().id, other);
        for again in [chosen.to_pickle().unwrap(), chosen.to_native().unwrap(), json_of(&chosen)] {
            assert_eq!(read(&again).unwrap().scene.ego().id, other);
        }
    }
}

#[test]
fn an_attack_tells_simulators_to_drive_the_adversary_and_not_the_ego() {
    let recording = made(0);
    let mut attacked = recording.scene.clone();
    let adversary = attacked.adversary.unwrap();
    attacked.tracks[adversary].position[40][0] += 0.25;
    let writer = VariantWriter::new(&recording).unwrap();
    let json = writer.variant(&attacked, r#"{"method":"sage"}"#).unwrap().to_gpudrive().unwrap().json;
    let value: Value = serde_json::from_slice(&json).unwrap();
    let marks: Vec<bool> =
        value["objects"].as_array().unwrap().iter().map(|o| o["mark_as_expert"].as_bool().unwrap()).collect();
    assert_eq!(marks.iter().position(|mark| *mark), Some(1));
    assert_eq!(marks.iter().filter(|mark| **mark).count(), 1);
    assert_eq!(value["metadata"]["sdc_track_index"], 0);
    let again = read(&json).unwrap();
    assert_eq!(again.provenance().unwrap().as_deref(), Some(r#"{"method":"sage"}"#));
    assert_eq!(again.scene.ego().id, attacked.ego().id);
    let track = again.scene.tracks.iter().find(|track| track.id == attacked.tracks[adversary].id).unwrap();
    assert_eq!(track.position[40], attacked.tracks[adversary].position[40]);
}

#[test]
fn unknown_keys_are_kept() {
    let mut value = value_of(&scenes(&synthetic())[0]);
    value["a key"] = json!({"x": [1, 2.5, null]});
    value["metadata"]["other"] = json!("text");
    value["objects"][1]["colour"] = json!([1, 2, 3]);
    value["roads"][0]["speed"] = json!(13.4);
    // Numbers as floats are the same.
    let id = value["roads"][0]["map_element_id"].as_i64().unwrap();
    value["roads"][0]["map_element_id"] = json!(id as f64);
    value["objects"][2]["valid"] = value["objects"][2]["valid"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| json!(f64::from(u8::from(v == true))))
        .collect();
    let again = value_of(&read(value.to_string().as_bytes()).unwrap());
    assert_eq!(again["a key"], value["a key"]);
    assert_eq!(again["metadata"]["other"], "text");
    assert_eq!(again["objects"][1]["colour"], json!([1, 2, 3]));
    assert_eq!(again["roads"][0]["speed"], 13.4);
    assert_eq!(again["roads"][0]["map_element_id"], id);
}

#[test]
fn files_are_found_by_their_content_compressed_or_not() {
    let root = tempfile::tempdir().unwrap();
    let json = json_of(&made(1));
    let path = |name: &str| root.path().join(name);
    std::fs::write(path("tfrecord-00000-of-01000_4.json"), &json).unwrap();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(&json).unwrap();
    std::fs::write(path("b.json.gz"), encoder.finish().unwrap()).unwrap();
    std::fs::write(path("run.json"), "{\"command\": \"generate\", \"results\": {}}").unwrap();
    let found = folder::scene_files(root.path()).unwrap();
    assert_eq!(found, [path("b.json.gz"), path("tfrecord-00000-of-01000_4.json")]);
    let [compressed, plain] = [&found[0], &found[1]].map(|file| Recording::read(file).unwrap().scene);
    assert!(compressed == plain);
    assert_eq!(folder::scene_name(&found[0]).unwrap(), "b");
}
