//! Scene files and data sets.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use insta::assert_snapshot;
use sage_data::Recording;

use crate::{has_failed, hostile, program::*, quick};

fn has_python() -> bool {
    Command::new("python3").args(["-I", "-c", ""]).output().is_ok_and(|run| run.status.success())
}

/// Loads a pickle as a careless program does, with a stand-in for numpy.
const LOAD: &str = "
import pickle, sys, types
class Anything:
    def __init__(self, *arguments): pass
    def __setstate__(self, state): pass
for name in ('numpy', 'numpy.core', 'numpy.core.multiarray'):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__getattr__ = lambda name: Anything
pickle.load(open(sys.argv[1], 'rb'))
";

#[test]
fn no_command_runs_what_is_in_a_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = PathBuf::from(example());
    let marker = at("marker");
    std::fs::create_dir(at("scenes")).unwrap();
    let files = [
        (at("scenes/memo.pkl"), hostile::memo(&scene, &marker)),
        (at("scenes/polyglot.pkl"), hostile::polyglot(&scene, &marker)),
    ];
    for (path, bytes) in &files {
        std::fs::write(path, bytes).unwrap();
        // They are what they claim to be: Python runs them.
        if has_python() {
            Command::new("python3").args(["-I", "-c", LOAD, text(path)]).output().unwrap();
            assert!(marker.exists(), "{} does nothing to Python", path.display());
            std::fs::remove_file(&marker).unwrap();
        }
    }
    let candidates = scene.with_extension("json").display().to_string();
    let mut refused = Vec::new();
    for (number, (path, _)) in files.iter().enumerate() {
        let file = text(path);
        let out = |name: &str| at(&format!("{name}-{number}")).display().to_string();
        let commands: Vec<Vec<String>> = [
            vec!["inspect", file],
            vec!["score", file, "--candidates", &candidates],
            vec!["draw", file, "--out", &out("picture.svg")],
            vec!["convert", file, "--to", "native", "--out", &out("native")],
            vec!["convert", file, "--to", "pickle", "--out", &out("pickle")],
            vec!["generate", file, "--weights", "procedural", "--out", &out("attacked")],
            vec!["predict", file, "--weights", "procedural"],
            vec!["pretrain", file, "--epochs", "1", "--out", &out("prior")],
            vec!["finetune", file, "--out", &out("experts")],
            vec!["calibrate", file, "--out", &out("dial.json")],
            vec!["bench", "prediction", file, "--out", &out("errors")],
            vec!["bench", "open-loop", file, "--methods", "log", "--out", &out("table")],
            vec!["bench", "dial", file, "--out", &out("dial")],
        ]
        .map(|command| command.into_iter().map(str::to_owned).collect())
        .into();
        for command in commands {
            let arguments: Vec<&str> = command.iter().map(String::as_str).collect();
            let (code, said) = quick(&arguments);
            assert!(has_failed(code), "{command:?}: {said}");
            // The place depends on the length of the marker's path.
            let said = masked(&said, "at byte ", |c| c.is_ascii_digit(), "at byte [place]");
            refused.push((command.join(" "), said));
            assert!(!marker.exists(), "{command:?} ran the file");
        }
    }
    assert_snapshot!("programs_in_scene_files", messages(refused));
}

