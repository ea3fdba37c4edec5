//! Names and words that files give: none writes markup, starts with `-` like a flag, or costs another scene.

use std::path::Path;

use sage_data::{Recording, folder};

use crate::{change_header, experts, program::*, quick, recipe};

/// The shipped scene with another id.
fn with_id(file: &Path, id: &str) {
    let mut recording = Recording::read(example().as_ref()).unwrap();
    recording.scene.id = id.to_owned();
    std::fs::write(file, recording.to_native().unwrap()).unwrap();
}

#[test]
fn words_in_weights_write_no_markup() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let words =
        "\u{1b}[2J MIT |\n\n# Install\n\n<script>alert(1)</script>![](http://tracker.example/x)\u{202e}`";
    for name in ["adversarial", "realistic", "prior"] {
        change_header(&experts.join(format!("{name}.safetensors")), |fields| {
            for key in ["license", "data", "command"] {
                fields.insert(key.to_owned(), words.into());
            }
        });
    }
    let file = folder.path().join("r.yaml");
    std::fs::write(&file, recipe::linear(text(&experts))).unwrap();
    let out = folder.path().join("out");
    let (code, said) = quick(&["merge", text(&file), "--out", text(&out)]);
    assert_eq!(code, 0, "{said}");
    assert!(
        !said.contains(['\u{1b}', '\u{202e}']) && !said.lines().any(|line| line.starts_with("# ")),
        "{said}"
    );
    let page = std::fs::read_to_string(out.join("README.md")).unwrap();
    assert!(!page.contains(['\u{1b}', '\u{202e}', '<']) && !page.contains("!["), "{page}");
    assert!(!page.lines().any(|line| line.starts_with("# Install")), "{page}");
    assert!(page.contains("MIT \\|"), "the words themselves are shown: {page}");
}

#[test]
fn odd_names_of_files_are_named_apart() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for part in ["a", "b"] {
        std::fs::create_dir_all(at("in").join(part)).unwrap();
        std::fs::copy(example(), at("in").join(part).join("same.pkl")).unwrap();
    }
    for name in ["-flag.pkl", "index.pkl", "plain.pkl"] {
        std::fs::copy(example(), at("in").join(name)).unwrap();
    }
    #[cfg(unix)]
    std::fs::copy(example(), at("in").join("back\\slash.pkl")).unwrap();
    let count = if cfg!(unix) { 6 } else { 5 };
    for command in [vec!["generate", "--weights", "procedural"], vec!["simulate", "--ego", "idm"]] {
        let out = at(command[0]);
        let (code, said) =
            quick(&[&[command[0], text(&at("in"))], &command[1..], &["--out", text(&out)]].concat());
        assert_eq!(code, 0, "{said}");
        let names: Vec<String> = std::fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| name.ends_with(".json") && name != "run.json")
            .collect();
        assert_eq!(names.len(), count, "{names:?}");
        assert!(names.iter().all(|name| !name.starts_with('-') && !name.contains('\\')), "{names:?}");
        assert!(names.iter().any(|name| name.starts_with("plain-")), "{names:?}");
    }
    let out = at("converted");
    let (code, said) = quick(&["convert", text(&at("in")), "--to", "native", "--out", text(&out)]);
    assert_eq!((code, folder::scene_files(&out).unwrap().len()), (0, count), "{said}");
}

#[test]
fn scenes_without_id_and_with_one_id_are_converted_to_shards_that_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("in")).unwrap();
    let ids = ["", "s1", "", "index", "s1", "-x", "..", "a\nb", "\u{202e}", &"x".repeat(3000)];
    for (number, id) in ids.iter().enumerate() {
        with_id(&at("in").join(format!("{number}.safetensors")), id);
    }
    let shards = at("shards");
    let (code, said) = quick(&["convert", text(&at("in")), "--to", "womd", "--out", text(&shards)]);
    assert_eq!(code, 0, "{said}");
    let (code, said) = quick(&["inspect", text(&shards)]);
    assert_eq!(code, 0, "{said}");
    for (to, ending) in [("native", "safetensors"), ("pickle", "pkl")] {
        let out = at(to);
        let (code, said) = quick(&["convert", text(&shards), "--to", to, "--out", text(&out)]);
        assert_eq!(code, 0, "{said}");
        let files = folder::scene_files(&out).unwrap();
        assert_eq!(files.len(), ids.len(), "{files:?}");
        let is_plain = |file: &Path| {
            let name = file.file_name().unwrap().to_str().unwrap();
            name.ends_with(ending) && !name.starts_with(['-', '.']) && name.is_ascii() && name.len() < 255
        };
        assert!(files.iter().all(|file| is_plain(file)), "{files:?}");
    }
    let out = at("attacked");
    let (code, said) = quick(&["generate", text(&shards), "--weights", "procedural", "--out", text(&out)]);
    assert_eq!(code, 0, "{said}");
    insta::assert_snapshot!(redacted(&said), @r"
    note: weights `procedural` (network densetnt)
    note: outputs of 8 scenes have names with a hash of the path, because their own are not unique or cannot be those of outputs
    10 scenes, 10 attempts in `[folder]/attacked` ([time])
    to look at the attacks, open `[folder]/attacked/index.html`
    ");
}
