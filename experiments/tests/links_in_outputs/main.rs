//! Links in an output folder, at every name that a command writes or removes: no command writes, deletes or
//! opens anything outside its folder.

#![cfg(unix)]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../recipe/mod.rs"]
mod recipe;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

/// A row of the table: name, arguments, names that exist only for a while.
struct Row {
    name: &'static str,
    arguments: Vec<&'static str>,
    passing: Vec<&'static str>,
}

fn rows() -> Vec<Row> {
    let lines = include_str!("commands.table").lines().filter(|line| !line.starts_with('#'));
    let row = |line: &'static str| {
        let mut cells = line.split('|').map(|cell| cell.split_whitespace().collect::<Vec<_>>());
        let [name, arguments, passing] = std::array::from_fn(|_| cells.next().unwrap());
        Row { name: name[0], arguments, passing }
    };
    lines.map(row).collect()
}

/// Runs a command in a folder with its inputs.
fn sage(root: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
    command.current_dir(root).args(arguments).env_remove("SAGE_WEIGHTS").stdin(Stdio::null());
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked") && output.status.code().is_some(), "{arguments:?}: {said}");
    output
}

/// Runs a command that must succeed.
fn done(root: &Path, arguments: &[&str]) {
    let output = sage(root, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A folder with the inputs of all commands, and what lies outside of their outputs: files and folders, which links name.
fn prepared() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    done(root, &["scenes", "--count", "2", "--format", "pickle", "--out", "scenes"]);
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    fs::write(root.join("quick.json"), r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    let weights = project.join("weights/procedural").display().to_string();
    fs::write(root.join("recipe.yml"), recipe::linear(&weights)).unwrap();
    fs::copy(project.join("examples/crossing.pkl"), root.join("crossing.pkl")).unwrap();
    fs::create_dir_all(root.join("outside/folder/deep")).unwrap();
    for name in ["file", "folder/file", "folder/deep/file"] {
        fs::write(root.join("outside").join(name), "precious").unwrap();
    }
    folder
}

/// All files and folders below a folder, links not followed, with the content of files.
fn listing(root: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let kind = path.symlink_metadata().unwrap().file_type();
            if kind.is_dir() {
                open.push(path.clone());
            }
            let content = kind.is_file().then(|| fs::read(&path).unwrap());
            found.insert(path.strip_prefix(root).unwrap().to_owned(), content);
        }
    }
    found
}

/// Puts links at names in a new output folder. Names below the name of another link are left out.
fn put_links(out: &Path, names: &[PathBuf], target: &Path) {
    for name in names {
        let path = out.join(name);
        if path.ancestors().skip(1).take_while(|above| *above != out).any(Path::is_symlink) {
            continue;
        }
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
    }
}

fn check(row: &Row) {
    let folder = prepared();
    let root = folder.path();
    // Names that an uninterrupted run leaves, files and folders apart, and those that pass.
    done(root, &[&row.arguments[..], &["--out", "whole"]].concat());
    let [mut files, mut folders] = [BTreeSet::new(), BTreeSet::new()];
    for (name, content) in listing(&root.join("whole")) {
        if content.is_some() { &mut files } else { &mut folders }.insert(name);
    }
    let passing: Vec<PathBuf> = row.passing.iter().map(|name| name.trim_end_matches('/').into()).collect();
    files.extend(row.passing.iter().filter(|name| !name.ends_with('/')).map(PathBuf::from));
    let files: Vec<PathBuf> = files.into_iter().collect();
    let (outside, lock) = (root.join("outside"), PathBuf::from(".sage-lock"));
    let before = listing(&outside);
    let (file, inner, none) = (outside.join("file"), outside.join("folder"), outside.join("none"));
    // A link is replaced by the output, or removed.
    let mut attacks = vec![
        (files.clone(), &file, true),
        (files.clone(), &inner, true),
        (files.clone(), &none, true),
        (files, &file, false),
        (vec![lock.clone()], &file, true),
    ];
    // One at a time: the first that is refused ends the run.
    attacks.extend(folders.into_iter().chain(passing).chain([lock]).map(|one| (vec![one], &inner, true)));
    for (number, (names, target, force)) in attacks.into_iter().enumerate() {
        let out = format!("out-{number}");
        fs::create_dir(root.join(&out)).unwrap();
        put_links(&root.join(&out), &names, target);
        let more: &[&str] = if force { &["--force"] } else { &[] };
        let output = sage(root, &[&row.arguments[..], &["--out", &out], more].concat());
        assert_eq!(listing(&outside), before, "{}: {names:?} as links to {}", row.name, target.display());
        assert!(
            number > 0 || output.status.success(),
            "{}: {}",
            row.name,
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

fn is_long(row: &Row) -> bool {
    ["pretrain", "finetune", "train-ego"].contains(&row.name)
}

fn has_folder(row: &Row) -> bool {
    !row.passing.iter().any(|name| name.starts_with('='))
}

#[test]
fn folders_of_short_commands() {
    rows().iter().filter(|row| has_folder(row) && !is_long(row)).for_each(check);
}

#[test]
fn folders_of_long_commands() {
    rows().iter().filter(|row| is_long(row)).for_each(check);
}

#[test]
fn single_output_files() {
    for row in rows().iter().filter(|row| !has_folder(row)) {
        let folder = prepared();
        let root = folder.path();
        let (file, before) = (row.passing[0].trim_start_matches('='), listing(&root.join("outside")));
        for target in ["file", "folder", "none"] {
            symlink(root.join("outside").join(target), root.join(file)).unwrap();
            sage(root, &[&row.arguments[..], &["--out", file, "--force"]].concat());
            assert_eq!(listing(&root.join("outside")), before, "{} with a link to {target}", row.name);
            fs::remove_file(root.join(file)).unwrap();
        }
    }
}

#[test]
fn an_unfinished_run_with_links_is_not_resumed_through_them() {
    let folder = prepared();
    let root = folder.path();
    let arguments = rows().into_iter().find(|row| row.name == "train-ego").unwrap().arguments;
    // A run that breaks off: its folder holds the record, checkpoints and rows.
    let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
    command.current_dir(root).args(&arguments).args(["--out", "run"]).env_remove("SAGE_WEIGHTS");
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !root.join("run/seed-0/buffer").is_dir() && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let before = listing(&root.join("outside"));
    let run = listing(&root.join("run"));
    for (number, name) in run.keys().filter(|name| !name.ends_with("run.json")).enumerate() {
        let copy = root.join(format!("copy-{number}"));
        for (name, content) in &run {
            let path = copy.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            content.iter().for_each(|content| fs::write(&path, content).unwrap());
        }
        let place = copy.join(name);
        let target = match place.is_dir() {
            true => fs::remove_dir_all(&place).map(|()| "folder"),
            false => Ok("file"),
        };
        let _ = fs::remove_file(&place);
        symlink(root.join("outside").join(target.unwrap()), &place).unwrap();
        sage(root, &[&arguments[..], &["--out", copy.to_str().unwrap()]].concat());
        assert_eq!(listing(&root.join("outside")), before, "{}", name.display());
    }
}
