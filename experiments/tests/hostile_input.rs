//! Scene files, data sets, weights and options from strangers: nothing runs, nothing is written outside of
//! the output folder, and what is wrong is said.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hostile;
mod program;

use std::{
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use program::*;
use sage_backbones::Parameters;
use sage_data::Recording;
use serde_json::Value;

/// A run that must not take long or much; the exit code and what it said.
fn quick(arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new("timeout");
    command.arg("60").arg(env!("CARGO_BIN_EXE_sage")).args(arguments);
    let output = command.env_remove("SAGE_WEIGHTS").stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().unwrap_or(-1), said)
}

fn has_python() -> bool {
    Command::new("python3").args(["-I", "-c", ""]).output().is_ok_and(|run| run.status.success())
}

/// Loads a pickle as a careless program does, with a stand-in for numpy.
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

#[test]
fn no_command_runs_what_is_in_a_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = PathBuf::from(example());
    let marker = at("marker");
    std::fs::create_dir(at("scenes")).unwrap();
    let files = [
        (at("scenes/memo.pkl"), hostile::memo(&scene, &marker)),
        (at("scenes/polyglot.pkl"), hostile::polyglot(&scene, &marker)),
    ];
    for (path, bytes) in &files {
        std::fs::write(path, bytes).unwrap();
        // They are what they claim to be: Python runs them.
        if has_python() {
            Command::new("python3").args(["-I", "-c", LOAD, text(path)]).output().unwrap();
            assert!(marker.exists(), "{} does nothing to Python", path.display());
            std::fs::remove_file(&marker).unwrap();
        }
    }
    let candidates = scene.with_extension("json").display().to_string();
    for (number, (path, _)) in files.iter().enumerate() {
        let file = text(path);
        let out = |name: &str| at(&format!("{name}-{number}")).display().to_string();
        let commands: Vec<Vec<String>> = [
            vec!["inspect", file],
            vec!["score", file, "--candidates", &candidates],
            vec!["draw", file, "--out", &out("picture.svg")],
            vec!["convert", file, "--to", "native", "--out", &out("native")],
            vec!["convert", file, "--to", "pickle", "--out", &out("pickle")],
            vec!["generate", file, "--weights", "procedural", "--out", &out("attacked")],
            vec!["predict", file, "--weights", "procedural"],
            vec!["pretrain", file, "--epochs", "1", "--out", &out("prior")],
            vec!["finetune", file, "--out", &out("experts")],
            vec!["calibrate", file, "--out", &out("dial.json")],
            vec!["bench", "speed", "--data", file, "--repeat", "1"],
            vec!["bench", "prediction", file],
            vec!["bench", "open-loop", file, "--methods", "log", "--out", &out("table")],
            vec!["bench", "dial", file, "--out", &out("dial")],
        ]
        .map(|command| command.into_iter().map(str::to_owned).collect())
        .into();
        for command in commands {
            let arguments: Vec<&str> = command.iter().map(String::as_str).collect();
            let (code, said) = quick(&arguments);
            assert_eq!(code, 1, "{command:?}: {said}");
            assert!(said.contains("is not allowed") || said.contains("at byte"), "{command:?}: {said}");
            assert!(!marker.exists(), "{command:?} ran the file");
        }
    }
    let (_, said) = quick(&["bench", "speed", "--data", text(&at("scenes")), "--repeat", "1"]);
    assert!(!marker.exists(), "{said}");
}

#[test]
fn python_is_given_what_we_wrote_and_runs_no_module_of_the_current_folder() {
    let folder = tempfile::tempdir().unwrap();
    let marker = folder.path().join("marker");
    for module in ["numpy", "pickle"] {
        let code = format!("open({:?}, 'w')\n", text(&marker));
        std::fs::write(folder.path().join(format!("{module}.py")), code).unwrap();
    }
    let output = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["bench", "speed", "--repeat", "1"])
        .current_dir(&folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(!marker.exists());
}

