//! Runs on a full disk, and the memory of runs over many scenes.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; notes go to stderr.

mod hostile;
mod program;

use std::{
    path::Path,
    process::{Command, Output, Stdio},
};

use program::*;
use sage_data::Recording;

/// Hidden files of a folder: locks and unfinished files.
fn hidden(folder: &Path) -> Vec<String> {
    let is_hidden = |name: &String| name.contains(".sage-") && !name.ends_with(".sage-unfinished");
    hostile::snapshot(folder).into_keys().filter(is_hidden).collect()
}

/// A small disk, or a stand-in: a limit on the size of files.
#[cfg(unix)]
struct SmallDisk {
    folder: tempfile::TempDir,
    is_mounted: bool,
}

#[cfg(unix)]
impl SmallDisk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mount = ["-t", "tmpfs", "-o", "size=2m", "tmpfs", text(folder.path())];
        let is_mounted =
            Command::new("mount").args(mount).stderr(Stdio::null()).status().is_ok_and(|s| s.success());
        Self { folder, is_mounted }
    }

    /// Runs the binary with its output there.
    fn run(&self, arguments: &[&str]) -> Output {
        let limit = if self.is_mounted { "unlimited" } else { "20" };
        Command::new("bash")
            .args(["-c", "trap '' XFSZ; ulimit -f \"$0\"; exec \"$@\"", limit, env!("CARGO_BIN_EXE_sage")])
            .args(arguments)
            .output()
            .unwrap()
    }

    /// Uses up what is left.
    fn fill(&self) {
        let _ = std::fs::write(self.folder.path().join("filler"), vec![0; 4 << 20]);
    }
}

#[cfg(unix)]
impl Drop for SmallDisk {
    fn drop(&mut self) {
        if self.is_mounted {
            let _ = Command::new("umount").arg(self.folder.path()).status();
        }
    }
}

#[cfg(unix)]
#[test]
fn a_full_disk_stops_the_run_and_leaves_whole_files_alone() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "12", "--format", "pickle", "--out", text(&scenes)]));
    let disk = SmallDisk::new();
    let out = disk.folder.path().join("out");
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    for command in [
        vec!["generate", text(&scenes), "--weights", "procedural"],
        vec!["convert", text(&scenes), "--to", "pickle"],
        vec!["scenes", "--count", "40"],
        vec!["demo"],
        vec!["pretrain", text(&scenes), "--epochs", "1", "--network", r#"{"hidden": 128, "rounds": 3}"#],
    ] {
        let output = disk.run(&[&command[..], &["--out", text(&out)]].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(RETRY), "{command:?}: {said}");
        assert!(said.contains("cannot write"), "{command:?}: {said}");
        if ["generate", "convert"].contains(&command[0]) {
            assert!(said.contains("of 12 scenes are") && said.contains("free space"), "{said}");
            assert_eq!(said.matches("error:").count(), 1, "it stops at the first: {said}");
        }
        let files = hostile::snapshot(&out);
        assert!(hidden(&out).is_empty(), "{command:?}: {:?}", files.keys());
        for (name, bytes) in files {
            let path = out.join(&name);
            match name.rsplit('.').next().unwrap() {
                "pkl" => drop(Recording::from_bytes(&path, bytes).unwrap()),
                "safetensors" if command[0] == "pretrain" => {
                    drop(sage_backbones::Parameters::from_bytes(&bytes, &path).unwrap());
                }
                "safetensors" => drop(Recording::from_bytes(&path, bytes).unwrap()),
                "json" => drop(serde_json::from_slice::<serde_json::Value>(&bytes).unwrap()),
                "svg" => assert!(bytes.ends_with(b"</svg>\n") || bytes.ends_with(b"</svg>"), "{name}"),
                _ => {}
            }
        }
        std::fs::remove_dir_all(&out).unwrap();
    }
    if !disk.is_mounted {
        return eprintln!("left out: a disk that is full from the start needs a mount");
    }
    // A disk that is full already is told before any work.
    disk.fill();
    let dial = disk.folder.path().join("dial.json");
    for command in [
        vec!["calibrate", text(&scenes), "--out", text(&dial)],
        vec!["generate", text(&scenes), "--weights", "procedural", "--out", text(&out)],
        vec!["finetune", text(&scenes), "--config", text(&config), "--out", text(&out)],
        vec!["bench", "open-loop", text(&scenes), "--method", "log", "--out", text(&out)],
    ] {
        let output = disk.run(&command);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(RETRY), "{command:?}: {said}");
        assert!(said.contains("cannot write into"), "{command:?}: {said}");
        assert!(
            !said.contains("epoch") && !said.contains("selection"),
            "the work was done for nothing: {said}"
        );
    }
    assert_eq!(hidden(disk.folder.path()), Vec::<String>::new());
}

