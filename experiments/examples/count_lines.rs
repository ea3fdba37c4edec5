//! Lines of Rust by crate: code, tests, documentation, and the rest (blank lines and comments).
//!
//! `cargo run --release -p experiments --example count_lines [ROOT]` counts the working tree, or that of another checkout.
#![allow(clippy::print_stdout)] // It prints a table.

use std::{
    collections::BTreeMap,
    env,
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
};

/// Lines of code, tests, documentation, and the rest.
type Counts = [usize; 4];

/// What a file adds. A file of tests, and what follows `#[cfg(test)]` on a module, are tests as a whole.
fn lines_of(path: &Path, text: &str) -> Counts {
    let mut is_test =
        path.iter().any(|part| ["tests", "benches", "tests.rs"].map(OsStr::new).contains(&part));
    let mut counts = Counts::default();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        is_test |= line == "#[cfg(test)]" && lines.peek().is_some_and(|next| next.ends_with('{'));
        let trimmed = line.trim_start();
        let kind = match trimmed {
            _ if is_test => 1,
            _ if trimmed.starts_with("///") || trimmed.starts_with("//!") => 2,
            _ if trimmed.is_empty() || trimmed.starts_with("//") => 3,
            _ => 0,
        };
        counts[kind] += 1;
    }
    counts
}

/// Adds the files of a folder to the crate that they belong to: the nearest folder above with a manifest.
fn add([root, folder]: [&Path; 2], owner: &str, all: &mut BTreeMap<String, Counts>) -> io::Result<()> {
    let is_crate = folder.join("Cargo.toml").exists();
    let name = folder.file_name().and_then(|name| name.to_str()).filter(|_| is_crate).unwrap_or(owner);
    for entry in fs::read_dir(folder)? {
        let path: PathBuf = entry?.path();
        let is_hidden =
            path.file_name().is_some_and(|name| name == "target" || name.to_string_lossy().starts_with('.'));
        if path.is_dir() && !is_hidden {
            add([root, &path], name, all)?;
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let counts = lines_of(path.strip_prefix(root).unwrap_or(&path), &fs::read_to_string(&path)?);
            let sum = all.entry(name.to_owned()).or_default();
            (0..4).for_each(|k| sum[k] += counts[k]);
        }
    }
    Ok(())
}

fn row(name: &str, counts: Counts) {
    let [code, tests, docs, rest] = counts;
    println!("{name:<16}{code:>8}{tests:>8}{docs:>8}{rest:>8}{:>9}", counts.iter().sum::<usize>());
}

fn main() -> io::Result<()> {
    let root =
        env::args().nth(1).map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join(".."), PathBuf::from);
    let mut all = BTreeMap::new();
    add([&root, &root], "(root)", &mut all)?;
    println!("{:<16}{:>8}{:>8}{:>8}{:>8}{:>9}", "crate", "code", "tests", "docs", "rest", "sum");
    let mut sum = Counts::default();
    for (name, counts) in all {
        (0..4).for_each(|k| sum[k] += counts[k]);
        row(&name, counts);
    }
    row("sum", sum);
    Ok(())
}