#[test]
fn convert_writes_inside_its_folder_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = PathBuf::from(example());
    let convert = |input: &Path, to: &str, out: &Path, more: &[&str]| -> (i32, String) {
        let arguments = ["convert", text(input), "--to", to, "--out", text(out)];
        quick(&[&arguments[..], more].concat())
    };
    // Keys that climb.
    hostile::traversal(&scene, &at("traversal/data"), &at("traversal/victim"));
    let before = hostile::snapshot(&at("traversal"));
    for out in ["traversal/out", "traversal/data/out"] {
        for more in [&[][..], &["--force"]] {
            let (code, said) = convert(&at("traversal/data"), "native", &at(out), more);
            assert_eq!(code, 1, "{said}");
            assert!(said.contains("`../victim/secret.pkl`; expected a file name without a folder"), "{said}");
        }
    }
    assert_eq!(hostile::snapshot(&at("traversal")), before);
    // So do other commands that read the folder.
    let (code, _) = quick(&["inspect", text(&at("traversal/data"))]);
    assert_eq!(code, 1);
    // A merged set maps beside its folder: it is read from there, and written to --out.
    for (name, mapped) in [("merged", "../waymo"), ("absolute", text(&at("waymo")))] {
        std::fs::create_dir_all(at(name)).unwrap();
        std::fs::create_dir_all(at("waymo")).unwrap();
        std::fs::copy(&scene, at("waymo/a.pkl")).unwrap();
        hostile::summary(&at(name), &[("a.pkl", mapped)]);
        let out = at(&format!("{name}-out"));
        let (code, said) = convert(&at(name), "native", &out, &[]);
        if mapped.starts_with('/') {
            assert_eq!(code, 1);
            assert!(said.contains("relative to the summary's"), "{said}");
        } else {
            assert_eq!(code, 0, "{said}");
            assert_eq!(hostile::snapshot(&out).keys().collect::<Vec<_>>(), ["a.safetensors"]);
        }
    }
    assert_eq!(hostile::snapshot(&at("waymo")).len(), 1);
}

#[test]
fn convert_never_replaces_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("in/part")).unwrap();
    std::fs::copy(example(), at("in/part/a.pkl")).unwrap();
    let before = hostile::snapshot(&at("in"));
    for out in ["in", "in/../in", "in/part/.."] {
        let arguments = ["convert", text(&at("in")), "--to", "pickle", "--force", "--out", text(&at(out))]
            .map(str::to_owned);
        let (code, said) = quick(&arguments.each_ref().map(String::as_str));
        assert_eq!(code, 1, "{said}");
        assert!(said.contains("would take the place of an input"), "{said}");
        assert_eq!(hostile::snapshot(&at("in")), before);
    }
    let file = at("in/part/a.pkl");
    let (code, _) =
        quick(&["convert", text(&file), "--to", "pickle", "--force", "--out", text(&at("in/part"))]);
    assert_eq!((code, hostile::snapshot(&at("in"))), (1, before));
}

#[cfg(unix)]
#[test]
fn generate_never_replaces_its_input() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for dir in ["in", "links"] {
        std::fs::create_dir(at(dir)).unwrap();
    }
    std::fs::copy(example(), at("in/a.pkl")).unwrap();
    symlink(at("in/a.pkl"), at("links/a.pkl")).unwrap();
    let before = hostile::snapshot(folder.path());
    for (input, out) in
        [("a.pkl", "."), ("../links", "."), ("../links/a.pkl", "../in"), (".", "out"), (".", ".")]
    {
        let output = Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(["generate", input, "--force", "--out", out])
            .args(WEIGHTS)
            .current_dir(at("in"))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1), "{input} {out}");
        let said = stderr(&output);
        let is_told =
            said.contains("would take the place of an input") || said.contains("lies in the input folder");
        assert!(is_told, "{said}");
        assert_eq!(hostile::snapshot(folder.path()), before);
    }
}

#[test]
fn a_scene_whose_source_is_damaged_keeps_no_other_from_being_attacked() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("in")).unwrap();
    let mut native = Recording::read(Path::new(&example())).unwrap().to_native().unwrap();
    // The source begins with its PROTO, which is changed to an opcode that there is not.
    let source = native.windows(3).rposition(|w| w == b"\x80\x04}").unwrap();
    native[source + 2] = 0xff;
    std::fs::write(at("in/1.safetensors"), native).unwrap();
    std::fs::copy(example(), at("in/2.pkl")).unwrap();
    let output = sage(&["generate", text(&at("in")), "--out", text(&at("out"))]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("1 of 2 scenes failed"), "{}", stderr(&output));
    assert!(at("out/2.pkl").is_file());
}

