//! Verbs of scripts that make files.

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use sage_backbones::{Parameters, candle::DType};
use sage_data::{Recording, womd};
use serde_json::json;

use crate::{
    hostile,
    mutants::{
        formats::records,
        tables::{TensorFile, changed},
    },
};

/// Loads a pickle as a careless program does, with an empty module in place of numpy.
const LOAD: &str = "
import pickle, sys, types
class Anything:
    def __init__(self, *arguments): pass
    def __setstate__(self, state): pass
for name in ('numpy', 'numpy.core', 'numpy.core.multiarray'):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__getattr__ = lambda name: Anything
pickle.load(open(sys.argv[1], 'rb'))
";

/// Makes a file below a folder by a verb and its words.
pub fn file(root: &Path, verb: &str, words: &[&str]) -> Result<(), String> {
    let at = |name: &str| root.join(name);
    let read = |name: &str| fs::read(shipped(root, name)).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        fs::create_dir_all(at(name).parent().unwrap()).unwrap();
        fs::write(at(name), bytes).unwrap();
    };
    match (verb, words) {
        // A file or folder of the project, or of the script.
        ("copy", [from, to]) => copy(&shipped(root, from), &at(to)),
        ("write", [name, text]) => write(name, text.as_bytes()),
        ("dir", [name]) => fs::create_dir_all(at(name)).unwrap(),
        ("remove", [name]) => fs::remove_file(at(name)).unwrap(),
        ("move", [from, to]) => fs::rename(at(from), at(to)).unwrap(),
        ("link", [target, name]) => symlink(at(target), at(name)).unwrap(),
        ("pipe", [name]) => assert!(Command::new("mkfifo").arg(at(name)).status().unwrap().success()),
        // A file of a size, without content.
        ("holes", [name, size]) => {
            fs::File::create(at(name)).unwrap().set_len(size.parse().unwrap()).unwrap()
        }
        // Another value in a place of JSON, weights, a policy or a native scene.
        ("set", [name, place, value]) => write(name, &changed(&read(name), place, value)),
        ("unhash", [name]) => write(name, &TensorFile::of(&read(name)).without_hash().to_bytes()),
        // The first number of every tensor: finite, and too large for what is computed with it.
        ("overflow", [name]) => {
            let whole = read(name);
            let large = |bytes: Vec<u8>, tensor: &str| changed(&bytes, &format!("{tensor}@0"), "3e38");
            write(name, &TensorFile::of(&whole).names().fold(whole.clone(), large));
        }
        ("flip", [name, byte]) => {
            let mut bytes = read(name);
            let byte = byte.parse::<usize>().unwrap();
            bytes[byte] ^= 1;
            write(name, &bytes);
        }
        ("cut", [name, length]) => write(name, &read(name)[..length.parse::<usize>().unwrap()]),
        ("as", [name, "F64"]) => {
            let (parameters, header) = Parameters::load(&at(name)).unwrap();
            parameters.to_dtype(DType::F64).unwrap().save(&header, &at(name)).unwrap();
        }
        // The shipped scene with another id, or another position of a track in a frame.
        ("scene", [name, "id", id]) => {
            scene(&at(name), |scene| scene.id = id.replace("LONG", &"x".repeat(3000)))
        }
        ("scene", [name, track, frame, x]) => scene(&at(name), |scene| {
            let track = scene.tracks.iter_mut().find(|found| found.id == *track).unwrap();
            track.position[frame.parse::<usize>().unwrap()] = [x.parse().unwrap(), 0.0, 0.0];
        }),
        // The drive of the shipped scene, with another x in a frame, for one scene or for all.
        ("drive", [name, id, frame, x]) => write(name, drive(id, frame, x).as_bytes()),
        // A candidate from an x by steps, and the ego's path by the same.
        ("candidate", [name, numbers @ ..]) => write(name, candidate(numbers).as_bytes()),
        ("recipe", [name, weights]) => {
            let model =
                |part| format!("  - model: {weights}/{part}.safetensors\n    parameters: {{weight: 0.5}}\n");
            let models = model("realistic") + &model("adversarial");
            write(name, format!("merge_method: linear\nbase_model: {weights}\nmodels:\n{models}").as_bytes());
        }
        ("summary", [folder, files @ ..]) => {
            let files: Vec<(&str, &str)> =
                files.iter().map(|file| file.split_once('=').unwrap_or((file, ""))).collect();
            hostile::summary(&at(folder), &files);
        }
        // A file that another reader runs: it makes `marker`.
        ("program", [name, kind]) => {
            let (example, marker) = (shipped(root, "examples/crossing.pkl"), at("marker"));
            let made = if *kind == "memo" { hostile::memo } else { hostile::polyglot };
            write(name, &made(&example, &marker));
            if Command::new("python3").args(["-I", "-c", LOAD]).arg(at(name)).output().is_ok() {
                fs::remove_file(&marker).map_err(|_| "it does nothing to Python".to_owned())?;
            }
        }
        // A shard with one record, and one with a wrong bit in a record.
        ("record", [name, message]) => write(name, &womd::frame(message.as_bytes())),
        ("break", [name, number]) => {
            let mut records = records(&read(name));
            records[number.parse::<usize>().unwrap()][500] ^= 1;
            write(name, &records.concat());
        }
        // A native scene whose source has an opcode that there is not.
        ("source", [name]) => {
            let mut native =
                Recording::read(&shipped(root, "examples/crossing.pkl")).unwrap().to_native().unwrap();
            let source = native.windows(3).rposition(|w| w == b"\x80\x04}").unwrap();
            native[source + 2] = 0xff;
            write(name, &native);
        }
        _ => return Err("it is no verb".to_owned()),
    }
    Ok(())
}

/// A file of the script, or one of the project.
fn shipped(root: &Path, name: &str) -> PathBuf {
    let own = root.join(name);
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    if own.symlink_metadata().is_ok() { own } else { project.join(name) }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    if !from.is_dir() {
        fs::copy(from, to).unwrap();
        return;
    }
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        copy(&entry.path(), &to.join(entry.file_name()));
    }
}

fn scene(file: &Path, change: impl FnOnce(&mut sage_core::scene::Scene)) {
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    let mut recording = Recording::read(&shipped(Path::new(""), "examples/crossing.pkl")).unwrap();
    change(&mut recording.scene);
    recording.write(file).unwrap();
}

fn drive(id: &str, frame: &str, x: &str) -> String {
    let scene = Recording::read(&shipped(Path::new(""), "examples/crossing.pkl")).unwrap().scene;
    let mut drive: Vec<[f64; 3]> =
        (0..scene.frames).map(|f| [scene.ego().point(f)[0], scene.ego().point(f)[1], 0.0]).collect();
    let good = drive.clone();
    drive[frame.parse::<usize>().unwrap()][0] = x.parse().unwrap();
    if id == "all" { json!(drive).to_string() } else { json!({"crossing": good, id: drive}).to_string() }
}

fn candidate(numbers: &[&str]) -> String {
    let numbers: Vec<f64> = numbers.iter().map(|number| number.parse().unwrap()).collect();
    let near = Recording::read(&shipped(Path::new(""), "examples/crossing.pkl")).unwrap().scene;
    let lines: Vec<Vec<[f64; 2]>> = numbers
        .chunks(2)
        .map(|pair| {
            (0..80).map(|k| [near.adversary().unwrap().point(10)[0] + pair[0] + pair[1] * f64::from(k), 0.0])
        })
        .map(Iterator::collect)
        .collect();
    json!([{"name": "c", "trajectory": lines[0], "ego": lines.get(1)}]).to_string()
}
