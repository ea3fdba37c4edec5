//! Links in an output folder, at every name that a command writes or removes: no command writes, deletes or
//! opens anything outside its folder.

#![cfg(unix)]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod commands;
#[path = "../recipe/mod.rs"]
mod recipe;

use std::{
    collections::{BTreeMap, BTreeSet},
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use commands::{COMMANDS, FILES, prepare};

/// Runs a command in a folder with its inputs.
fn sage(root: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
    command.current_dir(root).args(arguments).env_remove("SAGE_WEIGHTS").stdin(Stdio::null());
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked") && output.status.code().is_some(), "{arguments:?}: {said}");
    output
}

/// All files and folders below a folder, links not followed, with the content of files.
fn listing(root: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let kind = path.symlink_metadata().unwrap().file_type();
            if kind.is_dir() {
                open.push(path.clone());
            }
            let content = kind.is_file().then(|| std::fs::read(&path).unwrap());
            found.insert(path.strip_prefix(root).unwrap().to_owned(), content);
        }
    }
    found
}

/// Names that an uninterrupted run leaves, files and folders apart, and names of `passing` files and folders.
fn names(root: &Path, arguments: &[&str], passing: &[&str]) -> [BTreeSet<PathBuf>; 2] {
    let output = sage(root, &[arguments, &["--out", "whole"]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    let [mut files, mut folders] = [BTreeSet::new(), BTreeSet::new()];
    for (name, content) in listing(&root.join("whole")) {
        if content.is_some() {
            files.insert(name)
        } else {
            folders.insert(name)
        };
    }
    for name in passing {
        match name.strip_suffix('/') {
            Some(folder) => folders.insert(folder.into()),
            None => files.insert(name.into()),
        };
    }
    [files, folders]
}

/// What lies outside: a file and a folder with a file, which links name.
fn outside(root: &Path) -> PathBuf {
    let outside = root.join("outside");
    std::fs::create_dir_all(outside.join("folder/deep")).unwrap();
    for name in ["file", "folder/file", "folder/deep/file"] {
        std::fs::write(outside.join(name), "precious").unwrap();
    }
    outside
}

/// Puts links at names in a new output folder. Names below the name of another link are left out.
fn put_links(out: &Path, names: impl IntoIterator<Item = impl AsRef<Path>>, target: &Path) {
    for name in names {
        let path = out.join(name);
        if path.ancestors().skip(1).take_while(|above| *above != out).any(Path::is_symlink) {
            continue;
        }
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
    }
}

fn check(number: usize) {
    let (name, arguments, passing) = COMMANDS[number];
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    prepare(root, &|arguments| {
        let output = sage(root, arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    });
    let [files, folders] = names(root, arguments, passing);
    let outside = outside(root);
    let before = listing(&outside);
    let mut tried = 0;
    let mut attack = |names: Vec<&PathBuf>, target: &Path, force: bool| {
        let out = root.join(format!("out-{tried}"));
        tried += 1;
        std::fs::create_dir(&out).unwrap();
        put_links(&out, &names, target);
        let out = out.display().to_string();
        let arguments = [arguments, &["--out", &out], if force { &["--force"] } else { &[] }].concat();
        let output = sage(root, &arguments);
        assert_eq!(listing(&outside), before, "{name}: {names:?} as links to {}", target.display());
        output
    };
    let (file, inner) = (outside.join("file"), outside.join("folder"));
    // A link is replaced by the output, or removed.
    let output = attack(files.iter().collect(), &file, true);
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    attack(files.iter().collect(), &inner, true);
    attack(files.iter().collect(), &outside.join("none"), true);
    attack(files.iter().collect(), &file, false);
    // One at a time: the first that is refused ends the run.
    let passing: Vec<PathBuf> =
        passing.iter().map(|name| PathBuf::from(name.trim_end_matches('/'))).collect();
    let lock = PathBuf::from(".sage-lock");
    for one in folders.iter().chain(&passing).chain([&lock]) {
        attack(vec![one], &inner, true);
    }
    attack(vec![&lock], &file, true);
}

#[test]
fn folders_of_short_commands() {
    (0..COMMANDS.len()).filter(|number| !is_long(*number)).for_each(check);
}

#[test]
fn folders_of_long_commands() {
    (0..COMMANDS.len()).filter(|number| is_long(*number)).for_each(check);
}

fn is_long(number: usize) -> bool {
    ["pretrain", "finetune", "train-ego"].contains(&COMMANDS[number].0)
}

#[test]
fn single_output_files() {
    for (name, arguments, file) in FILES {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        prepare(root, &|arguments| assert!(sage(root, arguments).status.success()));
        let outside = outside(root);
        let before = listing(&outside);
        for target in ["file", "folder", "none"] {
            symlink(outside.join(target), root.join(file)).unwrap();
            sage(root, &[*arguments, &["--out", file, "--force"]].concat());
            assert_eq!(listing(&outside), before, "{name} with a link to {target}");
            std::fs::remove_file(root.join(file)).unwrap();
        }
    }
}

#[test]
fn an_unfinished_run_with_links_is_not_resumed_through_them() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    prepare(root, &|arguments| assert!(sage(root, arguments).status.success()));
    let arguments = commands::TRAIN_EGO;
    // A run that breaks off: its folder holds the record, checkpoints and rows.
    let run = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
        command.current_dir(root).args(arguments).args(["--out", "run"]).env_remove("SAGE_WEIGHTS");
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut child = run();
    while !root.join("run/seed-0/buffer").is_dir() && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let outside = outside(root);
    let before = listing(&outside);
    let names: Vec<PathBuf> =
        listing(&root.join("run")).into_keys().filter(|name| !name.ends_with("run.json")).collect();
    for (number, name) in names.iter().enumerate() {
        let copy = root.join(format!("copy-{number}"));
        for (name, content) in listing(&root.join("run")) {
            let path = copy.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            if let Some(content) = content {
                std::fs::write(path, content).unwrap();
            }
        }
        let place = copy.join(name);
        let is_folder = place.is_dir();
        if is_folder {
            std::fs::remove_dir_all(&place).unwrap();
        } else if place.is_file() {
            std::fs::remove_file(&place).unwrap();
        }
        symlink(outside.join(if is_folder { "folder" } else { "file" }), &place).unwrap();
        let copy = copy.display().to_string();
        sage(root, &[arguments, &["--out", &copy]].concat());
        assert_eq!(listing(&outside), before, "{}", name.display());
    }
}