#[cfg(unix)]
#[test]
fn arguments_that_are_no_text_are_no_reason_to_panic() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};
    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join(OsStr::from_bytes(b"x\xff.pkl"));
    std::fs::copy(example(), &odd).unwrap();
    let out = folder.path().join("out");
    let run = Command::new(env!("CARGO_BIN_EXE_sage"))
        .arg("convert")
        .arg(&odd)
        .args(["--to", "native", "--out", text(&out)])
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 1);
    // What was typed is repeated in messages, and steers nothing.
    let run = sage(&["inspect", "--e\u{1b}[31mx"]);
    assert_eq!(run.status.code(), Some(2));
    assert!(!stderr(&run).contains('\u{1b}'), "{}", stderr(&run));
}

#[cfg(unix)]
#[test]
fn an_output_file_that_is_a_link_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(folder.path().join("nowhere"), &link).unwrap();
    for more in [&[][..], &["--force"]] {
        let error = failure(&[&["draw", &example(), "--out", text(&link)], more].concat());
        assert!(error.contains("is a link; name the file itself"), "{error}");
    }
    assert!(link.is_symlink());
}

#[cfg(unix)]
#[test]
fn links_are_read_and_never_written_through() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for dir in ["originals", "in", "victim", "out"] {
        std::fs::create_dir(at(dir)).unwrap();
    }
    std::fs::copy(example(), at("originals/a.pkl")).unwrap();
    symlink(at("originals/a.pkl"), at("in/a.pkl")).unwrap();
    let convert = |out: &Path, more: &[&str]| {
        quick(&[&["convert", text(&at("in")), "--to", "pickle", "--out", text(out)], more].concat())
    };
    assert_eq!(convert(&at("plain"), &[]).0, 0, "a link as input is readable");
    // Over the original behind the link, or over the link itself.
    let before = hostile::snapshot(&at("originals"));
    for out in ["originals", "in"] {
        let (code, said) = convert(&at(out), &["--force"]);
        assert!(code == 1 && said.contains("the place of an input"), "{said}");
    }
    assert!(at("in/a.pkl").is_symlink());
    assert_eq!(hostile::snapshot(&at("originals")), before);
    // Links planted in the output folder: a file's is replaced, a folder's is refused.
    std::fs::write(at("victim/b.txt"), "mine").unwrap();
    symlink(at("victim/b.txt"), at("out/a.pkl")).unwrap();
    assert_eq!(convert(&at("out"), &["--force"]).0, 0);
    assert_eq!(std::fs::read(at("victim/b.txt")).unwrap(), b"mine");
    std::fs::create_dir(at("in/part")).unwrap();
    std::fs::copy(example(), at("in/part/b.pkl")).unwrap();
    symlink(at("victim"), at("out/part")).unwrap();
    std::fs::create_dir(at("in/part/deep")).unwrap();
    std::fs::copy(example(), at("in/part/deep/c.pkl")).unwrap();
    let (code, said) = convert(&at("out"), &["--force"]);
    assert!(code == 1 && said.contains("leads out of"), "{said}");
    assert_eq!(std::fs::read_dir(at("victim")).unwrap().count(), 1, "not even a folder is made there");
}

/// The embedded experts as a folder.
fn experts(folder: &Path) -> PathBuf {
    let experts = folder.join("experts");
    std::fs::create_dir(&experts).unwrap();
    for file in ["prior", "realistic", "adversarial"] {
        let name = format!("{file}.safetensors");
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural").join(&name);
        std::fs::copy(from, experts.join(&name)).unwrap();
    }
    experts
}

/// Changes one number of a tensor's bytes in a file of weights.
fn spoil(file: &Path, tensor: &str, value: f32) {
    let mut bytes = std::fs::read(file).unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let start = 8 + length + header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    bytes[start..start + 4].copy_from_slice(&value.to_le_bytes());
    std::fs::write(file, bytes).unwrap();
}

