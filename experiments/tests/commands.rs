//! Commands as a tour: the commands on each page of `tests/commands` are run in their order, and what one prints stands below it.
//!
//! `TRYCMD=overwrite cargo test --release -p experiments --test commands` writes what is printed into the pages, and
//! `cargo test --release -p experiments --test commands -- commands trycmd=search` runs those with `search` in their name.

#![cfg(unix)]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;
mod recordings;

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
};

use program::redacted;

/// Programs that pages use besides `sage`.
const TOOLS: [&str; 11] = ["cat", "cmp", "cp", "diff", "grep", "ls", "mkdir", "rm", "sed", "sh", "test"];

fn pages() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/commands");
    let mut pages: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    pages.retain(|page| page.extension().is_some_and(|ending| ending == "md"));
    pages
}

/// A page in a folder, with what its commands begin with: `examples` and `weights` as in the project, and the files that it shows, which
/// stand in fences with their name, such as `yaml study.yaml`.
fn prepare(page: &Path, folder: &Path) {
    let name = page.file_stem().unwrap().to_str().unwrap();
    let input = folder.join(format!("{name}.in"));
    fs::create_dir_all(&input).unwrap();
    // An empty folder of what is to be there has the commands run in a copy of the input.
    fs::create_dir(folder.join(format!("{name}.out"))).unwrap();
    symlink(page, folder.join(format!("{name}.md"))).unwrap();
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    for shared in ["examples", "weights"] {
        symlink(project.join(shared), input.join(shared)).unwrap();
    }
    let text = fs::read_to_string(page).unwrap();
    // One that is not known would be left out in silence.
    for program in text.lines().filter_map(|line| line.strip_prefix("$ ")?.split(' ').next()) {
        assert!(
            program == "sage" || TOOLS.contains(&program),
            "{name}.md: `{program}` is no program of pages"
        );
    }
    for block in text.split("\n```").skip(1).step_by(2) {
        let (info, rest) = block.split_once('\n').unwrap();
        if let Some((_, file)) = info.split_once(' ') {
            fs::write(input.join(file), format!("{rest}\n")).unwrap();
        }
    }
    if name == "recordings" {
        recordings::write(&input);
    }
}

#[test]
fn commands_print_what_the_pages_show() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let pages = pages();
    pages.iter().for_each(|page| prepare(page, folder.path()));
    let sage = Path::new(env!("CARGO_BIN_EXE_sage"));
    let path = std::env::var("PATH").unwrap();
    let tool = |name: &str| {
        let places = path.split(':').map(|place| Path::new(place).join(name));
        places.into_iter().find(|file| file.is_file()).unwrap_or_else(|| panic!("{name} is not in PATH"))
    };
    let cases = trycmd::TestCases::new();
    for name in TOOLS {
        cases.register_bin(name, trycmd::schema::Bin::Path(tool(name)));
    }
    cases
        .register_bin("sage", trycmd::schema::Bin::Path(sage.to_owned()))
        .env("COLUMNS", "100")
        .env("LC_ALL", "C")
        .env("PATH", format!("{}:{path}", sage.parent().unwrap().display()))
        .case(folder.path().join("*.md"))
        .run();
    if std::env::var_os("TRYCMD").is_some_and(|mode| mode == "overwrite") {
        pages.iter().for_each(|page| hide_what_differs(page));
    }
}

#[test]
fn the_study_of_the_tour_is_that_of_the_page_about_benchmarks() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let [page, tour] = ["../docs/benchmarks.md", "tests/commands/own-study.md"]
        .map(|file| fs::read_to_string(folder.join(file)).unwrap());
    let study = page.split("```yaml\n").nth(1).unwrap().split("```").next().unwrap();
    assert!(tour.contains(&format!("```yaml calm.yaml\n{study}```")));
}

/// What differs between runs and machines in what was written into a page becomes `[..]`, which stands for anything.
fn hide_what_differs(page: &Path) {
    let mut text = redacted(&fs::read_to_string(page).unwrap());
    for placeholder in ["[time]", "[number]", "[version]", "[hash]"] {
        text = text.replace(placeholder, "[..]");
    }
    fs::write(page, text).unwrap();
}
