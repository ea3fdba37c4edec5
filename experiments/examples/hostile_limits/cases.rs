//! Kinds of hostile files, and the commands that read them.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::scenes::{CRAFTED, crafted, to_file};
use flate2::{Compression, write::GzEncoder};
use sage_core::{scene::Scene, seed::Rng};
use sage_data::{Recording, womd};
use serde_json::json;

use crate::{
    bytes::{TensorFile, damaged, with_other_numbers},
    child::{self, Limits, Used},
    recipe,
};

/// Names of the kinds.
pub const KINDS: [&str; 10] =
    ["pickle", "native", "record", "gzip", "weights", "policy", "recipe", "checkpoint", "path", "candidates"];
/// Files of weights.
const WEIGHTS: [&str; 3] = ["prior", "realistic", "adversarial"];
/// A training run that takes a second.
const TRAIN: [&str; 12] = [
    "train-ego",
    "--procedural",
    "3",
    "--updates",
    "300",
    "--evaluations",
    "2",
    "--checkpoint-every",
    "100",
    "--method",
    "none",
    "--eval-method",
];
const TD3: [&str; 3] =
    ["none", "--config", r#"{"td3": {"hidden": [16, 16], "batch": 16, "random_steps": 200}}"#];
const PRETRAIN: [&str; 7] =
    ["pretrain", "scenes", "--epochs", "1", "--network", r#"{"hidden": 16, "rounds": 1}"#, "--dev"];

/// What all cases are made from.
pub struct Cases {
    program: PathBuf,
    root: PathBuf,
    scene: Scene,
    pickle: Vec<u8>,
    native: Vec<u8>,
    record: Vec<u8>,
}

/// Copies a file, or a folder with all it holds.
pub fn copy(from: &Path, to: &Path) {
    if !from.is_dir() {
        std::fs::copy(from, to).unwrap();
        return;
    }
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        copy(&entry.path(), &to.join(entry.file_name()));
    }
}

impl Cases {
    /// Makes the files that cases change, below a folder.
    pub fn new(program: &Path, root: &Path) -> Self {
        let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let base = root.join("base");
        copy(&project.join("weights/procedural"), &base.join("weights"));
        for file in ["crossing.pkl", "crossing.json"] {
            copy(&project.join("examples").join(file), &base.join(file));
        }
        let pickle = std::fs::read(base.join("crossing.pkl")).unwrap();
        let recording = Recording::read(&base.join("crossing.pkl")).unwrap();
        let (native, record) = (recording.to_native().unwrap(), recording.to_scenario().unwrap().data);
        let scene = recording.scene;
        let drive: Vec<_> = (0..scene.frames)
            .map(|f| json!([scene.ego().point(f)[0], scene.ego().point(f)[1], 0.0]))
            .collect();
        std::fs::write(base.join("drive.json"), json!({"crossing": drive}).to_string()).unwrap();
        std::fs::write(base.join("recipe.yaml"), recipe::linear("weights")).expect("the folder is our own");
        let cases =
            Self { program: program.to_owned(), root: root.to_owned(), scene, pickle, native, record };
        cases.prepare_runs();
        cases
    }

    /// Folder of the present case.
    pub fn folder(&self) -> PathBuf {
        self.root.join("case")
    }

    /// Unfinished runs of `train-ego` and `pretrain`.
    fn prepare_runs(&self) {
        let base = self.root.join("base");
        let start = |arguments: &[&str]| {
            let mut command = Command::new(&self.program);
            command.args(arguments).current_dir(&base).env_remove("SAGE_WEIGHTS");
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
        };
        assert!(start(&["scenes", "--count", "2", "--out", "scenes"]).wait().unwrap().success());
        let mut child = start(&[&TRAIN[..], &TD3, &["--threads", "1", "--out", "run"]].concat());
        while !base.join("run/seed-0/checkpoint.safetensors").is_file() {
            assert!(child.try_wait().unwrap().is_none(), "the run ended before its first checkpoint");
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let pretrain = [&PRETRAIN[..], &["scenes", "--threads", "1", "--out", "pretrained"]].concat();
        assert!(start(&pretrain).wait().unwrap().success());
        // The record says that the run is not done, so its checkpoint is read.
        let record = base.join("pretrained/run.json");
        let mut fields: serde_json::Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
        fields["seconds"] = serde_json::Value::Null;
        std::fs::write(record, fields.to_string()).unwrap();
        std::fs::remove_file(base.join("pretrained/prior.safetensors")).unwrap();
    }

    /// Makes the file of a number and runs the commands that read it.
    ///
    /// *Errors*: what a run did that it must not do.
    pub fn run(&self, kind: &str, seed: u64, number: u64, limits: &Limits) -> Result<Vec<Used>, String> {
        let mut rng = Rng::new(seed, &format!("{kind} {number}"), "hostile limits");
        let (case, base) = (self.folder(), self.root.join("base"));
        let _ = std::fs::remove_dir_all(&case);
        std::fs::create_dir_all(case.join("outside")).unwrap();
        std::fs::write(case.join("outside/precious"), "precious").unwrap();
        let read = |name: &str| std::fs::read(base.join(name)).unwrap();
        let mut runs: Vec<(Vec<&str>, bool)> = Vec::new();
        let (name, bytes) = match kind {
            "pickle" | "native" | "record" | "gzip" => {
                let name = match kind {
                    "pickle" => "scene.pkl",
                    "native" => "scene.safetensors",
                    "record" => "scene.tfrecord",
                    _ => "scene.tfrecord.gz",
                };
                runs.push((vec!["inspect", name], true));
                runs.push((vec!["draw", name, "--out", "out.svg"], true));
                runs.push((vec!["generate", name, "--weights", "procedural", "--out", "out"], true));
                runs.push((vec!["simulate", name, "--ego", "idm", "--out", "driven"], true));
                (name, self.scene_file(kind, number, &mut rng))
            }
            "weights" => {
                copy(&base.join("weights"), &case.join("weights"));
                copy(&base.join("recipe.yaml"), &case.join("recipe.yaml"));
                copy(&base.join("crossing.pkl"), &case.join("crossing.pkl"));
                runs.push((
                    vec!["generate", "crossing.pkl", "--weights", "weights", "--lambda", "1", "--out", "out"],
                    true,
                ));
                runs.push((vec!["merge", "recipe.yaml", "--out", "merged"], false));
                let name = [
                    "weights/prior.safetensors",
                    "weights/realistic.safetensors",
                    "weights/adversarial.safetensors",
                ][rng.below(WEIGHTS.len())];
                (name, tensor_file(&read(name), &mut rng))
            }
            "policy" => {
                copy(&base.join("crossing.pkl"), &case.join("crossing.pkl"));
                runs.push((
                    vec!["simulate", "crossing.pkl", "--ego", "td3:p.safetensors", "--out", "out"],
                    true,
                ));
                ("p.safetensors", tensor_file(&read("weights/td3.safetensors"), &mut rng))
            }
            "recipe" => {
                copy(&base.join("weights"), &case.join("weights"));
                runs.push((vec!["merge", "recipe.yaml", "--out", "out"], false));
                ("recipe.yaml", text_file(&read("recipe.yaml"), &mut rng))
            }
            "checkpoint" if number.is_multiple_of(4) => {
                copy(&base.join("pretrained"), &case.join("pretrained"));
                copy(&base.join("scenes"), &case.join("scenes"));
                runs.push(([&PRETRAIN[..], &["scenes", "--out", "pretrained"]].concat(), false));
                let name = ["pretrained/last.safetensors", "pretrained/run.json"][rng.below(2)];
                let whole = read(name);
                (
                    name,
                    if name.ends_with(".json") {
                        text_file(&whole, &mut rng)
                    } else {
                        tensor_file(&whole, &mut rng)
                    },
                )
            }
            "checkpoint" => {
                copy(&base.join("run"), &case.join("run"));
                runs.push(([&TRAIN[..], &TD3, &["--out", "run"]].concat(), false));
                let name = ["run/seed-0/checkpoint.safetensors", "run/seed-0/buffer/000000000000.rows"]
                    [usize::from(rng.below(8) == 0)];
                let whole = read(name);
                (
                    name,
                    if name.ends_with(".rows") {
                        damaged(whole, &mut rng)
                    } else {
                        tensor_file(&whole, &mut rng)
                    },
                )
            }
            "path" => {
                copy(&base.join("crossing.pkl"), &case.join("crossing.pkl"));
                let ego = ["generate", "crossing.pkl", "--ego", "path:drive.json", "--weights", "procedural"];
                runs.push(([&ego[..], &["--lambda", "1", "--out", "out"]].concat(), true));
                ("drive.json", text_file(&read("drive.json"), &mut rng))
            }
            _ => {
                copy(&base.join("crossing.pkl"), &case.join("crossing.pkl"));
                let candidates = ["crossing.pkl", "--candidates", "c.json"];
                runs.push(([&["score"], &candidates[..], &["--avoidable"]].concat(), false));
                runs.push(([&["draw"], &candidates[..], &["--out", "out.svg"]].concat(), true));
                ("c.json", text_file(&read("crossing.json"), &mut rng))
            }
        };
        std::fs::write(case.join(name), &bytes).unwrap();
        let mut all = Vec::with_capacity(runs.len());
        for (arguments, is_timed) in runs {
            let used = child::run(&self.program, &case, &arguments, bytes.len() as u64, is_timed, limits)?;
            all.push(used);
            if std::fs::read(case.join("outside/precious")).ok().as_deref() != Some(b"precious")
                || std::fs::read_dir(case.join("outside")).unwrap().count() != 1
            {
                return Err(format!("`sage {}` writes outside its output", arguments.join(" ")));
            }
        }
        Ok(all)
    }

    /// A damaged or crafted scene in a format.
    fn scene_file(&self, kind: &str, number: u64, rng: &mut Rng) -> Vec<u8> {
        // Crafted scenes come first, so that a short run has each.
        let is_crafted = number < CRAFTED as u64 || rng.below(4) == 0;
        let made = is_crafted.then(|| {
            let which = if number < CRAFTED as u64 { number as usize } else { rng.below(CRAFTED) };
            crafted(&self.scene, which, rng)
        });
        match (kind, made) {
            ("pickle", Some(scene)) => to_file(scene, false),
            ("native", Some(scene)) => to_file(scene, true),
            ("pickle", None) => damaged(self.pickle.clone(), rng),
            ("native", None) if rng.below(2) == 0 => damaged(self.native.clone(), rng),
            ("native", None) => {
                let mut file = TensorFile::of(&self.native);
                file.spoil_numbers(rng);
                file.to_bytes()
            }
            (_, made) => {
                let encoded =
                    |scene| Recording::procedural(scene).to_scenario().map(|scenario| scenario.data);
                let data = made.and_then(|scene| encoded(scene).ok()).unwrap_or_else(|| self.record.clone());
                let shard = match rng.below(6) {
                    0 => womd::frame(b"").repeat(rng.below(40_000)),
                    1 => womd::frame(&[0x2a, 1, b'x']).repeat(rng.below(30_000)),
                    2 => damaged(womd::frame(&data), rng),
                    3 => [womd::frame(&data), womd::frame(&damaged(data.clone(), rng)), womd::frame(&data)]
                        .concat(),
                    4 => womd::frame(&vec![0; rng.below(32 << 20)]),
                    _ => womd::frame(&damaged(data, rng)),
                };
                if kind == "record" { shard } else { compressed(&shard, rng) }
            }
        }
    }
}

/// Compressed bytes, now and then damaged.
fn compressed(bytes: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes).unwrap();
    let zipped = out.finish().unwrap();
    if rng.below(4) == 0 { damaged(zipped, rng) } else { zipped }
}

/// A damaged text, or one with other numbers.
fn text_file(whole: &[u8], rng: &mut Rng) -> Vec<u8> {
    if rng.below(3) == 0 {
        return damaged(whole.to_vec(), rng);
    }
    with_other_numbers(&String::from_utf8_lossy(whole), rng).into_bytes()
}

/// Weights, a policy or a checkpoint: damaged, or crafted with the right hash.
fn tensor_file(whole: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut file = TensorFile::of(whole);
    match rng.below(4) {
        0 => return damaged(whole.to_vec(), rng),
        1 => file.spoil_numbers(rng),
        2 => file.json = String::from_utf8_lossy(&damaged(file.json.clone().into_bytes(), rng)).into_owned(),
        _ => file.json = with_other_numbers(&file.json, rng),
    }
    file.to_bytes()
}