#[test]
fn a_number_that_is_none_in_any_tensor_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let out = folder.path().join("out").display().to_string();
    let dial = folder.path().join("dial.json").display().to_string();
    let scene = example();
    let weights = ["--weights", text(&experts)];
    for (file, value) in [("adversarial", f32::NAN), ("realistic", f32::INFINITY), ("prior", f32::NAN)] {
        let path = experts.join(format!("{file}.safetensors"));
        let (parameters, _) = Parameters::load(&path).unwrap();
        let names: Vec<String> = parameters.iter().map(|(name, _)| name.to_owned()).collect();
        let whole = std::fs::read(&path).unwrap();
        for tensor in [&names[0], &names[names.len() / 2], &names[names.len() - 1]] {
            spoil(&path, tensor, value);
            for command in [
                vec!["generate", &scene, "--out", &out],
                vec!["calibrate", &scene, "--out", &dial],
                vec!["bench", "dial", &scene, "--out", &out],
                vec!["bench", "open-loop", &scene, "--out", &out],
            ] {
                let (code, said) = quick(&[&command[..], &weights].concat());
                assert_eq!(code, 1, "{command:?}: {said}");
                let named = said.contains(&format!("{file}.safetensors")) && said.contains(&**tensor);
                assert!(named && said.contains("expected finite numbers"), "{command:?}: {said}");
            }
            std::fs::write(&path, &whole).unwrap();
        }
    }
    assert!(!Path::new(&out).exists() && !Path::new(&dial).exists());
}

#[test]
fn weights_that_overflow_are_told_with_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    // Finite, and too large for what is computed with it.
    let path = experts.join("adversarial.safetensors");
    let (parameters, _) = Parameters::load(&path).unwrap();
    let (prior, _) = Parameters::load(&experts.join("prior.safetensors")).unwrap();
    let tuned: Vec<String> = parameters
        .iter()
        .filter(|(name, tensor)| {
            let numbers =
                |t: &sage_backbones::candle::Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            numbers(tensor) != numbers(prior.get(name).unwrap())
        })
        .map(|(name, _)| name.to_owned())
        .collect();
    for tensor in &tuned {
        spoil(&path, tensor, 3e38);
    }
    let out = folder.path().join("out").display().to_string();
    let (code, said) = quick(&["generate", &example(), "--weights", text(&experts), "--out", &out]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("crossing") && said.contains("mode") && said.contains("log-probability"), "{said}");
}

#[test]
fn experts_in_the_wrong_place_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let at = |name: &str| experts.join(format!("{name}.safetensors"));
    let out = folder.path().join("out").display().to_string();
    let generate = || quick(&["generate", &example(), "--weights", text(&experts), "--force", "--out", &out]);
    assert_eq!(generate().0, 0);
    // Exchanged.
    let [realistic, adversarial] = ["realistic", "adversarial"].map(|name| std::fs::read(at(name)).unwrap());
    std::fs::write(at("realistic"), &adversarial).unwrap();
    std::fs::write(at("adversarial"), &realistic).unwrap();
    let (code, said) = generate();
    assert!(code == 1 && said.contains("it says that it is the adversarial expert"), "{said}");
    // One of them twice.
    std::fs::write(at("adversarial"), &adversarial).unwrap();
    assert_eq!(generate().0, 1);
    std::fs::write(at("realistic"), &realistic).unwrap();
    assert_eq!(generate().0, 0);
    // Without a word of what it is, or of which prior.
    let (parameters, header) = Parameters::load(&at("adversarial")).unwrap();
    for note in ["expert", "prior"] {
        let mut header = header.clone();
        header.notes.remove(note);
        parameters.save(&header, &at("adversarial")).unwrap();
        let (code, said) = generate();
        assert!(code == 1 && said.contains("does not say which expert it is and of which prior"), "{said}");
    }
    let mut header = header;
    header.notes.insert("prior".to_owned(), "0000000000000000".to_owned());
    parameters.save(&header, &at("adversarial")).unwrap();
    let (code, said) = generate();
    assert!(code == 1 && said.contains("was tuned from another prior"), "{said}");
}

#[test]
fn weights_of_another_type_or_shape_are_told_in_a_few_words() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let out = folder.path().join("out").display().to_string();
    let generate = || quick(&["generate", &example(), "--weights", text(&experts), "--force", "--out", &out]);
    for name in ["adversarial", "prior"] {
        let path = experts.join(format!("{name}.safetensors"));
        let (parameters, header) = Parameters::load(&path).unwrap();
        parameters.to_dtype(sage_backbones::candle::DType::F64).unwrap().save(&header, &path).unwrap();
        let (code, said) = generate();
        assert!(code == 1 && said.contains("holds F64; ") && said.contains("convert the weights"), "{said}");
        parameters.save(&header, &path).unwrap();
    }
    let path = experts.join("prior.safetensors");
    let (parameters, mut header) = Parameters::load(&path).unwrap();
    header.options["hidden"] = 16.into();
    parameters.save(&header, &path).unwrap();
    let (code, said) = generate();
    assert!(code == 1 && said.contains("more like these"), "{said}");
    assert!(said.len() < 2000, "{} bytes: {said}", said.len());
}

