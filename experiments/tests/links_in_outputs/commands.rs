//! Every command that writes, as small as it can be, and what it writes only for a while.

use std::path::Path;

use crate::recipe;

/// Makes the inputs of all commands; `sage` runs a command in `root`.
pub fn prepare(root: &Path, sage: &dyn Fn(&[&str])) {
    sage(&["scenes", "--count", "2", "--format", "pickle", "--out", "scenes"]);
    std::fs::write(root.join("quick.json"), r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let weights = weights.canonicalize().unwrap().display().to_string();
    std::fs::write(root.join("recipe.yml"), recipe::linear(&weights)).unwrap();
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.json"),
        root.join("c.json"),
    )
    .unwrap();
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"),
        root.join("crossing.pkl"),
    )
    .unwrap();
}

/// A training run that takes a second.
pub const TRAIN_EGO: &[&str] = &[
    "train-ego",
    "--procedural",
    "3",
    "--updates",
    "600",
    "--evaluations",
    "2",
    "--checkpoint-every",
    "100",
    "--eval-method",
    "none",
    "--config",
    r#"{"td3": {"hidden": [16, 16], "batch": 16, "random_steps": 200}}"#,
];

/// Name, arguments without the output, and names that exist only for a while or in other runs. Names of folders end in
/// `/`.
pub type Row = (&'static str, &'static [&'static str], &'static [&'static str]);

/// Commands with an output folder.
pub const COMMANDS: &[Row] = &[
    ("demo", &["demo"], &[]),
    ("scenes", &["scenes", "--count", "2"], &[]),
    (
        "convert",
        &["convert", "scenes", "--to", "native"],
        &["dataset_summary.pkl", "dataset_mapping.pkl", "run.json"],
    ),
    ("convert to pickles", &["convert", "scenes", "--to", "pickle"], &[]),
    ("convert to shards", &["convert", "scenes", "--to", "womd", "--scenes-per-file", "1"], &["ids.json"]),
    ("convert to scenarios", &["convert", "scenes", "--to", "openscenario"], &[]),
    (
        "pretrain",
        &[
            "pretrain",
            "scenes",
            "--dev",
            "scenes",
            "--epochs",
            "1",
            "--network",
            r#"{"hidden": 16, "rounds": 1}"#,
        ],
        &["last.safetensors"],
    ),
    (
        "finetune",
        &["finetune", "scenes", "--roles", "0", "--config", "quick.json"],
        &["adversarial.state", "realistic.state", "dial.json"],
    ),
    ("merge", &["merge", "recipe.yml"], &[]),
    ("generate", &["generate", "scenes", "--weights", "procedural", "--lambda", "1"], &[]),
    ("simulate", &["simulate", "scenes", "--ego", "idm"], &[]),
    ("train-ego", TRAIN_EGO, &["seed-0/buffer/", "seed-0/checkpoint.safetensors"]),
    (
        "open-loop",
        &["bench", "open-loop", "scenes", "--method", "rule,log", "--lambda", "1"],
        &[".sage-rows/", ".sage-rows/000000.json"],
    ),
    ("drivers", &["bench", "drivers", "scenes", "--ego", "idm", "--unattacked"], &[]),
    ("front", &["bench", "front", "scenes", "--weights", "procedural", "--method", "rule"], &[]),
    (
        "latest-start",
        &["bench", "latest-start", "scenes", "--weights", "procedural", "--method", "rule"],
        &[],
    ),
    ("dial", &["bench", "dial", "scenes", "--weights", "procedural"], &[]),
    ("closed-loop", &["bench", "closed-loop", "scenes", "--ego", "idm", "--method", "rule"], &[]),
    ("connectivity", &["analyse", "connectivity", "--weights", "procedural"], &[]),
];

/// Commands with one output file: name, arguments without the output, file.
pub const FILES: &[(&str, &[&str], &str)] = &[
    ("draw", &["draw", "crossing.pkl"], "picture.svg"),
    ("predict", &["predict", "crossing.pkl", "--weights", "procedural"], "picture.svg"),
    ("calibrate", &["calibrate", "scenes", "--selection", "paper-selection"], "dial.json"),
];
