//! TFRecord files of `Scenario` protos: the fixtures read as an independent reader reads them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;
mod sha256;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
};

use sage_core::scene::{Lane, Map, Scene};
use sage_data::{
    ReadOptions, Recording, VariantWriter, folder,
    pickle::{Document, Id, Node, same},
    procedural::{self, Kind},
    stream::Inputs,
    womd,
};
use serde_json::{Value, json};

fn synthetic() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/womd_synthetic.tfrecord")
}

/// All scenes of a shard.
fn scenes(shard: &Path) -> Vec<Recording> {
    Inputs::under(&[shard.to_owned()])
        .unwrap()
        .items()
        .map(|item| item.read(&ReadOptions::default()).unwrap())
        .collect()
}

fn get(document: &Document, id: Id, key: &str) -> Id {
    document.get(id, key).unwrap_or_else(|| panic!("no `{key}`"))
}

fn text(document: &Document, id: Id) -> String {
    document.text(id).unwrap().to_owned()
}

/// Entries of a dict by text.
fn entries(document: &Document, id: Id) -> Vec<(String, Id)> {
    document.entries(id).unwrap().iter().map(|(key, value)| (text(document, *key), *value)).collect()
}

fn array_bytes(document: &Document, id: Id) -> &[u8] {
    match document.node(id) {
        Node::Array(array) => document.bytes(array.data),
        node => panic!("{} instead of an array", node.kind()),
    }
}

fn floats(document: &Document, id: Id) -> Vec<f64> {
    array_bytes(document, id).as_chunks::<4>().0.iter().map(|x| f64::from(f32::from_le_bytes(*x))).collect()
}

/// Plain values as JSON, with the keys in their order and without spaces.
fn compact(document: &Document, id: Id) -> String {
    match document.node(id) {
        Node::Int(x) => x.to_string(),
        Node::Str(_) => format!("{:?}", text(document, id)),
        Node::List(items) => {
            let items: Vec<String> = items.iter().map(|item| compact(document, *item)).collect();
            format!("[{}]", items.join(","))
        }
        Node::Dict(entries) => {
            let entry = |(key, value): &(Id, Id)| {
                format!("{}:{}", compact(document, *key), compact(document, *value))
            };
            format!("{{{}}}", entries.iter().map(entry).collect::<Vec<_>>().join(","))
        }
        node => panic!("{}", node.kind()),
    }
}

fn plain(document: &Document, id: Id) -> Value {
    serde_json::from_str(&compact(document, id)).unwrap()
}

fn count(words: impl IntoIterator<Item = String>) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    words.into_iter().for_each(|word| *counts.entry(word).or_default() += 1);
    counts
}

fn hash<'d>(arrays: impl IntoIterator<Item = &'d [u8]>) -> String {
    sha256::hex(&arrays.into_iter().collect::<Vec<_>>().concat())
}

/// Numbers and hashes of everything in a document, in the form of the fixtures' JSON files.
fn described(document: &Document) -> Value {
    let root = document.root();
    let metadata = get(document, root, "metadata");
    let ts = floats(document, get(document, metadata, "ts"));
    let mut all = json!({
        "id": text(document, get(document, root, "id")),
        "frames": document.integer(get(document, root, "length")),
        "ts_sha256": hash([array_bytes(document, get(document, metadata, "ts"))]),
        "ts_first_last": [ts[0], ts[ts.len() - 1]],
        "tracks": tracks(document),
        "lights": lights(document),
        "map": map(document),
    });
    for key in ["sdc_id", "sdc_track_index", "current_time_index", "objects_of_interest", "tracks_to_predict"]
    {
        all[key] = plain(document, get(document, metadata, key));
    }
    all
}