#[test]
fn each_scene_gets_the_weights_of_its_own_origin() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // A folder that says it is `waymo`, with the weights that are in the binary.
    let weights = experts(folder.path());
    std::fs::create_dir(at("weights")).unwrap();
    std::fs::rename(&weights, at("weights/waymo")).unwrap();
    let generate = |input: &Path, out: &str| -> Output {
        let arguments = ["generate", text(input), "--out", text(&at(out))].map(str::to_owned);
        Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(arguments)
            .env("SAGE_WEIGHTS", at("weights"))
            .output()
            .unwrap()
    };
    std::fs::create_dir(at("scenes")).unwrap();
    std::fs::copy(example(), at("scenes/recorded.pkl")).unwrap();
    let told = |out: &str, scene: &str| -> Value {
        let made = Recording::read(&at(out).join(format!("{scene}.pkl"))).unwrap();
        let document = made.document().unwrap().unwrap();
        let metadata = document.get(document.root(), "metadata").unwrap();
        let told = document.get(metadata, sage_data::PROVENANCE).and_then(|id| document.text(id)).unwrap();
        serde_json::from_str(told).unwrap()
    };
    assert!(generate(&at("scenes"), "alone").status.success());
    assert_eq!(told("alone", "recorded")["weights"], "waymo");
    // Neither a broken file nor a procedural scene before it changes that.
    std::fs::write(at("scenes/0bad.pkl"), "no scene").unwrap();
    stdout(&sage(&["scenes", "--count", "1", "--kind", "curve", "--out", text(&at("made"))]));
    std::fs::copy(at("made/curve-1-0.safetensors"), at("scenes/1made.safetensors")).unwrap();
    let output = generate(&at("scenes"), "mixed");
    assert_eq!(output.status.code(), Some(1), "one file is no scene");
    for weights in ["waymo", "procedural"] {
        assert!(stderr(&output).contains(&format!("weights `{weights}`")), "{}", stderr(&output));
    }
    assert_eq!(told("mixed", "recorded"), told("alone", "recorded"));
    for ending in ["pkl", "safetensors"] {
        let read = |out: &str| std::fs::read(at(out).join(format!("recorded.{ending}"))).unwrap();
        assert!(read("mixed") == read("alone"), "the attack depends on the folder");
    }
    assert_eq!(told("mixed", "1made")["weights"], "procedural");
}

#[test]
fn a_variable_that_points_nowhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("nowhere");
    let out = folder.path().join("out").display().to_string();
    for command in [
        vec!["generate", &example(), "--out", &out],
        vec!["generate", &example(), "--weights", "waymo", "--out", &out],
        vec!["predict", &example()],
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(&command)
            .env("SAGE_WEIGHTS", &nowhere)
            .output()
            .unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("SAGE_WEIGHTS is `") && said.contains("correct or unset it"), "{said}");
    }
}

#[cfg(unix)]
#[test]
fn devices_are_refused_and_numbers_have_limits() {
    let folder = tempfile::tempdir().unwrap();
    let [out, attacked] = ["out", "attacked"].map(|name| folder.path().join(name).display().to_string());
    let scene = example();
    for command in [
        vec!["pretrain", "--made", "1", "--config", "/dev/zero", "--out", &out],
        vec!["finetune", "--made", "1", "--config", "/dev/zero", "--out", &out],
        vec!["bench", "speed", "--data", "/dev/zero"],
        vec!["inspect", "/dev/zero"],
        vec!["generate", "/dev/zero", "--out", &attacked],
        vec!["score", &scene, "--candidates", "/dev/zero"],
        vec!["calibrate", &scene, "--splits", "/dev/zero", "--split", "a", "--out", &out],
    ] {
        let (code, said) = quick(&command);
        assert_eq!(code, 1, "{command:?}: {said}");
        assert!(said.contains("it is a device; expected"), "{command:?}: {said}");
    }
    let many = "10000000000000000000";
    for command in [
        vec!["pretrain", "--made", many, "--out", &out],
        vec!["finetune", "--made", many, "--out", &out],
        vec!["calibrate", "--made", many, "--out", &out],
        vec!["scenes", "--count", many, "--out", &out],
        vec!["finetune", "--made", "1", "--roles", many, "--out", &out],
        vec!["predict", &scene, "--k", many],
    ] {
        let (code, said) = quick(&command);
        assert_eq!(code, 2, "{command:?}: {said}");
    }
    // A large file of options is told from a small one before it is read.
    let large = folder.path().join("large.json");
    std::fs::File::create(&large).unwrap().set_len(1 << 40).unwrap();
    let (code, said) = quick(&["pretrain", "--made", "1", "--config", text(&large), "--out", &out]);
    assert!(code == 1 && said.contains("holds more than"), "{said}");
    assert!(!Path::new(&out).exists());
}

