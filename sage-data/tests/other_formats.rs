//! Files that are no scenes: the error says what they are, and what to do.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::path::{Path, PathBuf};

use insta::assert_snapshot;
use sage_data::{Error, Recording, folder, pickle::Document};

fn error_of(bytes: &[u8]) -> String {
    let path = Path::new("folder/given.file");
    let error = Recording::from_bytes(path, bytes.to_vec()).unwrap_err();
    assert!(matches!(error, Error::OtherFormat { .. }), "{error}");
    error.to_string()
}

#[test]
fn every_known_format_is_named_with_a_remedy() {
    let tar = [&[b'a'; 257][..], b"ustar\0", &[0; 200]].concat();
    let npz = [b"PK\x03\x04", &[0; 26][..], b"tracks.npy", &[7; 40]].concat();
    let cut = "é".repeat(40_000).into_bytes();
    let files: [&[u8]; 34] = [
        b"",
        &[0; 5000],
        b"ARROW1\0\0",
        b"SQLite format 3\0\x10\0",
        b"\x89HDF\r\n\x1a\n\0",
        b"\x93NUMPY\x01\0",
        &npz,
        b"PK\x03\x04\x14\0\0\0",
        b"PK\x05\x06\0\0",
        &tar,
        b"7z\xbc\xaf\x27\x1c\0",
        b"BZh91AY&SY",
        b"\xfd7zXZ\0\0",
        b"\x28\xb5\x2f\xfd\x24\x08",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
        b"%PDF-1.7\n%\xe2\xe3",
        b"\x89PNG\r\n\x1a\n\0\0",
        b"<!DOCTYPE html>\n<html><body>404</body></html>",
        b"<html>",
        b"<?xml version=\"1.0\"?>\n<OpenSCENARIO>",
        b"<?xml version=\"1.0\"?>\n<OpenDRIVE>",
        b"<commonRoad commonRoadVersion=\"2020a\">",
        b"<svg/>",
        b"{\"drivable_areas\": {}, \"lane_segments\": {}}",
        b"{\"run_hash\": \"a\", \"scene\": \"b\"}",
        b"{\"command\": \"generate\", \"run\": {}, \"results\": {}}",
        b"[{\"name\": \"a\", \"trajectory\": [[1, 2]]}]",
        b"\xef\xbb\xbf {\"a\": 1}",
        b"[1, 2, 3]",
        b"track_id,timestep,x,y\n1,2,3,4\n",
        b"city,x\n1,2\n",
        b"(c) 2024, all rights reserved\nby us\n",
        "Straße nach München\n".as_bytes(),
        &cut,
    ];
    let said = files.map(|bytes| {
        let error = error_of(bytes);
        let shown = bytes[..bytes.len().min(30)].escape_ascii();
        assert!(error.starts_with("`folder/given.file` is ") && !error.contains('\n'), "{shown}: {error}");
        format!("\"{shown}\" -> {error}")
    });
    assert_snapshot!("files_of_other_formats", said.join("\n"));
}

#[test]
fn damaged_scenes_keep_their_error() {
    let files: [&[u8]; 6] = [
        b"(dp0\nVlength\np1\nI9",
        b"\x80\x04}\x94(",
        b"cos\nsystem\n(S'ls'\ntR.",
        b"\xfe\xfe\xfe\xfe",
        b"\x1f\x8b\x08\0\0",
        b"(dp0\nVlength\np1\nI91\ns.",
    ];
    let said = files.map(|bytes| {
        let error = Recording::from_bytes(Path::new("x.pkl"), bytes.to_vec()).unwrap_err();
        assert!(!matches!(error, Error::OtherFormat { .. }), "{error}");
        format!("\"{}\" -> {error}", bytes.escape_ascii())
    });
    assert_snapshot!("damaged_scenes", said.join("\n"));
}

/// A dict of str keys; values are opcodes.
fn dict(entries: &[(&str, &str)]) -> String {
    let body: String = entries.iter().map(|(key, value)| format!("{}{value}s", text(key))).collect();
    format!("}}{body}")
}

fn text(word: &str) -> String {
    format!("X{}\0\0\0{word}", char::from(word.len() as u8))
}

#[test]
fn tables_of_data_sets_given_as_scenes_are_named() {
    let summary = dict(&[("object_summary", "}"), ("number_summary", "}")]);
    let short = dict(&[("sdc_id", &text("1")), ("track_length", "K[")]);
    let scene = dict(&[("tracks", "}"), ("length", "K[")]);
    let tables = [
        ("a mapping", dict(&[("sd_a_1.pkl", &text("")), ("sd_a_2.pkl", &text("part"))])),
        ("a summary of one scene", dict(&[("sd_a_1.pkl", &summary)])),
        ("a summary of two scenes", dict(&[("sd_a_1.pkl", &short), ("sd_a_2.pkl", &short)])),
        ("a summary of a short name", dict(&[("a", &short)])),
        ("a list of scenes", format!("]{scene}a")),
        ("a dict of scenes", dict(&[("a", &scene)])),
        ("a scene of MTR", dict(&[("track_infos", "}"), ("map_infos", "}")])),
    ];
    let said = tables.map(|(name, values)| {
        let bytes = [b"\x80\x02", values.as_bytes(), b"."].concat();
        Document::parse(bytes.clone()).unwrap();
        format!("{name} -> {}", error_of(&bytes))
    });
    assert_snapshot!("tables_of_data_sets", said.join("\n"));
}

#[test]
fn a_folder_is_read_as_before() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"), at("a.pkl"))
        .unwrap();
    for name in ["notes.json", "scenario.parquet", "dataset_mapping.pkl", "log.db"] {
        std::fs::write(at(name), "{}").unwrap();
    }
    assert_eq!(folder::scene_files(folder.path()).unwrap(), [at("a.pkl")]);
}

#[test]
fn a_file_that_is_too_large_is_named_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("2021.db");
    let file = std::fs::File::create(&path).unwrap();
    std::io::Write::write_all(&mut &file, b"SQLite format 3\0").unwrap();
    // Sparse, so it takes no space.
    file.set_len(sage_data::MAX_SCENE_FILE + 1).unwrap();
    let error = Recording::read(&path).unwrap_err().to_string();
    assert_snapshot!(error.replace(&folder.path().display().to_string(), "[folder]"), @"`[folder]/2021.db` is an SQLite database, as nuPlan has them; convert it with ScenarioNet, and give the .pkl files that it writes");
}

fn reference(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SAGE_REFERENCE");
    if folder.is_none() {
        eprintln!("left out: SAGE_REFERENCE is not set");
    }
    folder.map(|folder| Path::new(&folder).join("fixtures/formats").join(name))
}

#[test]
fn published_samples_are_named() {
    let log = "argoverse2/0a1e6f0a-1817-4a98-b02e-db8c9327d151";
    for (file, named) in [
        (format!("{log}/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json"), "a map of Argoverse 2"),
        ("standards/scene-1.2.xosc".to_owned(), "an OpenSCENARIO scenario"),
        ("standards/scene.xodr".to_owned(), "an OpenDRIVE map"),
    ] {
        let Some(path) = reference(&file) else { return };
        let error = Recording::read(&path).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}