#[test]
fn convert_writes_inside_its_folder_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = PathBuf::from(example());
    let convert = |input: &Path, to: &str, out: &Path, more: &[&str]| -> (i32, String) {
        let arguments = ["convert", text(input), "--to", to, "--out", text(out)];
        quick(&[&arguments[..], more].concat())
    };
    // Keys that climb.
    hostile::traversal(&scene, &at("traversal/data"), &at("traversal/victim"));
    let before = hostile::snapshot(&at("traversal"));
    for out in ["traversal/out", "traversal/data/out"] {
        for more in [&[][..], &["--force"]] {
            let (code, said) = convert(&at("traversal/data"), "native", &at(out), more);
            assert!(has_failed(code), "{said}");
            insta::allow_duplicates! { assert_snapshot!(redacted(&said), @"error: `[folder]/traversal/data/dataset_summary.pkl`: field `../victim/secret.pkl` is `../victim/secret.pkl`; expected a file name without a folder") };
        }
    }
    assert_eq!(hostile::snapshot(&at("traversal")), before);
    // So do other commands that read the folder.
    let (code, _) = quick(&["inspect", text(&at("traversal/data"))]);
    assert_eq!(code, 1);
    // A mapping, or a link, that leads out of the data set is refused.
    let mut refused = Vec::new();
    for (name, mapped) in [
        ("merged", "../waymo"),
        ("deeper", "part/../../waymo"),
        ("absolute", text(&at("waymo"))),
        ("linked", "link"),
        ("inside", "part"),
    ] {
        std::fs::create_dir_all(at(name).join("part")).unwrap();
        std::fs::copy(&scene, at(name).join("part/a.pkl")).unwrap();
        #[cfg(unix)]
        if name == "linked" {
            std::os::unix::fs::symlink(at("waymo"), at("linked/link")).unwrap();
        }
        std::fs::create_dir_all(at("waymo")).unwrap();
        std::fs::copy(&scene, at("waymo/a.pkl")).unwrap();
        hostile::summary(&at(name), &[("a.pkl", mapped)]);
        let out = at(&format!("{name}-out"));
        let (code, said) = convert(&at(name), "native", &out, &[]);
        if name != "inside" {
            assert!(has_failed(code), "{name}: {said}");
            assert!(!out.exists(), "{name}: {said}");
            refused.push((name, said));
        } else {
            assert_eq!(code, 0, "{said}");
            assert_eq!(
                hostile::snapshot(&out).keys().collect::<Vec<_>>(),
                ["manifest.jsonl", "part/a.safetensors", "run.json"]
            );
        }
    }
    assert_eq!(hostile::snapshot(&at("waymo")).len(), 1);
    #[cfg(unix)]
    assert_snapshot!("mappings_that_lead_out_of_the_data_set", messages(refused));
}

#[test]
fn convert_never_replaces_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("in/part")).unwrap();
    std::fs::copy(example(), at("in/part/a.pkl")).unwrap();
    let before = hostile::snapshot(&at("in"));
    let mut refused = Vec::new();
    for out in ["in", "in/../in", "in/part/.."] {
        let arguments = ["convert", text(&at("in")), "--to", "pickle", "--force", "--out", text(&at(out))]
            .map(str::to_owned);
        let (code, said) = quick(&arguments.each_ref().map(String::as_str));
        assert!(has_failed(code), "{said}");
        refused.push((out, said));
        assert_eq!(hostile::snapshot(&at("in")), before);
    }
    assert_snapshot!("convert_in_place_of_its_input", messages(refused));
    let file = at("in/part/a.pkl");
    let (code, _) =
        quick(&["convert", text(&file), "--to", "pickle", "--force", "--out", text(&at("in/part"))]);
    assert_eq!((code, hostile::snapshot(&at("in"))), (1, before));
}

#[cfg(unix)]
#[test]
fn generate_never_replaces_its_input() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for dir in ["in", "links"] {
        std::fs::create_dir(at(dir)).unwrap();
    }
    std::fs::copy(example(), at("in/a.pkl")).unwrap();
    symlink(at("in/a.pkl"), at("links/a.pkl")).unwrap();
    let before = hostile::snapshot(folder.path());
    let mut refused = Vec::new();
    for (input, out) in
        [("a.pkl", "."), ("../links", "."), ("../links/a.pkl", "../in"), (".", "out"), (".", ".")]
    {
        let output = Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(["generate", input, "--force", "--out", out])
            .args(WEIGHTS)
            .current_dir(at("in"))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1), "{input} {out}");
        refused.push((format!("generate {input} --out {out}"), stderr(&output).to_owned()));
        assert!(hostile::snapshot(folder.path()) == before, "{input} {out}");
    }
    assert_snapshot!("generate_in_place_of_its_input", messages(refused));
}