/// Runs the binary with the content of a file on standard input.
fn piped(arguments: &[&str], file: &str) -> Output {
    Command::new("sh")
        .args(["-c", "cat \"$0\" | \"$@\"", file, env!("CARGO_BIN_EXE_sage")])
        .args(arguments)
        .output()
        .unwrap()
}

#[cfg(unix)]
#[test]
fn pipes_on_the_command_line_are_read_once_and_those_in_folders_never() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = example();
    let plain = sage(&["inspect", &scene, "--json"]);
    let row = |output: &Output| -> Value {
        let mut row = rows(output).remove(0);
        row["scene"] = Value::Null;
        row
    };
    for path in ["-", "/dev/stdin"] {
        assert_eq!(row(&piped(&["inspect", path, "--json"], &scene)), row(&plain), "{path}");
        assert!(
            stdout(&piped(&["bench", "speed", "--data", path, "--repeat", "1"], &scene)).contains("attack")
        );
        let table = at(&format!("table{}", path.len())).display().to_string();
        let arguments = ["bench", "open-loop", path, "--methods", "log", "--out", &table];
        assert!(stdout(&piped(&arguments, &scene)).contains("| log | 1 |"));
    }
    let out = at("attacked").display().to_string();
    stdout(&piped(&["generate", "-", "--weights", "procedural", "--out", &out], &scene));
    assert!(Path::new(&out).join("stdin.pkl").is_file());
    let native = at("native").display().to_string();
    stdout(&piped(&["convert", "-", "--to", "native", "--out", &native], &scene));
    assert!(Path::new(&native).join("stdin.safetensors").is_file());
    let options = at("options.json");
    std::fs::write(&options, r#"{"epochs": 0}"#).unwrap();
    let config = piped(&["pretrain", "--made", "1", "--config", "-", "--out", &out], text(&options));
    assert!(stderr(&config).contains("option `epochs` is 0"), "{}", stderr(&config));
    // A pipe that nobody writes to, inside a folder and inside its summary.
    std::fs::create_dir(at("scenes")).unwrap();
    std::fs::copy(&scene, at("scenes/a.pkl")).unwrap();
    assert!(Command::new("mkfifo").arg(at("scenes/b.pkl")).status().unwrap().success());
    let (code, said) = quick(&["inspect", text(&at("scenes"))]);
    assert_eq!(code, 0, "{said}");
    hostile::summary(&at("scenes"), &[("a.pkl", ""), ("b.pkl", "")]);
    let (code, said) = quick(&["inspect", text(&at("scenes"))]);
    assert!(code == 1 && said.contains("expected a regular file"), "{said}");
}