fn tracks(document: &Document) -> Value {
    const COLUMNS: [&str; 6] = ["position", "length", "width", "height", "heading", "velocity"];
    let tracks = entries(document, get(document, document.root(), "tracks"));
    let state = |track: Id| get(document, track, "state");
    let valid: Vec<&[u8]> = tracks
        .iter()
        .map(|(_, track)| array_bytes(document, get(document, state(*track), "valid")))
        .collect();
    let column = |key: &str| {
        hash(tracks.iter().map(|(_, track)| array_bytes(document, get(document, state(*track), key))))
    };
    let metadata = get(document, document.root(), "metadata");
    let ego_id = text(document, get(document, metadata, "sdc_id"));
    let ego = state(tracks.iter().find(|(id, _)| *id == ego_id).unwrap().1);
    let at_10 = |key: &str| {
        let values = floats(document, get(document, ego, key));
        let width = values.len() / valid[0].len();
        let row = values[10 * width..11 * width].to_vec();
        if width == 1 { json!(row[0]) } else { json!(row) }
    };
    json!({
        "ids": tracks.iter().map(|(id, _)| id).collect::<Vec<_>>(),
        "kinds": count(tracks.iter().map(|(_, track)| text(document, get(document, *track, "type")))),
        "valid_frames": valid.iter().copied().flatten().filter(|valid| **valid != 0).count(),
        "valid_sha256": hash(valid.iter().copied()),
        "sha256": COLUMNS.into_iter().map(|key| (key, column(key))).collect::<BTreeMap<_, _>>(),
        "ego_frame_10": COLUMNS.into_iter().map(|key| (key, at_10(key))).collect::<BTreeMap<_, _>>(),
    })
}

fn lights(document: &Document) -> Value {
    let lights = entries(document, get(document, document.root(), "dynamic_map_states"));
    let states = |light: Id| -> Vec<String> {
        let states = get(document, get(document, light, "state"), "object_state");
        let word = |state: &Id| document.text(*state).unwrap_or("None").to_owned();
        document.items(states).unwrap().iter().map(word).collect()
    };
    let rows: Vec<String> = lights.iter().map(|(_, light)| states(*light).join(",")).collect();
    json!({
        "lanes": lights.iter().map(|(lane, _)| lane).collect::<Vec<_>>(),
        "states": count(lights.iter().flat_map(|(_, light)| states(*light))),
        "by_frame_sha256": sha256::hex(rows.join("\n").as_bytes()),
        "stop_points":
            lights.iter().map(|(_, light)| floats(document, get(document, *light, "stop_point"))).collect::<Vec<_>>(),
    })
}

fn map(document: &Document) -> Value {
    const LINKS: [&str; 6] = [
        "entry_lanes",
        "exit_lanes",
        "left_boundaries",
        "right_boundaries",
        "left_neighbor",
        "right_neighbor",
    ];
    let features = entries(document, get(document, document.root(), "map_features"));
    let points = |feature: Id| {
        let keys = ["polyline", "polygon", "position"].into_iter();
        array_bytes(document, keys.into_iter().find_map(|key| document.get(feature, key)).unwrap())
    };
    let kind = |feature: Id| text(document, get(document, feature, "type"));
    let lanes: Vec<(&String, Id)> = features
        .iter()
        .filter(|(_, feature)| document.get(*feature, "width").is_some())
        .map(|(id, lane)| (id, *lane))
        .collect();
    let links: Vec<String> = lanes
        .iter()
        .map(|(_, lane)| {
            let lists = LINKS.map(|key| compact(document, get(document, *lane, key)));
            format!("[{}]", lists.join(","))
        })
        .collect();
    let signs = features.iter().filter(|(_, feature)| kind(*feature) == "STOP_SIGN");
    let (first_id, first) = lanes[0];
    let row = |key: &str, n: usize| floats(document, get(document, first, key))[..n].to_vec();
    json!({
        "ids_sha256":
            sha256::hex(features.iter().map(|(id, _)| &id[..]).collect::<Vec<_>>().join(",").as_bytes()),
        "features": features.len(),
        "kinds": count(features.iter().map(|(_, feature)| kind(*feature))),
        "points": features.iter().map(|(_, feature)| points(*feature).len() / 12).sum::<usize>(),
        "points_sha256": hash(features.iter().map(|(_, feature)| points(*feature))),
        "widths":
            lanes.iter().map(|(_, lane)| array_bytes(document, get(document, *lane, "width")).len() / 8).sum::<usize>(),
        "widths_sha256": hash(lanes.iter().map(|(_, lane)| array_bytes(document, get(document, *lane, "width")))),
        "speed_limits_mph": count(lanes.iter().map(|(_, lane)| {
            format!("{:?}", document.number(get(document, *lane, "speed_limit_mph")).unwrap())
        })),
        "links_sha256": sha256::hex(format!("[{}]", links.join(",")).as_bytes()),
        "links": LINKS.into_iter().map(|key| {
            (key, lanes.iter().map(|(_, lane)| document.items(get(document, *lane, key)).unwrap().len()).sum::<usize>())
        }).collect::<BTreeMap<_, _>>(),
        "stop_sign_lanes": signs.map(|(id, sign)| (id, plain(document, get(document, *sign, "lane"))))
            .collect::<BTreeMap<_, _>>(),
        "first_lane": {
            "id": first_id,
            "points": floats(document, get(document, first, "polyline")).len() / 3,
            "polyline_0": row("polyline", 3),
            "width_0": row("width", 2),
            "speed_limit_kmh": document.number(get(document, first, "speed_limit_kmh")),
        },
    })
}

