//! Full disks, read-only folders, and file systems without locks.

use std::process::Stdio;

use super::*;

const GENERATE: [&str; 8] =
    ["generate", "scenes", "--lambda", "1", "--format", "rows", "--weights", "procedural"];

/// A file system in memory; `None` where nothing can be mounted.
struct Mounted(tempfile::TempDir);

impl Mounted {
    fn new(options: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mount = ["-t", "tmpfs", "-o", options, "tmpfs", text(folder.path())];
        let status = Command::new("mount").args(mount).stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success()).then_some(Self(folder))
    }

    fn remount(&self, options: &str) {
        let options = format!("remount,{options}");
        let status = Command::new("mount").args(["-o", &options, text(self.0.path())]).status();
        assert!(status.unwrap().success());
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_and_a_read_only_folder_are_named_and_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 10);
    let Some(disk) = Mounted::new("size=3m") else {
        return eprintln!("left out: a small disk needs a mount");
    };
    let out = disk.0.path().join("out");
    let run = |more: &[&str]| sage_in(root, &[&GENERATE[..], &["--out", text(&out)], more].concat());
    assert_eq!(run(&["--shard", "1/3"]).status.code(), Some(0));
    let first = std::fs::read(out.join("shards/1-of-3.jsonl")).unwrap();
    // All but a little is used up.
    let filler = disk.0.path().join("filler");
    let _ = std::fs::write(&filler, vec![0; 4 << 20]);
    let length = filler.metadata().unwrap().len();
    std::fs::OpenOptions::new().write(true).open(&filler).unwrap().set_len(length - (100 << 10)).unwrap();
    let full = run(&["--shard", "2/3"]);
    assert_eq!(full.status.code(), Some(RETRY), "{}", stderr(&full));
    assert!(stderr(&full).contains("free space and run the same command again"), "{}", stderr(&full));
    disk.remount("ro");
    for more in [&["--shard", "2/3"][..], &["--shard", "3/3"], &[]] {
        let read_only = run(more);
        assert_eq!(read_only.status.code(), Some(RETRY), "{}", stderr(&read_only));
        assert!(stderr(&read_only).contains("cannot write into"), "{}", stderr(&read_only));
    }
    assert_eq!(sage_in(root, &["status", text(&out)]).status.code(), Some(RETRY));
    assert_eq!(std::fs::read(out.join("shards/1-of-3.jsonl")).unwrap(), first);
    disk.remount("rw,size=100m");
    for shard in ["2/3", "3/3"] {
        assert!(matches!(run(&["--shard", shard]).status.code(), Some(0 | BAD_SCENES)));
    }
    assert_eq!(sage_in(root, &["join", text(&out)]).status.code(), Some(BAD_SCENES));
    sage_in(root, &[&GENERATE[..], &["--out", "whole"]].concat());
    assert_same(&out, &root.join("whole"));
}

/// A library in which no file can be locked, as on some network file systems.
fn without_locks(folder: &Path, errno: &str) -> Option<PathBuf> {
    let [source, library] = ["nolocks.c", "nolocks.so"].map(|name| folder.join(name));
    let code = "#include <errno.h>\nint flock(int f, int o) { errno = ERRNO; return -1; }\n";
    std::fs::write(&source, code.replace("ERRNO", errno)).unwrap();
    let status = Command::new("cc")
        .args(["-shared", "-fPIC", "-o", text(&library), text(&source)])
        .stderr(Stdio::null())
        .status();
    status.is_ok_and(|status| status.success()).then_some(library)
}

#[cfg(target_os = "linux")]
#[test]
fn shards_need_no_locks() {
    // Without the call, and NFS without a lock daemon.
    ["ENOSYS", "ENOLCK"].iter().for_each(|errno| run_without_locks(errno));
}

#[cfg(target_os = "linux")]
fn run_without_locks(errno: &str) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 8);
    let Some(library) = without_locks(root, errno) else {
        return eprintln!("left out: a file system without locks needs a C compiler");
    };
    let start = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
        command.args(arguments).current_dir(root).env_remove("SAGE_WEIGHTS").env("LD_PRELOAD", &library);
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let shard = |number: &str| start(&[&GENERATE[..], &["--out", "out", "--shard", number]].concat());
    // Every shard twice at once, and what killed processes left.
    std::fs::create_dir(root.join("out")).unwrap();
    let left = root.join("out/.sage-killed.part");
    std::fs::write(&left, "half").unwrap();
    let all: Vec<_> = ["1/3", "2/3", "3/3", "1/3", "2/3", "3/3"].into_iter().map(shard).collect();
    for child in all {
        let output = child.wait_with_output().unwrap();
        let code = output.status.code();
        assert!(matches!(code, Some(0 | BAD_SCENES)), "{code:?} {}", stderr(&output));
    }
    let names = || hostile::snapshot(&root.join("out")).into_keys();
    assert!(names().all(|name| !name.contains(".sage-lock")), "{:?}", names().collect::<Vec<_>>());
    // A killed shard blocks nobody.
    let mut killed = shard("1/3");
    std::thread::sleep(std::time::Duration::from_millis(60));
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(matches!(shard("1/3").wait().unwrap().code(), Some(0 | BAD_SCENES)));
    let joined = sage_in(root, &["join", "out"]);
    assert_eq!(joined.status.code(), Some(BAD_SCENES), "{}", stderr(&joined));
    sage_in(root, &[&GENERATE[..], &["--out", "whole"]].concat());
    assert!(!left.exists(), "the join removes what killed shards left");
    assert_same(&root.join("out"), &root.join("whole"));
}

#[test]
fn one_shard_twice_at_once_is_refused_or_harmless() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 8);
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
        command.args(GENERATE).args(["--out", "out", "--shard", "1/2"]).current_dir(root);
        command.env_remove("SAGE_WEIGHTS").stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let both = [start(), start()].map(|child| child.wait_with_output().unwrap());
    let codes: Vec<i32> = both.iter().map(|output| output.status.code().unwrap()).collect();
    assert!(codes.iter().all(|code| [0, BAD_SCENES, RETRY].contains(code)), "{codes:?}");
    assert!(codes.iter().any(|code| *code != RETRY), "{codes:?}");
}