#[cfg(target_os = "linux")]
#[test]
fn memory_does_not_grow_with_the_number_of_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    // Of one kind, because the largest scene decides the peak.
    stdout(&sage(&["scenes", "--kind", "four-way", "--count", "152", "--out", text(&scenes)]));
    let names: Vec<String> = hostile::snapshot(&scenes)
        .into_keys()
        .map(|name| name.trim_end_matches(".safetensors").to_owned())
        .collect();
    // The peak of a process's memory is kept by the system until somebody asks, while it lives.
    let peak = |arguments: &[&str]| -> f64 {
        let script = "import resource, subprocess, sys; code = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL); print(code, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)";
        let output = Command::new("python3")
            .args(["-I", "-c", script, env!("CARGO_BIN_EXE_sage")])
            .args(arguments)
            .args(["--threads", "1"])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let numbers: Vec<f64> = said.split_whitespace().map(|x| x.parse().unwrap()).collect();
        assert_eq!(numbers[0], 0.0, "{arguments:?}");
        numbers[1] / 1024.0
    };
    if !Command::new("python3").args(["-I", "-c", ""]).output().is_ok_and(|run| run.status.success()) {
        return eprintln!("left out: the peak of memory is asked for by python3");
    }
    // Peaks of equal runs differ by 30 MiB, upwards: the least of three counts.
    let assert_bounded = |name: &str, counts: [usize; 2], run: &dyn Fn(usize) -> f64| {
        let mut peaks = [f64::INFINITY; 2];
        for _ in 0..3 {
            for (peak, count) in peaks.iter_mut().zip(counts) {
                *peak = peak.min(run(count));
            }
            if peaks[1] - peaks[0] < 0.5 * (counts[1] - counts[0]) as f64 {
                return;
            }
        }
        panic!("{name}: {:.0} MiB with {} scenes, {:.0} with {}", peaks[0], counts[0], peaks[1], counts[1]);
    };
    for (name, command) in [
        ("table", vec!["bench", "open-loop", "--method", "log,random", "--lambda", "1"]),
        ("dial", vec!["bench", "dial"]),
        ("calibrate", vec!["calibrate", "--selection", "paper-selection"]),
    ] {
        // 24 scenes fill the window of scenes that are held at once.
        assert_bounded(name, [24, 88], &|count| {
            let out = tempfile::tempdir_in(&folder).unwrap();
            let out = out.path().join(name);
            let some = names[..count].join(",");
            peak(&[&command[..], &[text(&scenes), "--scenes", &some, "--out", text(&out)]].concat())
        });
    }
    // Until all buffers have been used once, memory grows with the largest scene so far.
    assert_bounded("generate", [72, 152], &|count| {
        let folder = tempfile::tempdir_in(&folder).unwrap();
        let [part, out] = ["part", "out"].map(|name| folder.path().join(name));
        std::fs::create_dir(&part).unwrap();
        for name in &names[..count] {
            let file = format!("{name}.safetensors");
            std::fs::copy(scenes.join(&file), part.join(&file)).unwrap();
        }
        peak(&["generate", text(&part), "--lambda", "0,1", "--json", "--out", text(&out)])
    });
}