/// Asserts that a shard reads as its JSON file states.
fn assert_described(shard: &Path) {
    let expected = std::fs::read_to_string(shard.with_extension("json")).unwrap();
    let expected: Value = serde_json::from_str(&expected).unwrap();
    let scenes = scenes(shard);
    assert_eq!(scenes.len(), expected["scenes"].as_array().unwrap().len());
    for (scene, expected) in scenes.iter().zip(expected["scenes"].as_array().unwrap()) {
        let found = described(&scene.document().unwrap().unwrap());
        for (key, expected) in expected.as_object().unwrap() {
            assert_eq!(found[key], *expected, "{}: {key}", scene.path.display());
        }
    }
}

#[test]
fn an_invented_shard_reads_as_an_independent_reader_reads_it() {
    assert_described(&synthetic());
}

#[test]
fn shards_of_the_data_set_read_as_an_independent_reader_reads_them() {
    for name in ["womd_real.tfrecord", "womd_genuine.tfrecord"] {
        let Some(shard) = real::reference(&format!("formats/{name}")) else { return };
        assert_described(&shard);
    }
}

/// Writes shards of the recorded scenes with Waymo's own protos, by the reference's script, and compares. Needs a
/// Python with numpy and `waymo_open_dataset.protos`.
#[test]
fn a_scene_is_the_same_from_a_record_and_from_a_pickle() {
    let (Some(data), Some(script)) = (real::data(), real::reference("formats/make_womd.py")) else { return };
    let Some(python) = real::waymo_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    for split in ["dev", "val"] {
        let files = folder::scene_files(&data.join(split)).unwrap();
        let shard = folder.path().join(format!("{split}.tfrecord"));
        let made = Command::new(&python)
            .arg(&script)
            .args([Path::new("real"), &shard, &shard.with_extension("json")])
            .args(&files)
            .status()
            .unwrap();
        assert!(made.success());
        let records = scenes(&shard);
        assert_eq!(records.len(), files.len());
        for (record, file) in records.iter().zip(&files) {
            let pickle = Recording::read(file).unwrap();
            assert_eq!(record.scene, pickle.scene, "{}", file.display());
            assert_eq!(record.scene.content_hash(), pickle.scene.content_hash());
        }
    }
}

/// A recording as a record, read again.
fn through_record(recording: &Recording) -> (Recording, womd::Notes) {
    let encoded = recording.to_scenario().unwrap();
    let framed = womd::frame(&encoded.data);
    (Recording::from_bytes(Path::new("written.tfrecord#0"), framed).unwrap(), encoded.notes)
}

/// Asserts that two documents hold the same values under some keys of the root.
fn assert_same(a: &Document, b: &Document, keys: &[&str], name: &str) {
    for key in keys {
        assert!(same(a, get(a, a.root(), key), b, get(b, b.root(), key)), "{name}: {key}");
    }
}

const ALL: [&str; 5] = ["id", "length", "tracks", "dynamic_map_states", "map_features"];

