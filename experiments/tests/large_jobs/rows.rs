//! Rows without scene files, and the scenes that are made from them.

use std::fs;

use insta::assert_snapshot;

use super::*;

/// Attacks some scenes into a folder.
fn generate(root: &Path, out: &str, more: &[&str]) {
    let command =
        ["generate", "scenes", "--lambda", "0,1", "--no-pages", "--quiet", "--weights", "procedural"];
    let output = sage_in(root, &[&command[..], more, &["--out", out]].concat());
    assert_eq!(output.status.code(), Some(BAD_SCENES), "{}", stderr(&output));
}

/// Scene files of a folder, in which the command of the run is masked: its --format differs.
fn scene_files(out: &Path, formats: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let mut all = files(out);
    let endings = [".pkl", ".safetensors", ".xosc", ".xodr"];
    all.retain(|name, _| endings.iter().any(|ending| name.ends_with(ending)));
    for (name, bytes) in &mut all {
        if name.ends_with(".pkl") || name.ends_with(".safetensors") {
            let file = out.join(name);
            if name.starts_with("dataset_") {
                *bytes = Vec::new();
                continue;
            }
            let recording = sage_data::Recording::from_bytes(&file, bytes.clone()).unwrap();
            let mut text = format!("{:?}{:?}", recording.scene, recording.provenance().unwrap());
            for format in formats {
                text = text.replace(&format!("--format {format}"), "--format FORMAT");
            }
            *bytes = text.into_bytes();
        }
    }
    all
}

#[test]
fn rows_and_their_scenes_become_the_files_of_any_format() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 5);
    generate(root, "rows", &["--format", "rows"]);
    generate(root, "least", &["--format", "rows", "--no-candidates"]);
    for (generated, format) in [("pickle", "pickle"), ("native", "native"), ("openscenario", "openscenario")]
    {
        let direct = format!("direct-{format}");
        generate(root, &direct, &["--format", generated]);
        let expected = scene_files(&root.join(&direct), &[format]);
        assert!(expected.len() >= 10, "{:?}", expected.keys());
        for rows in ["rows", "least"] {
            let out = format!("{rows}-{format}");
            let convert = ["convert", rows, "--of", "scenes", "--to", format, "--out", &out];
            stdout(&sage_in(root, &convert));
            let mut found = scene_files(&root.join(&out), &["rows --no-candidates", "rows"]);
            found.values_mut().for_each(|bytes| {
                let text = String::from_utf8_lossy(bytes).replace(" --no-candidates", "");
                *bytes = text.into_bytes();
            });
            assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
            let other = found.iter().find(|(name, bytes)| expected[*name] != **bytes);
            if let Some((name, bytes)) = other {
                let same = bytes.iter().zip(&expected[name]).take_while(|(a, b)| a == b).count();
                let rest = |bytes: &[u8]| {
                    String::from_utf8_lossy(&bytes[same.saturating_sub(80)..])
                        .chars()
                        .take(200)
                        .collect::<String>()
                };
                panic!("{rows} to {format}: `{name}` differs: {} and {}", rest(bytes), rest(&expected[name]));
            }
            // The same in shards.
            let parts = format!("{out}-parts");
            for shard in ["2/2", "1/2"] {
                let convert = ["convert", rows, "--of", "scenes", "--to", format, "--out", &parts];
                stdout(&sage_in(root, &[&convert[..], &["--shard", shard]].concat()));
            }
            stdout(&sage_in(root, &["join", &parts]));
            assert_same(&root.join(&parts), &root.join(&out));
        }
    }
    // One row alone.
    let row = "rows/curve-1-1-lambda1.00.json";
    stdout(&sage_in(root, &["convert", row, "--of", "scenes", "--to", "native", "--out", "one"]));
    assert!(root.join("one/curve-1-1-lambda1.00.safetensors").is_file());
}

#[test]
fn rows_without_candidates_are_small_and_hold_the_attack() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 3);
    generate(root, "rows", &["--format", "rows"]);
    generate(root, "least", &["--format", "rows", "--no-candidates"]);
    let name = "curve-1-1-lambda1.00.json";
    let [full, least] = ["rows", "least"].map(|folder| root.join(folder).join(name));
    let size = |path: &Path| fs::metadata(path).unwrap().len();
    assert!(size(&least) < size(&full) / 10, "{} of {}", size(&least), size(&full));
    let [mut full, mut short] = [&full, &least].map(|path| json(path));
    assert_eq!(short["candidates"], serde_json::json!([]));
    for row in [&mut full, &mut short] {
        let row = row.as_object_mut().unwrap();
        row.remove("candidates");
        row.remove("run_hash");
    }
    assert_eq!(full, short);
    let scored = sage_in(root, &["score", "scenes/curve-1-1.pkl", "--candidates", text(&least), "--json"]);
    assert_eq!(rows(&scored).len(), 1);
    assert_snapshot!(
        redacted(stderr(&sage_in(root, &["explain", text(&least), "--of", "scenes/curve-1-1.pkl"]))),
        @"error: `[folder]/least/curve-1-1-lambda1.00.json` was written with --no-candidates; explain its scene instead: `sage explain SCENE` with the options of the run"
    );
}

#[test]
fn rows_that_cannot_be_converted_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 2);
    generate(root, "rows", &["--format", "rows"]);
    generate(root, "driven", &["--format", "rows", "--ego", "idm"]);
    stdout(&sage(&["scenes", "--count", "2", "--seed", "2", "--out", text(&root.join("others"))]));
    fs::create_dir(root.join("changed")).unwrap();
    for name in ["curve-1-1.pkl", "straight-1-0.pkl"] {
        fs::copy(example(), root.join("changed").join(name)).unwrap();
    }
    fs::create_dir(root.join("empty")).unwrap();
    let cases: [&[&str]; 7] = [
        &["rows", "--to", "native"],
        &["rows", "--of", "scenes", "--to", "womd"],
        &["rows", "--of", "others", "--to", "native"],
        &["rows", "--of", "changed", "--to", "native"],
        &["driven", "--of", "scenes", "--to", "native"],
        &["scenes", "--of", "scenes", "--to", "native"],
        &["empty", "--of", "scenes", "--to", "native"],
    ];
    let said = cases.into_iter().enumerate().map(|(number, case)| {
        let out = format!("out{number}");
        let output = sage_in(root, &[&["convert"], case, &["--out", &out]].concat());
        let code = output.status.code().unwrap();
        (format!("{}, exit status {code}", case.join(" ")), sorted(stderr(&output)))
    });
    assert_snapshot!("rows_that_cannot_be_converted", messages(said));
}