#[test]
fn a_scene_whose_source_is_damaged_keeps_no_other_from_being_attacked() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("in")).unwrap();
    let mut native = Recording::read(Path::new(&example())).unwrap().to_native().unwrap();
    // The source begins with its PROTO, which is changed to an opcode that there is not.
    let source = native.windows(3).rposition(|w| w == b"\x80\x04}").unwrap();
    native[source + 2] = 0xff;
    std::fs::write(at("in/1.safetensors"), native).unwrap();
    std::fs::copy(example(), at("in/2.pkl")).unwrap();
    let output = sage(&["generate", text(&at("in")), "--out", text(&at("out"))]);
    assert_eq!(output.status.code(), Some(BAD_SCENES));
    assert_snapshot!(redacted(&sorted(stderr(&output))), @r"
    1 of 2 scenes failed; the others are in `[folder]/out`; remove the cause and run the same command again
    1 scene, 1 attempt in `[folder]/out` ([time])
    error: `[folder]/in/1.safetensors` at byte 2: opcode unknown (0xff) is not allowed in a scene file
    note: weights `procedural` (network densetnt)
    to look at the attacks, open `[folder]/out/index.html`
    ");
    assert!(pickle(&at("out"), "2-lambda1.00").is_file());
}

#[cfg(unix)]
#[test]
fn arguments_that_are_no_text_are_no_reason_to_panic() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};
    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join(OsStr::from_bytes(b"x\xff.pkl"));
    std::fs::copy(example(), &odd).unwrap();
    let out = folder.path().join("out");
    let run = Command::new(env!("CARGO_BIN_EXE_sage"))
        .arg("convert")
        .arg(&odd)
        .args(["--to", "native", "--out", text(&out)])
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    // The scene, and the record and the manifest of the run.
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 3);
    // Messages repeat what was typed, without control characters.
    let run = sage(&["inspect", "--e\u{1b}[31mx"]);
    assert_eq!(run.status.code(), Some(2));
    assert!(!stderr(&run).contains('\u{1b}'), "{}", stderr(&run));
}

#[cfg(unix)]
#[test]
fn an_output_file_that_is_a_link_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(folder.path().join("nowhere"), &link).unwrap();
    for more in [&[][..], &["--force"]] {
        let error = failure(&[&["draw", &example(), "--out", text(&link)], more].concat());
        insta::allow_duplicates! { assert_snapshot!(redacted(&error), @"error: `[folder]/link` is a link; name the file itself, or - for standard output") };
    }
    assert!(link.is_symlink());
}

#[cfg(unix)]
#[test]
fn links_are_read_and_never_written_through() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for dir in ["originals", "in", "victim", "out"] {
        std::fs::create_dir(at(dir)).unwrap();
    }
    std::fs::copy(example(), at("originals/a.pkl")).unwrap();
    symlink(at("originals/a.pkl"), at("in/a.pkl")).unwrap();
    let convert = |out: &Path, more: &[&str]| {
        quick(&[&["convert", text(&at("in")), "--to", "pickle", "--out", text(out)], more].concat())
    };
    assert_eq!(convert(&at("plain"), &[]).0, 0, "a link as input is readable");
    // Over the original behind the link, or over the link itself.
    let before = hostile::snapshot(&at("originals"));
    let mut refused = Vec::new();
    for out in ["originals", "in"] {
        let (code, said) = convert(&at(out), &["--force"]);
        assert!(has_failed(code), "{said}");
        refused.push((format!("--out {out}"), said));
    }
    assert!(at("in/a.pkl").is_symlink());
    assert_eq!(hostile::snapshot(&at("originals")), before);
    // Links in the output folder: a file's is replaced, a folder's is refused.
    std::fs::write(at("victim/b.txt"), "mine").unwrap();
    symlink(at("victim/b.txt"), at("out/a.pkl")).unwrap();
    assert_eq!(convert(&at("out"), &["--force"]).0, 0);
    assert_eq!(std::fs::read(at("victim/b.txt")).unwrap(), b"mine");
    std::fs::create_dir(at("in/part")).unwrap();
    std::fs::copy(example(), at("in/part/b.pkl")).unwrap();
    symlink(at("victim"), at("out/part")).unwrap();
    std::fs::create_dir(at("in/part/deep")).unwrap();
    std::fs::copy(example(), at("in/part/deep/c.pkl")).unwrap();
    let (code, said) = convert(&at("out"), &["--force"]);
    assert!(has_failed(code), "{said}");
    refused.push(("a folder of the output is a link".to_owned(), said));
    assert_snapshot!("links_in_place_of_outputs", messages(refused));
    assert_eq!(std::fs::read_dir(at("victim")).unwrap().count(), 1, "not even a folder is made there");
}
