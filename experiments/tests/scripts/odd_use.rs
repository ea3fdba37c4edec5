//! What a script cannot say: outputs that are closed, and arguments that are no text.

use std::process::Command;

use crate::{hostile, program::*};

#[cfg(unix)]
#[test]
fn a_closed_output_keeps_no_file_from_being_written() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "3", "--out", text(&scenes)]));
    for (number, shell) in ["exec \"$@\" >&-", "\"$@\" | true; exit ${PIPESTATUS[0]}"].into_iter().enumerate()
    {
        let out = folder.path().join(format!("out{number}"));
        let run = |arguments: &[&str]| {
            let output = Command::new("bash")
                .args(["-c", shell, "bash", env!("CARGO_BIN_EXE_sage")])
                .args(arguments)
                .args(WEIGHTS)
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(0), "{shell}: {}", stderr(&output));
        };
        run(&["generate", text(&scenes), "--out", text(&out)]);
        // Pickle, row, picture and page of each, and two tables, the record, the manifest and the page of all.
        assert_eq!(hostile::snapshot(&out).len(), 3 * 4 + 5);
        let table = folder.path().join(format!("table{number}"));
        run(&["bench", "open-loop", text(&scenes), "--method", "log,sage", "--out", text(&table)]);
        assert!(table.join("index.html").is_file() && table.join("table.md").is_file());
    }
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
}