#[test]
fn a_record_that_is_written_reads_as_the_one_that_was_read() {
    let mut shards = vec![synthetic()];
    for name in ["womd_real.tfrecord", "womd_genuine.tfrecord"] {
        shards.extend(real::reference(&format!("formats/{name}")));
    }
    for recording in shards.iter().flat_map(|shard| scenes(shard)) {
        let (again, notes) = through_record(&recording);
        assert_eq!(notes, womd::Notes::new(), "{}", recording.path.display());
        assert_eq!(again.scene, recording.scene);
        let [first, second] = [&recording, &again].map(|r| r.document().unwrap().unwrap());
        let name = recording.path.display().to_string();
        assert_same(&first, &second, &ALL, &name);
        let [a, b] = [&first, &second].map(|d| get(d, d.root(), "metadata"));
        for key in [
            "ts",
            "sdc_id",
            "sdc_track_index",
            "current_time_index",
            "objects_of_interest",
            "tracks_to_predict",
        ] {
            assert!(same(&first, get(&first, a, key), &second, get(&second, b, key)), "{name}: {key}");
        }
        // Written again, the record is the same, bit for bit.
        assert_eq!(again.to_scenario().unwrap().data, recording.to_scenario().unwrap().data);
    }
}

#[test]
fn a_record_without_an_id_is_named_and_says_so() {
    let (shard, empty_id) = (synthetic(), [0x2a, 0x00]);
    let mut record = scenes(&shard)[0].to_scenario().unwrap().data;
    record.extend(empty_id);
    let read = Recording::from_bytes(Path::new("shard.tfrecord#7"), womd::frame(&record)).unwrap();
    let warnings = sage_data::checks::warnings(&read.scene);
    let warning = warnings.iter().find(|warning| warning.kind == "no-id").unwrap();
    assert!(warning.is_important);
    let expected = format!("the record has no id; it is named `{}`", read.scene.id);
    assert_eq!(warning.detail, expected);
    // Commands print it, whatever they do with the scene.
    let notes: Vec<String> = sage_data::repairs::notes_of(&read).collect();
    assert_eq!(notes, [format!("`shard.tfrecord#7`: no-id: {expected}")]);
}

#[test]
fn a_pickle_is_the_same_after_a_record() {
    let Some(data) = real::data() else { return };
    for file in folder::scene_files(&data.join("val")).unwrap() {
        let recording = Recording::read(&file).unwrap();
        let (again, notes) = through_record(&recording);
        assert_eq!(notes, womd::Notes::new(), "{}", file.display());
        assert_eq!(again.scene, recording.scene);
        let [first, second] = [&recording, &again].map(|r| r.document().unwrap().unwrap());
        assert_same(&first, &second, &ALL, &file.display().to_string());
    }
}

#[test]
fn ids_that_are_texts_are_numbered() {
    let mut scene = procedural::generate(Kind::ALL[0], 1, 0).unwrap();
    let mut map = Map::clone(&scene.map);
    map.features.iter_mut().for_each(|feature| feature.id.insert_str(0, "feature "));
    scene.map = Arc::new(map);
    scene.tracks.iter_mut().for_each(|track| track.id.insert_str(0, "track "));
    scene.lights.iter_mut().for_each(|light| light.lane.insert_str(0, "feature "));
    let recording = Recording::procedural(scene);
    let encoded = recording.to_scenario().unwrap();
    let ids = encoded.ids.unwrap();
    let (again, _) = through_record(&recording);
    assert_eq!(again.scene.tracks.len(), recording.scene.tracks.len());
    for (number, (new, old)) in again.scene.tracks.iter().zip(&recording.scene.tracks).enumerate() {
        assert_eq!(new.id, (number + 1).to_string());
        assert_eq!(ids["tracks"][&new.id], old.id);
        assert_eq!((&new.valid, new.kind.name()), (&old.valid, old.kind.name()));
    }
    assert_eq!((again.scene.ego, again.scene.adversary), (recording.scene.ego, recording.scene.adversary));
    for (new, old) in again.scene.map.features.iter().zip(&recording.scene.map.features) {
        assert_eq!(ids["map_features"][&new.id], old.id);
        assert_eq!((new.points.clone(), new.kind.name()), (old.points.clone(), old.kind.name()));
        let links = |lane: &Option<Box<Lane>>| {
            lane.as_ref().map(|lane| (lane.entries.clone(), lane.exits.clone(), lane.neighbors.clone()))
        };
        assert_eq!(links(&new.lane), links(&old.lane));
    }
    let lights = |scene: &Scene| scene.lights.iter().map(|light| light.states.clone()).collect::<Vec<_>>();
    assert_eq!(lights(&again.scene), lights(&recording.scene));
}

