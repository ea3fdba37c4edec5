//! Kinds of hostile files, and the commands that read them: the rows of `kinds.table`.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use flate2::{Compression, write::GzEncoder};
use sage_core::{scene::Scene, seed::Rng};
use sage_data::{Recording, womd};
use serde_json::json;

use crate::{
    child::{self, Limits, Used},
    mutants::{damage, formats::lines, tables::TensorFile},
    recipe,
    scenes::{CRAFTED, crafted, to_file},
};

/// Kind, file, what lies beside it, and commands.
type Row = [&'static str; 4];

fn rows() -> Vec<Row> {
    lines(include_str!("kinds.table")).collect()
}

/// Names of the kinds.
pub fn kinds() -> Vec<&'static str> {
    let mut kinds: Vec<&str> = rows().iter().map(|row| row[0]).collect();
    kinds.dedup();
    kinds
}

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
        for file in ["calm.yaml", "driven.yaml", "found.yaml", "planner"] {
            copy(&project.join("experiments/examples/hostile_limits").join(file), &base.join(file));
        }
        let cases =
            Self { program: program.to_owned(), root: root.to_owned(), scene, pickle, native, record };
        cases.prepare_runs();
        cases
    }

    /// Folder of the present case.
    pub fn folder(&self) -> PathBuf {
        self.root.join("case")
    }

    /// A suite, answers of a planner, and unfinished runs of `train-ego` and `pretrain`, by the commands of the table.
    fn prepare_runs(&self) {
        let base = self.root.join("base");
        let start = |words: &str| {
            let mut command = Command::new(&self.program);
            command
                .args(words.split(' '))
                .args(["--threads", "1"])
                .current_dir(&base)
                .env_remove("SAGE_WEIGHTS");
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
        };
        let of = |folder: &str| rows().into_iter().find(|row| row[2].starts_with(folder)).expect(folder)[3];
        let finish = |words: &str| assert!(start(words).wait().unwrap().success(), "sage {words}");
        finish("scenes --count 2 --out scenes");
        finish("search crossing.pkl --ego idm --budget 8 --out failures");
        finish("suite failures --out suite");
        // Without a file of answers, the planner writes its own.
        finish(of("crossing.pkl planner"));
        let mut child = start(of("run"));
        while !base.join("run/seed-0/checkpoint.safetensors").is_file() {
            assert!(child.try_wait().unwrap().is_none(), "the run ended before its first checkpoint");
        }
        child.kill().unwrap();
        child.wait().unwrap();
        finish(of("pretrained"));
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
        let rows: Vec<Row> = rows().into_iter().filter(|row| row[0] == kind).collect();
        let [_, name, beside, commands] = rows[rng.below(rows.len())];
        let (case, base) = (self.folder(), self.root.join("base"));
        let _ = std::fs::remove_dir_all(&case);
        std::fs::create_dir_all(case.join("outside")).unwrap();
        std::fs::write(case.join("outside/precious"), "precious").unwrap();
        beside.split_whitespace().for_each(|name| copy(&base.join(name), &case.join(name)));
        let read = || std::fs::read(base.join(name)).unwrap();
        let bytes = match name.rsplit('.').next() {
            _ if name.starts_with("scene.") => self.scene_file(kind, number, &mut rng),
            Some("safetensors") => tensor_file(read(), &mut rng),
            Some("scene") => damaged(read(), &mut rng),
            _ => damaged_text(read(), &mut rng),
        };
        std::fs::write(case.join(name), &bytes).unwrap();
        let mut all = Vec::new();
        for command in commands.split(';') {
            let (words, is_timed) = (command.trim_start_matches('!'), command.starts_with('!'));
            let words: Vec<&str> = words.split(' ').collect();
            all.push(child::run(&self.program, &case, &words, bytes.len() as u64, is_timed, limits)?);
            if std::fs::read(case.join("outside/precious")).ok().as_deref() != Some(b"precious")
                || std::fs::read_dir(case.join("outside")).unwrap().count() != 1
            {
                return Err(format!("`sage {command}` writes outside its output"));
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
            ("pickle" | "native", Some(scene)) => to_file(scene, kind == "native"),
            ("pickle", None) => damaged(self.pickle.clone(), rng),
            ("native", None) => tensor_file(self.native.clone(), rng),
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

fn damaged(mut bytes: Vec<u8>, rng: &mut Rng) -> Vec<u8> {
    damage::any(&mut bytes, rng);
    bytes
}

/// A text: damaged anywhere, or in a value alone.
fn damaged_text(mut bytes: Vec<u8>, rng: &mut Rng) -> Vec<u8> {
    if rng.below(3) == 0 {
        return damaged(bytes, rng);
    }
    damage::value(&mut bytes, rng);
    bytes
}

/// A safetensors file: damaged, or with other numbers or another header and the right hash.
fn tensor_file(whole: Vec<u8>, rng: &mut Rng) -> Vec<u8> {
    let mut file = TensorFile::of(&whole);
    match rng.below(3) {
        0 => return damaged(whole, rng),
        1 => damage::numbers(&mut file.data, rng),
        _ => file.json = String::from_utf8_lossy(&damaged(file.json.into_bytes(), rng)).into_owned(),
    }
    file.to_bytes()
}
