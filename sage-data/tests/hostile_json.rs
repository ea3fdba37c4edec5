//! Broken and hostile JSON of GPUDrive: every error names the file and the field, and no file takes much memory.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{alloc::System, path::Path};

use sage_data::{
    Recording,
    procedural::{self, Kind},
};
use serde_json::{Value, json};

/// An allocation beyond the limit fails, which ends the test.
#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, LIMIT);
/// Limit where nothing is read.
const LIMIT: usize = 1 << 30;

/// Limit of the memory that a file takes beside four times its size, bytes.
const MEMORY: usize = 64 << 20;

fn scene() -> Value {
    let scene = procedural::generate(Kind::FourWay, 0, 0).unwrap();
    let mut value: Value =
        serde_json::from_slice(&Recording::procedural(scene).to_gpudrive().unwrap().json).unwrap();
    // Small, so that all variants take a second.
    value["tl_states"] =
        json!({"1": {"state": ["stop"], "x": [0.0], "y": [0.0], "z": [0.0], "time_index": [3]}});
    value
}

/// The error of a file, which is read in little memory.
fn error_of(bytes: &[u8]) -> Option<String> {
    ALLOCATOR.set_limit(ALLOCATOR.allocated() + MEMORY + 5 * bytes.len()).unwrap();
    let read = Recording::from_bytes(Path::new("some.json"), bytes.to_vec());
    ALLOCATOR.set_limit(LIMIT).unwrap();
    let error = read.err()?.to_string();
    assert!(error.starts_with("`some.json`") && error.len() < 600 && !error.contains('\n'), "{error}");
    Some(error)
}

/// The scene with another value at a place such as `/objects/0/heading`.
fn with(place: &str, value: Value) -> String {
    let mut scene = scene();
    match scene.pointer_mut(place) {
        Some(slot) => *slot = value,
        None => {
            let (parent, key) = place.rsplit_once('/').unwrap();
            scene.pointer_mut(parent).unwrap()[key] = value;
        }
    }
    scene.to_string()
}

fn without(place: &str) -> String {
    let mut scene = scene();
    let (parent, key) = place.rsplit_once('/').unwrap();
    scene.pointer_mut(parent).unwrap().as_object_mut().unwrap().remove(key).unwrap();
    scene.to_string()
}

/// One test, because the limit holds for all threads.
#[test]
fn broken_files_are_named_and_take_little_memory() {
    values_that_no_scene_has_are_named();
    files_that_are_no_json_are_named();
    deep_and_long_files_take_little_memory();
}