#[test]
fn bad_use_ends_with_2_and_says_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let scene = example();
    let generate =
        |more: &[&str]| quick(&[&["generate", &scene, "--out", &out], &WEIGHTS[..], more].concat());
    for (flags, expected) in [
        (["--lambda", "nan"], "`nan` is not a finite number"),
        (["--lambda", "inf"], "`inf` is not a finite number"),
        (["--lambda", "0:1:0"], "the step 0 does not lead from 0 to 1"),
        (["--lambda", "0:1:-0.1"], "the step -0.1 does not lead from 0 to 1"),
        (["--lambda", "0:1:1e-9"], "more than 1000 steps"),
        (["--mu", "nan"], "`nan` is not a finite number"),
        (["--aggression", "0:1:0"], "the step 0 does not lead from 0 to 1"),
    ] {
        let (code, said) = generate(&flags);
        assert_eq!(code, 2, "{flags:?}: {said}");
        assert!(said.contains(expected), "{flags:?}: {said}");
    }
    for (flags, expected) in [
        (["--lambda", "-0.5"], "lambda is -0.5; expected 0 (realistic) to 1 (adversarial)"),
        (["--lambda", "-0.5,0.5"], "lambda is -0.5"),
        (["--mu", "-1"], "mu is -1; expected 0 to 1"),
        (["--aggression", "-0.5"], "aggression is -0.5; expected 0 (natural) to 1"),
        (["--options", "[1"], "--options is not a JSON object"),
        (["--merger", "none"], "unknown merger `none`"),
    ] {
        // A file that is no scene shows that options are looked at before scenes are read.
        let (code, said) = generate(&flags);
        assert_eq!(code, 1, "{flags:?}: {said}");
        assert!(said.contains(expected), "{flags:?}: {said}");
        assert!(!Path::new(&out).exists(), "{flags:?}");
    }
    let broken = folder.path().join("broken.pkl");
    std::fs::write(&broken, "").unwrap();
    let (code, said) = quick(&["inspect", text(&broken)]);
    assert!(code == 1 && said.contains("the file is empty") && !said.contains("0x00"), "{said}");
    let (code, said) = quick(&["generate", text(&broken), "--weights", "procedural", "--out", &out]);
    assert!(
        code == 1 && said.contains("no scene came out of 1 file") && !said.contains("the others"),
        "{said}"
    );
    // What can be known at once is known before the scenes are read.
    let (code, said) = quick(&["pretrain", text(&broken), "--epochs", "0", "--out", &out]);
    assert!(code == 1 && said.contains("option `epochs` is 0"), "{said}");
    let experts = ["bench", "experts", text(&broken), "--a", "nowhere", "--b", "nowhere"];
    assert!(quick(&experts).1.contains("no weights `nowhere`"));
}

#[cfg(unix)]
#[test]
fn a_closed_output_keeps_no_file_from_being_written() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "3", "--out", text(&scenes)]));
    for (number, shell) in ["exec \"$@\" >&-", "\"$@\" | true; exit ${PIPESTATUS[0]}"].into_iter().enumerate()
    {
        let out = folder.path().join(format!("out{number}"));
        let run = |arguments: &[&str]| {
            let output = Command::new("bash")
                .args(["-c", shell, "bash", env!("CARGO_BIN_EXE_sage")])
                .args(arguments)
                .args(WEIGHTS)
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(0), "{shell}: {}", stderr(&output));
        };
        run(&["generate", text(&scenes), "--out", text(&out)]);
        assert_eq!(hostile::snapshot(&out).len(), 12);
        let table = folder.path().join(format!("table{number}"));
        run(&["bench", "open-loop", text(&scenes), "--methods", "log,sage", "--out", text(&table)]);
        assert!(table.join("index.html").is_file() && table.join("table.md").is_file());
    }
}

#[cfg(unix)]
#[test]
fn names_and_licences_do_not_steer_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir(&scenes).unwrap();
    std::fs::copy(example(), scenes.join("a\u{1b}[2Jb\u{9b}c\u{202e}d\ne.pkl")).unwrap();
    std::fs::write(scenes.join("z\u{1b}]0;title\u{7}.pkl"), "no scene").unwrap();
    let experts = experts(folder.path());
    let path = experts.join("prior.safetensors");
    let (parameters, mut header) = Parameters::load(&path).unwrap();
    header.license = "Free\u{1b}[31m\u{9b}31m. And so on".to_owned();
    parameters.save(&header, &path).unwrap();
    let out = folder.path().join("out").display().to_string();
    for command in [
        vec!["inspect", text(&scenes)],
        vec!["inspect", text(&scenes), "--json"],
        vec!["generate", text(&scenes), "--weights", text(&experts), "--out", &out],
        vec!["generate", text(&scenes), "--weights", text(&experts), "--force", "--json", "--out", &out],
        vec!["convert", text(&scenes), "--to", "native", "--force", "--out", &out],
    ] {
        let output = sage(&command);
        for said in [&output.stdout, &output.stderr] {
            let said = std::str::from_utf8(said).unwrap();
            let bad = said.chars().find(|c| (c.is_control() && *c != '\n') || *c == '\u{202e}');
            assert_eq!(bad, None, "{command:?}: {said:?}");
        }
    }
}
