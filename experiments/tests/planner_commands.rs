//! Commands with planners that are programs.

#![cfg(unix)]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.
#![allow(clippy::print_stderr)] // Tests that are left out say so.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use insta::assert_snapshot;
use program::*;
use serde_json::Value;

/// A file of the project.
fn of_project(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).canonicalize().unwrap().display().to_string()
}

/// Whether planners in Python can run; says if not.
fn has_python() -> bool {
    let has = Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success());
    if !has {
        eprintln!("left out: planners need python3");
    }
    has
}

/// A folder with `sage_planner.py`, a planner of this text, and three scenes.
fn desk(planner: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::copy(of_project("examples/planners/sage_planner.py"), at("sage_planner.py")).unwrap();
    fs::write(at("planner.py"), planner).unwrap();
    stdout(&sage(&["scenes", "--kind", "divided", "--count", "3", "--out", text(&at("scenes"))]));
    folder
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sage")).current_dir(folder).args(arguments).output().unwrap()
}

const PLANNER: &str = "cmd:python3 planner.py";

/// The planner of the README, which is that of the page about planners.
fn documented() -> String {
    let [readme, page] = ["README.md", "docs/testing-a-driver.md"].map(|name| {
        let text = fs::read_to_string(of_project(name)).unwrap();
        let (_, rest) = text.split_once("```python\n").unwrap();
        rest.split_once("```").unwrap().0.to_owned()
    });
    assert_eq!(readme, page);
    readme
}

