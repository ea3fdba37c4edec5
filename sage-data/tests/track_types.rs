//! Types of tracks: which are road users, what `inspect` notes, and that files keep their own word.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::path::{Path, PathBuf};

use sage_core::scene::TrackKind;
use sage_data::{Recording, checks, pickle::Document};

#[test]
fn names_of_types_have_their_kind() {
    let other = |name: &str| TrackKind::Other(name.to_owned());
    for (name, kind) in [
        ("VEHICLE", TrackKind::Vehicle),
        ("CAR", TrackKind::Vehicle),
        ("VAN", TrackKind::Vehicle),
        ("BUS", TrackKind::Vehicle),
        ("SCHOOL_BUS", TrackKind::Vehicle),
        ("TRUCK", TrackKind::Vehicle),
        ("TRAILER", TrackKind::Vehicle),
        ("MOTORCYCLE", TrackKind::Vehicle),
        ("MOTORCYCLIST", TrackKind::Vehicle),
        ("PEDESTRIAN", TrackKind::Pedestrian),
        ("CYCLIST", TrackKind::Cyclist),
        ("BICYCLE", TrackKind::Cyclist),
        ("RIDERLESS_BICYCLE", other("RIDERLESS_BICYCLE")),
        ("UNSET", other("UNSET")),
        ("UNKNOWN", other("UNKNOWN")),
        ("OTHER", other("OTHER")),
        ("TRAFFIC_CONE", other("TRAFFIC_CONE")),
        ("TRAFFIC_BARRIER", other("TRAFFIC_BARRIER")),
        ("STATIC", other("STATIC")),
        ("BACKGROUND", other("BACKGROUND")),
        ("CONSTRUCTION", other("CONSTRUCTION")),
        ("", other("")),
    ] {
        assert_eq!(TrackKind::from_name(name), kind, "{name}");
        assert_eq!(kind.is_unknown(), matches!(name, "UNSET" | "UNKNOWN" | ""), "{name}");
    }
}

fn small() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/small_p2_core.pkl")
}

/// A small scene with another type for its cone, or with none. Protocol 2 has no frames, so that lengths elsewhere stay.
fn with_type(word: Option<&str>) -> Vec<u8> {
    let bytes = std::fs::read(small()).unwrap();
    let text = |word: &str| [b"X", &(word.len() as u32).to_le_bytes()[..], word.as_bytes()].concat();
    let (old, new) = (text("TRAFFIC_CONE"), word.map_or(b"N".to_vec(), text));
    let at = bytes.windows(old.len()).position(|window| window == old).unwrap();
    [&bytes[..at], &new, &bytes[at + old.len()..]].concat()
}

fn type_in(bytes: Vec<u8>, id: &str) -> Option<String> {
    let document = Document::parse(bytes).unwrap();
    let tracks = document.get(document.root(), "tracks").unwrap();
    let track = document.get(tracks, id).unwrap();
    document.get(track, "type").and_then(|kind| document.text(kind)).map(str::to_owned)
}

#[test]
fn files_keep_their_own_word() {
    let words =
        ["BUS", "MOTORCYCLIST", "TRUCK", "BICYCLE", "UNSET", "UNKNOWN", "RIDERLESS_BICYCLE", "WHATEVER"];
    let scene = Recording::read(&small()).unwrap().scene;
    let track = scene.tracks.iter().position(|track| track.kind.name() == "TRAFFIC_CONE").unwrap();
    let id = scene.tracks[track].id.clone();
    for word in words.map(Some).into_iter().chain([None]) {
        let bytes = with_type(word);
        let recording = Recording::from_bytes(Path::new("a.pkl"), bytes).unwrap();
        let kind = TrackKind::from_name(word.unwrap_or("UNSET"));
        assert_eq!(recording.scene.tracks[track].kind, kind);
        let noted = checks::warnings(&recording.scene).into_iter().find(|w| w.kind == "unknown-type");
        assert_eq!(noted.is_some(), kind.is_unknown(), "{word:?}");
        if let Some(noted) = noted {
            assert!(noted.detail.starts_with("1 track has no known type"), "{}", noted.detail);
        }
        // Through a pickle and through a native file.
        assert_eq!(type_in(recording.to_pickle().unwrap(), &id).as_deref(), word);
        let native =
            Recording::from_bytes(Path::new("a.safetensors"), recording.to_native().unwrap()).unwrap();
        assert_eq!(native.scene, recording.scene);
        assert_eq!(type_in(native.to_pickle().unwrap(), &id).as_deref(), word);
    }
}

#[test]
fn reference_types_are_read() {
    let Some(folder) = std::env::var_os("SAGE_REFERENCE") else {
        return eprintln!("left out: SAGE_REFERENCE is not set");
    };
    let read = |name: &str| Recording::read(&Path::new(&folder).join("cases").join(name)).unwrap().scene;
    let base = read("base.pkl");
    for (name, is_vehicle, unknown) in [
        ("type_bus.pkl", true, false),
        ("type_motorcyclist.pkl", true, false),
        ("type_unset.pkl", false, true),
        ("type_none.pkl", false, true),
    ] {
        let scene = read(name);
        assert_eq!(scene.tracks.len(), base.tracks.len());
        let all_vehicles = scene.tracks.iter().all(|track| track.kind == TrackKind::Vehicle);
        assert_eq!(all_vehicles, is_vehicle, "{name}");
        assert_eq!(scene.tracks.iter().any(|track| track.kind.is_unknown()), unknown, "{name}");
        assert_eq!(checks::warnings(&scene).iter().any(|w| w.kind == "unknown-type"), unknown, "{name}");
        if let Some(adversary) = scene.adversary {
            assert_eq!(scene.tracks[adversary].kind, TrackKind::Vehicle, "{name}");
        }
    }
}