fn values_that_no_scene_has_are_named() {
    assert_eq!(error_of(scene().to_string().as_bytes()), None);
    let id = scene()["objects"][0]["id"].clone();
    let long = vec![json!(0.0); 90];
    let cases: [(&str, String, &str); 42] = [
        ("objects", with("/objects", json!({})), "a sequence"),
        ("objects", with("/objects", json!([])), "at least one road user"),
        ("objects", without("/objects"), "missing field `objects`"),
        ("", without("/roads"), "missing field `roads`"),
        ("objects/0", with("/objects/0", json!(7)), "a road user"),
        ("objects/0", with("/objects/0", json!({})), "missing field `position`"),
        ("objects/0/position/0", with("/objects/0/position/0", json!(7)), "a point"),
        ("objects/0/position/0/x", with("/objects/0/position/0/x", json!("1")), "expected f64"),
        ("objects/0/position/0/x", with("/objects/0/position/0/x", json!(null)), "expected f64"),
        ("objects/0/position", with("/objects/0/position", json!({})), "a sequence"),
        ("objects/0/heading", with("/objects/0/heading", json!(long)), "90 entries"),
        ("objects/1/valid", with("/objects/1/valid", json!([true])), "1 entries"),
        ("objects/0", without("/objects/0/velocity"), "missing field `velocity`"),
        ("objects/0/valid/3", with("/objects/0/valid/3", json!("yes")), "true or false"),
        ("objects/0/valid/3", with("/objects/0/valid/3", json!(2)), "true or false"),
        ("objects/0/type", with("/objects/0/type", json!(1)), "a text"),
        ("objects/0/id", with("/objects/0/id", json!(1.5)), "an integer or a text"),
        ("objects/0/id", with("/objects/0/id", json!([])), "an integer or a text"),
        ("tracks", with("/objects/1/id", id), "twice"),
        ("objects/0/width", with("/objects/0/width", json!("wide")), "expected f64"),
        ("width", with("/objects/0/width", json!(-2.0)), "above 0"),
        ("length", with("/objects/0/length", json!(0.0)), "above 0"),
        ("state/length", with("/objects/0/length", json!(1e300)), "finite number within"),
        ("position", with("/objects/0/position/20/x", json!(1e300)), "within"),
        ("position", with("/objects/0/position/20/x", json!(-10000)), "frame"),
        ("roads/0/geometry", with("/roads/0/geometry", json!("line")), "a sequence"),
        ("map_features", with("/roads/0/geometry", json!([])), "at least one point"),
        ("roads/0/type", with("/roads/0/type", json!(4)), "a text"),
        ("roads/0/geometry", with("/roads/0/type", json!("stop_sign")), "one, the place of the sign"),
        ("roads/0/map_element_id", with("/roads/0/map_element_id", json!(1e30)), "an integer"),
        ("roads/0/geometry/0/y", with("/roads/0/geometry/0/y", json!({})), "expected f64"),
        ("map_features", with("/roads/0/geometry/0/y", json!(1e20)), "within"),
        ("tl_states", with("/tl_states", json!([])), "an object with a light for each lane"),
        ("tl_states/1/state/0", with("/tl_states/1/state/0", json!("red")), "a state such as `stop`"),
        ("tl_states/1/state", with("/tl_states/1/state", json!([])), "0 entries"),
        (
            "tl_states/1/time_index",
            with("/tl_states/1/time_index", json!([1_000_000_000])),
            "a frame below 91",
        ),
        ("tl_states/1/time_index/0", with("/tl_states/1/time_index", json!([-1])), "expected u64"),
        ("metadata/sdc_track_index", with("/metadata/sdc_track_index", json!(99)), "--ego-track"),
        ("metadata/sdc_track_index", with("/metadata/sdc_track_index", json!(-1)), "--ego-track"),
        ("metadata/sdc_track_index", without("/metadata/sdc_track_index"), "--ego-track"),
        ("metadata/sdc_track_index", with("/objects/0/type", json!("pedestrian")), "type `pedestrian`"),
        ("metadata/sdc_track_index", with("/objects/0/valid/10", json!(false)), "absent at frame 10"),
    ];
    let mut wrong = Vec::new();
    for (field, text, expected) in cases {
        let error = error_of(text.as_bytes()).unwrap_or_else(|| "it is read".to_owned());
        if !(error.contains(field) && error.contains(expected)) {
            wrong.push(format!("{field}, {expected}: {error}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn files_that_are_no_json_are_named() {
    let text = scene().to_string();
    for share in 1..16 {
        let cut = &text.as_bytes()[..text.len() * share / 16];
        let error = error_of(cut).expect("a truncated file is no scene");
        assert!(error.contains("EOF"), "{error}");
    }
    let place = text.find("\"position\":[").unwrap();
    let number = place + text[place..].find("\"x\":").unwrap() + 4;
    let end = number + text[number..].find(',').unwrap();
    for (word, expected) in [
        ("NaN", "NaN and Infinity are no JSON"),
        ("Infinity", "NaN and Infinity are no JSON"),
        ("-Infinity", "NaN and Infinity are no JSON"),
        ("1e999", "number out of range"),
        ("0x10", "expected"),
        ("'1'", "expected"),
        ("1.0.0", "expected"),
    ] {
        let bad = format!("{}{word}{}", &text[..number], &text[end..]);
        let error = error_of(bad.as_bytes()).expect("no number is read");
        assert!(
            error.contains("objects/0/position/0/x") || error.contains("objects/0/position/0"),
            "{error}"
        );
        assert!(error.contains(expected), "{word}: {error}");
    }
    let twice = text.replacen("\"objects\":", "\"roads\":[],\"objects\":", 1);
    assert!(error_of(twice.as_bytes()).unwrap().contains("the key occurs twice"));
    let error = error_of(format!("{text}{text}").as_bytes()).unwrap();
    assert!(error.contains("trailing characters"), "{error}");
    let mut broken = text.clone().into_bytes();
    let at = text.find("four").map_or(20, |at| at);
    broken[at] = 0xff;
    assert!(error_of(&broken).is_some());
    let bom = [b"\xef\xbb\xbf", text.as_bytes()].concat();
    assert_eq!(error_of(&bom), None);
}

fn deep_and_long_files_take_little_memory() {
    let deep = |key: &str| format!("{{\"objects\":[],\"position\":1,\"{key}\":{}", "[".repeat(2_000_000));
    for key in ["other", "roads", "metadata", "tl_states"] {
        assert!(error_of(deep(key).as_bytes()).is_some(), "{key}");
    }
    let many = |one: &str| vec![one; 500_000].join(",");
    let start = "{\"position\":1,\"objects\":";
    for text in [
        format!("{start}[{}],\"roads\":[]}}", many("{}")),
        format!(
            "{start}[{}]}}",
            many("{\"position\":[],\"velocity\":[],\"heading\":[],\"valid\":[],\"type\":\"\"}")
        ),
        format!("{start}[],\"roads\":[{}]}}", many("{\"geometry\":[],\"type\":\"\"}")),
        format!("{start}[],\"roads\":[],\"metadata\":{{\"objects_of_interest\":[{}]}}}}", many("0")),
        format!(
            "{start}[],\"roads\":[],\"metadata\":{{\"tracks_to_predict\":[{}]}}}}",
            many("{\"track_index\":0}")
        ),
        format!(
            "{start}[],\"roads\":[],\"tl_states\":{{{}}}}}",
            many("\"1\":{\"state\":[],\"time_index\":[]}")
        ),
    ] {
        assert!(error_of(text.as_bytes()).is_some());
    }
    let twice = with("/tl_states", json!({})).replacen(
        "\"tl_states\":{}",
        r#""tl_states":{"1":{"state":[],"time_index":[]},"1":{"state":[],"time_index":[]}}"#,
        1,
    );
    assert!(error_of(twice.as_bytes()).unwrap().contains("there twice"));
    // Every light has a state for each frame.
    let lights: Vec<String> =
        (0..60_000).map(|k| format!("\"{k}\":{{\"state\":[],\"time_index\":[]}}")).collect();
    let mut value = scene();
    value.as_object_mut().unwrap().remove("tl_states");
    let text = value.to_string();
    let text = format!("{},\"tl_states\":{{{}}}}}", &text[..text.len() - 1], lights.join(","));
    assert!(error_of(text.as_bytes()).unwrap().contains("60000 lights"));
}