#[test]
fn the_documented_planner_works_in_all_commands() {
    if !has_python() {
        return;
    }
    let folder = desk(&documented());
    let rows = |out: &str| -> Vec<Value> {
        let mut files: Vec<PathBuf> =
            fs::read_dir(folder.path().join(out)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.retain(|file| file.extension().is_some_and(|e| e == "json") && !file.ends_with("run.json"));
        files.sort();
        files.iter().map(|file| serde_json::from_slice(&fs::read(file).unwrap()).unwrap()).collect()
    };
    for arguments in [
        &["simulate", "scenes", "--ego", "idm", "--ego", PLANNER, "--check-planner", "--out", "driven"][..],
        &["simulate", "scenes", "--ego", PLANNER, "--method", "rule", "--out", "attacked"],
        &["generate", "scenes", "--ego", PLANNER, "--method", "rule", "--out", "aimed"],
        &[
            "bench",
            "drivers",
            "scenes",
            "--ego",
            &format!("idm,{PLANNER}"),
            "--method",
            "rule",
            "--out",
            "compared",
        ],
        &["bench", "closed-loop", "scenes", "--ego", PLANNER, "--method", "rule", "--out", "episodes"],
    ] {
        let output = run(folder.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    }
    for (out, count) in [("driven", 6), ("attacked", 3), ("aimed", 3)] {
        assert_eq!(rows(out).len(), count, "{out}");
    }
    assert!(rows("attacked").iter().all(|row| row["ego"] == PLANNER));
    // The rows name the command; the same command finds them.
    let again = run(
        folder.path(),
        &["simulate", "scenes", "--ego", PLANNER, "--method", "rule", "--out", "attacked"],
    );
    assert!(stderr(&again).contains("finished before"), "{}", stderr(&again));
    // Another text of the planner is another run.
    fs::write(folder.path().join("planner.py"), documented() + "\n").unwrap();
    let other = run(
        folder.path(),
        &["simulate", "scenes", "--ego", PLANNER, "--method", "rule", "--out", "attacked"],
    );
    assert_eq!(other.status.code(), Some(1));
    assert!(stderr(&other).contains("`planner.py` has changed since"), "{}", stderr(&other));
}

#[test]
fn a_planner_that_fails_in_one_scene_costs_that_drive_alone() {
    if !has_python() {
        return;
    }
    let planner = r#"
import sys
from sage_planner import serve

class Fails:
    def reset(self, scene, seed):
        self.fails = scene.id.endswith("-1")

    def act(self, obs):
        print("at", round(obs.t, 1), file=sys.stderr)
        if self.fails and obs.t > 2.05:
            print("no way to go", file=sys.stderr)
            sys.exit(1)
        return [[0.8 * k, 0.0] for k in range(1, 31)]

serve(Fails())
"#;
    let folder = desk(planner);
    let arguments =
        ["simulate", "scenes", "--ego", "idm", "--ego", PLANNER, "--threads", "1", "--out", "out"];
    let output = run(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(BAD_SCENES), "{}", stderr(&output));
    assert_snapshot!("a_drive_fails", redacted(stderr(&output)));
    let exists = |name: &str| folder.path().join("out").join(name).is_file();
    for scene in ["divided-1-0", "divided-1-1", "divided-1-2"] {
        assert!(exists(&format!("{scene}.html")) && exists(&format!("{scene}-idm.json")), "{scene}");
    }
    let of_planner = |scene: &str| exists(&format!("{scene}-cmd-python3-planner.py.json"));
    let drives = ["divided-1-0", "divided-1-1", "divided-1-2"].map(of_planner);
    assert_eq!(drives.iter().filter(|found| **found).count(), 2, "{drives:?}");
    let log = fs::read_to_string(folder.path().join("out/planner-logs/planner-1.log")).unwrap();
    assert!(log.contains("no way to go"), "{log}");
    // A study leaves the drive out of all rates, and says so.
    let drivers = format!("idm,{PLANNER}");
    let study = ["bench", "drivers", "scenes", "--unattacked", "--ego", &drivers, "--out", "study"];
    let output = run(folder.path(), &study);
    assert_eq!(output.status.code(), Some(BAD_SCENES), "{}", stderr(&output));
    assert_snapshot!(redacted(&String::from_utf8_lossy(&output.stdout)));
    // The finished study is shown again, with the same exit status.
    let again = run(folder.path(), &study);
    assert_eq!((again.status.code(), &again.stdout), (Some(BAD_SCENES), &output.stdout));
}

#[test]
fn a_planner_that_depends_on_more_than_its_messages_is_told() {
    if !has_python() {
        return;
    }
    let planner = "from sage_planner import serve\nclass Counts:\n    drives = 0\n    def reset(self, scene, seed):\n        self.drives += 1\n    def act(self, obs):\n        return 0.0, 0.1 * (self.drives % 2)\nserve(Counts())\n";
    let folder = desk(planner);
    let output =
        run(folder.path(), &["simulate", "scenes", "--ego", PLANNER, "--check-planner", "--out", "out"]);
    assert_eq!(output.status.code(), Some(1));
    assert_snapshot!(redacted(stderr(&output)));
}

#[test]
fn planners_end_with_sage() {
    if !has_python() || !Path::new("/proc/self").exists() {
        return;
    }
    let planner = |act: &str| {
        format!(
            "import os, time\nfrom sage_planner import serve\nopen('pid', 'w').write(str(os.getpid()))\nclass Slow:\n    def act(self, obs):\n        {act}\n        return 0.0, 0.1\nserve(Slow())\n"
        )
    };
    let wait = |what: &str, holds: &dyn Fn() -> bool| {
        let start = Instant::now();
        while !holds() && start.elapsed().as_secs() < 20 {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(holds(), "{what}");
    };
    // A killed `sage` ends the planner's input. One that is told to end kills even a planner that reads nothing.
    for (signal, act) in
        [("KILL", "time.sleep(0.05)"), ("TERM", "time.sleep(1000)"), ("INT", "time.sleep(1000)")]
    {
        let folder = desk(&planner(act));
        let note = folder.path().join("pid");
        let mut sage = Command::new(env!("CARGO_BIN_EXE_sage"))
            .current_dir(folder.path())
            .args([
                "simulate",
                "scenes",
                "--ego",
                PLANNER,
                "--ego-timeout",
                "900",
                "--threads",
                "1",
                "--out",
                "out",
            ])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        wait("the planner starts", &|| fs::read_to_string(&note).is_ok_and(|text| !text.is_empty()));
        let process = PathBuf::from("/proc").join(fs::read_to_string(&note).unwrap()).join("stat");
        assert!(process.exists());
        assert!(
            Command::new("sh")
                .args(["-c", "kill -s $0 $1", signal, &sage.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        sage.wait().unwrap();
        wait(signal, &|| fs::read_to_string(&process).map_or(true, |stat| stat.contains(") Z ")));
    }
}

#[test]
fn adapters_work_with_the_packages_that_are_there() {
    if !has_python() {
        return;
    }
    let mut pythons = vec!["python3".to_owned()];
    pythons.extend(std::env::var("SAGE_METADRIVE_PYTHON"));
    for python in pythons {
        for file in [
            "test_adapters.py",
            "fiss/test_fiss.py",
            "openpilot/test_openpilot.py",
            "pufferdrive/test_pufferdrive.py",
        ] {
            let file = of_project(&format!("examples/planners/{file}"));
            let output = Command::new(&python).arg(file).output().unwrap();
            eprintln!("{python}: {}", String::from_utf8_lossy(&output.stdout));
            assert!(output.status.success(), "{python}: {}", stderr(&output));
        }
    }
}
