//! `examples/own-crate`: parts in a crate outside the workspace. `examples/library`: a program that depends on `advsage` alone.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use insta::assert_snapshot;
use program::*;

/// Copies the files of a crate, without what a build left there.
fn copy_crate(from: &Path, to: &Path) {
    fs::create_dir_all(to.join("src")).unwrap();
    fs::copy(from.join("Cargo.toml"), to.join("Cargo.toml")).unwrap();
    for file in fs::read_dir(from.join("src")).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), to.join("src").join(file.file_name())).unwrap();
    }
}

/// The program of a folder in `examples`, built from a copy elsewhere.
///
/// Versions, profile and target folder are those of this workspace, so that the crates of others are there already. cargo
/// builds those of `sage` again, because a path outside the workspace is another crate than a member. Without optimisation
/// that takes half a minute instead of minutes.
fn build_template(name: &str, folder: &Path) -> PathBuf {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let copy = folder.join(name);
    copy_crate(&project.join("examples").join(name), &copy);
    let manifest = fs::read_to_string(copy.join("Cargo.toml")).unwrap();
    // The command stands for its features: without them the libraries of others are built again.
    let command = "[dependencies]\nexperiments = { path = \"../../experiments\" }";
    let manifest = match manifest.contains("experiments =") {
        true => manifest,
        false => manifest.replace("[dependencies]", command),
    };
    fs::write(copy.join("Cargo.toml"), manifest.replace("../..", text(project))).unwrap();
    fs::copy(project.join("Cargo.lock"), copy.join("Cargo.lock")).unwrap();

    let workspace = fs::read_to_string(project.join("Cargo.toml")).unwrap();
    let profiles = &workspace[workspace.find("[profile.").unwrap()..];
    fs::create_dir(folder.join(".cargo")).unwrap();
    fs::write(folder.join(".cargo/config.toml"), profiles).unwrap();

    let built = Path::new(env!("CARGO_BIN_EXE_sage")).parent().unwrap();
    let profile = built.file_name().unwrap().to_str().unwrap().replace("debug", "dev");
    let members = workspace.lines().filter_map(|line| Some(line.split_once(" = { path = ")?.0));
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut build = Command::new(cargo);
    build.current_dir(&copy).args(["build", "--offline", "--profile", &profile]);
    build.arg("--target-dir").arg(built.parent().unwrap()).env("CARGO_INCREMENTAL", "0");
    for member in members.chain(["experiments"]) {
        build.arg("--config").arg(format!("profile.{profile}.package.{member}.opt-level=0"));
    }
    let output = build.output().unwrap();
    let said = stderr(&output);
    assert!(
        output.status.success() && !said.contains(&format!("`{name}` (bin")),
        "an error or a warning:\n{said}"
    );
    let is_ours = |line: &&str| line.contains(text(project)) || line.contains(text(folder));
    let others: Vec<&str> =
        said.lines().filter(|line| line.contains("Compiling") && !is_ours(line)).collect();
    // In the profile `dev` of the whole workspace it is one: a build dependency with less debug information.
    assert!(others.len() < 5, "built again, which may take minutes:\n{}", others.join("\n"));
    built.join(name)
}

fn crossing() -> String {
    example().replace("crossing.pkl", "crossing.json")
}

#[test]
fn a_copy_of_the_template_has_all_commands_and_its_own_parts() {
    let folder = tempfile::tempdir().unwrap();
    let program = build_template("own-crate", folder.path());
    assert_snapshot!(added(&program, &["list"]), @r"
    speed-up               how much faster the adversary is at the end
    steady                 constant speed along the route, brakes for nobody
                             options: speed = 6.0
    ");
    assert_snapshot!(added(&program, &["bench", "list"]), @"  top speed (m/s)              largest speed of the trajectory");
    let scored = rows(&run(&program, &["score", &example(), "--candidates", &crossing(), "--json"]));
    assert!(scored.iter().all(|row| row["rewards"]["speed-up"].is_f64()), "{scored:?}");
    let drives = folder.path().join("drives");
    let simulate = ["simulate", &example(), "--ego", r#"steady{"speed":4}"#, "--out", text(&drives)];
    let done = run(&program, &simulate);
    assert_snapshot!(stdout(&done).split(" (").next().unwrap(), @r#"crossing steady{"speed":4}: no contact"#);
}

#[test]
fn a_program_that_depends_on_advsage_alone_reads_attacks_drives_searches_and_draws() {
    let folder = tempfile::tempdir().unwrap();
    let program = build_template("library", folder.path());
    let drawing = folder.path().join("attacks.svg");
    let done = run(&program, &[&example(), text(&drawing)]);
    assert_snapshot!(stdout(&done), @r"
    attack on idm: true; contacts: 1
    failures of idm: 28 in 64 drives
    ");
    let svg = fs::read_to_string(&drawing).unwrap();
    assert!(["0.00", "0.50", "1.00"].iter().all(|label| svg.contains(label)), "a candidate is missing");
    let lines =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/library/src/main.rs"));
    assert!(lines.unwrap().lines().count() <= 40);
}