#[test]
fn scenes_of_other_data_sets_become_records_with_notes() {
    let Some(samples) = real::samples() else { return };
    let recording = Recording::read(&samples.join("scenarionet/nuscenes_0.pkl")).unwrap();
    let (again, notes) = through_record(&recording);
    assert!(notes["tracks of type TRAFFIC_CONE, written as OTHER"] == 5, "{notes:?}");
    assert_eq!(again.scene.tracks.len(), recording.scene.tracks.len());
    assert_eq!(again.scene.ego, recording.scene.ego);
    let overpass = Recording::read(&samples.join("scenarionet/waymo_overpass.pkl")).unwrap();
    let (again, notes) = through_record(&overpass);
    assert_eq!(notes, womd::Notes::new());
    let [first, second] = [&overpass, &again].map(|r| r.document().unwrap().unwrap());
    assert_same(&first, &second, &ALL, "overpass");
}

#[test]
fn a_record_keeps_the_data_set_and_how_a_scene_was_made() {
    let scene = procedural::generate(Kind::ALL[0], 1, 0).unwrap();
    let made = Recording::procedural(scene);
    let (again, _) = through_record(&made);
    assert_eq!(again.dataset().unwrap(), made.dataset().unwrap());
    assert_eq!(scenes(&synthetic())[0].dataset().unwrap().as_deref(), Some("waymo"));
    // An attacked scene has the id of its recording, so its record has the name of its file.
    let folder = tempfile::tempdir().unwrap();
    let attacked =
        VariantWriter::new(&made).unwrap().variant(&made.scene, "{\"lambda\":1}").unwrap().to_pickle();
    let file = folder.path().join("some-lambda1.00.pkl");
    std::fs::write(&file, attacked).unwrap();
    let (again, _) = through_record(&Recording::read(&file).unwrap());
    assert_eq!(again.provenance().unwrap().as_deref(), Some("{\"lambda\":1}"));
    assert_eq!(again.scene.id, "some-lambda1.00");
    let (again, _) = through_record(&again);
    assert_eq!((again.provenance().unwrap().is_some(), &again.scene.id[..]), (true, "some-lambda1.00"));
}

/// Waymo's own protos parse what is written, and an independent converter makes the same values of it.
#[test]
fn written_files_agree_with_waymos_protos_and_an_independent_converter() {
    let Some(script) = real::reference("formats/make_womd.py") else { return };
    let Some(python) = real::waymo_python() else { return };
    let compare = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/waymo/compare.py");
    let mut shards = vec![synthetic()];
    for name in ["womd_real.tfrecord", "womd_genuine.tfrecord"] {
        shards.extend(real::reference(&format!("formats/{name}")));
    }
    for shard in shards {
        let folder = tempfile::tempdir().unwrap();
        let written = folder.path().join("written.tfrecord");
        let mut records = Vec::new();
        for recording in scenes(&shard) {
            records.extend(womd::frame(&recording.to_scenario().unwrap().data));
            let name = format!("sd_waymo_womd_{}.pkl", recording.scene.id);
            std::fs::write(folder.path().join(name), recording.to_pickle().unwrap()).unwrap();
        }
        std::fs::write(&written, records).unwrap();
        let outcome = Command::new(&python)
            .arg(&compare)
            .args([script.parent().unwrap(), &shard, folder.path(), &written])
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&outcome.stderr).into_owned();
        assert!(outcome.status.success(), "{}: {error}", shard.display());
    }
}
