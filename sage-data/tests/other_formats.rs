//! Files that are no scenes: the error says what they are, and what to do.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::path::{Path, PathBuf};

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
    for (bytes, named, remedy) in [
        (&b""[..], "an empty file", "copy or create it again"),
        (&[0; 5000], "a file of zeros", "copy it again"),
        (b"PAR1\x15\x04\x15", "a Parquet file, as Argoverse 2 has them", "ScenarioNet"),
        (b"ARROW1\0\0", "an Arrow file", "ScenarioNet"),
        (b"SQLite format 3\0\x10\0", "an SQLite database, as nuPlan has them", "ScenarioNet"),
        (b"\x89HDF\r\n\x1a\n\0", "an HDF5 file", "ScenarioNet"),
        (b"\x93NUMPY\x01\0", "a NumPy array (.npy)", "ScenarioNet"),
        (&npz, "a NumPy archive (.npz)", "ScenarioNet"),
        (b"PK\x03\x04\x14\0\0\0", "a zip archive", "unpack it"),
        (b"PK\x05\x06\0\0", "an empty zip archive", "copy it again"),
        (&tar, "a tar archive", "unpack it"),
        (b"7z\xbc\xaf\x27\x1c\0", "a 7z archive", "unpack it"),
        (b"BZh91AY&SY", "compressed by bzip2", "decompress it first"),
        (b"\xfd7zXZ\0\0", "compressed by xz", "decompress it first"),
        (b"\x28\xb5\x2f\xfd\x24\x08", "compressed by zstd", "decompress it first"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
            "a pointer of Git LFS",
            "git lfs pull",
        ),
        (b"%PDF-1.7\n%\xe2\xe3", "a PDF document", "give a scene file"),
        (b"\x89PNG\r\n\x1a\n\0\0", "a picture (PNG)", "give a scene file"),
        (b"<!DOCTYPE html>\n<html><body>404</body></html>", "a web page (HTML)", "download the file itself"),
        (b"<html>", "a web page (HTML)", "download the file itself"),
        (b"<?xml version=\"1.0\"?>\n<OpenSCENARIO>", "an OpenSCENARIO scenario", "give a scene file"),
        (b"<?xml version=\"1.0\"?>\n<OpenDRIVE>", "an OpenDRIVE map", "give a scene file"),
        (b"<commonRoad commonRoadVersion=\"2020a\">", "a CommonRoad scenario", "give a scene file"),
        (b"<svg/>", "an XML file", "give a scene file"),
        (
            b"{\"name\": \"a\", \"scenario_id\": \"b\", \"objects\": [{\"position\": [{\"x\": 1}]}]}",
            "a scene of GPUDrive (JSON)",
            "Waymo shard",
        ),
        (
            b"{\"objects\":[{\"position\":[{\"x\":1}]}],\"roads\":[],\"name\":\"a\"}",
            "a scene of GPUDrive (JSON)",
            "Waymo shard",
        ),
        (b"{\"drivable_areas\": {}, \"lane_segments\": {}}", "a map of Argoverse 2 (JSON)", "ScenarioNet"),
        (b"{\"run_hash\": \"a\", \"scene\": \"b\"}", "a row of `sage generate` (JSON)", "scene files"),
        (b"{\"command\": \"generate\", \"run\": {}, \"results\": {}}", "a record of a run", "folder"),
        (b"[{\"name\": \"a\", \"trajectory\": [[1, 2]]}]", "a file of candidates (JSON)", "--candidates"),
        (b"\xef\xbb\xbf {\"a\": 1}", "a JSON file", "give a scene file"),
        (b"[1, 2, 3]", "a JSON file", "give a scene file"),
        (b"track_id,timestep,x,y\n1,2,3,4\n", "a text file", "give a scene file"),
        (b"city,x\n1,2\n", "a text file", "give a scene file"),
        (b"(c) 2024, all rights reserved\nby us\n", "a text file", "give a scene file"),
        ("Straße nach München\n".as_bytes(), "a text file", "give a scene file"),
        (&cut, "a text file", "give a scene file"),
    ] {
        let error = error_of(bytes);
        let shown = bytes[..bytes.len().min(30)].escape_ascii();
        assert!(error.starts_with("`folder/given.file` is "), "{shown}: {error}");
        assert!(error.contains(named) && error.contains(remedy), "{shown}: {error}");
        assert!(!error.contains('\n'));
    }
}

#[test]
fn damaged_scenes_keep_their_error() {
    for (bytes, expected) in [
        (&b"(dp0\nVlength\np1\nI9"[..], "ends inside a value"),
        (b"\x80\x04}\x94(", "ends inside a value"),
        (b"cos\nsystem\n(S'ls'\ntR.", "global `os.system` is not allowed"),
        (b"\xfe\xfe\xfe\xfe", "not a pickle: the first byte is 0xfe"),
        (b"\x1f\x8b\x08\0\0", "gzip"),
        (b"(dp0\nVlength\np1\nI91\ns.", "`metadata` is missing"),
    ] {
        let error = Recording::from_bytes(Path::new("x.pkl"), bytes.to_vec()).unwrap_err();
        assert!(!matches!(error, Error::OtherFormat { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(expected) && text.contains("x.pkl"), "{text}");
    }
}

/// A dict of str keys in protocol 0; values are opcodes.
fn dict(entries: &[(&str, &str)]) -> String {
    let body: String = entries.iter().map(|(key, value)| format!("V{key}\n{value}s")).collect();
    format!("(d{body}")
}

#[test]
fn tables_of_data_sets_given_as_scenes_are_named() {
    let summary = dict(&[("object_summary", "(d"), ("number_summary", "(d")]);
    let short = dict(&[("sdc_id", "V1\n"), ("track_length", "I91\n")]);
    let scene = dict(&[("tracks", "(d"), ("length", "I91\n")]);
    for (values, named, remedy) in [
        (
            dict(&[("sd_a_1.pkl", "V\n"), ("sd_a_2.pkl", "Vpart\n")]),
            "the mapping of a data set",
            "give the folder",
        ),
        (dict(&[("sd_a_1.pkl", &summary)]), "the summary of a data set", "give the folder"),
        (
            dict(&[("sd_a_1.pkl", &short), ("sd_a_2.pkl", &short)]),
            "the summary of a data set",
            "give the folder",
        ),
        (dict(&[("a", &short)]), "the summary of a data set", "give the folder"),
        (format!("(l{scene}a"), "a list of scenes", "a pickle of its own"),
        (dict(&[("a", &scene)]), "a dict of scenes", "a pickle of its own"),
        (dict(&[("track_infos", "(d"), ("map_infos", "(d")]), "a preprocessed scene of MTR", "Waymo shard"),
    ] {
        let bytes = format!("{values}.").into_bytes();
        Document::parse(bytes.clone()).unwrap();
        let error = error_of(&bytes);
        assert!(error.contains(named) && error.contains(remedy), "{error}");
    }
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
    assert!(error.contains("an SQLite database, as nuPlan has them"), "{error}");
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
        ("gpudrive/tfrecord-00000-of-01000_4.json".to_owned(), "a scene of GPUDrive (JSON)"),
        (format!("{log}/scenario_0a1e6f0a-1817-4a98-b02e-db8c9327d151.parquet"), "a Parquet file"),
        (format!("{log}/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json"), "a map of Argoverse 2"),
        ("standards/scene-1.2.xosc".to_owned(), "an OpenSCENARIO scenario"),
        ("standards/scene.xodr".to_owned(), "an OpenDRIVE map"),
    ] {
        let Some(path) = reference(&file) else { return };
        let error = Recording::read(&path).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}
