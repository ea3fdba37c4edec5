//! Weights.

use std::{path::Path, process::Command};

use insta::assert_snapshot;
use sage_backbones::Parameters;
use serde_json::Value;

use crate::{experts, has_failed, program::*, quick};

/// Changes one number of a tensor's bytes in a file of weights, and the hash with it.
fn spoil(file: &Path, tensor: &str, value: f32) {
    let mut bytes = std::fs::read(file).unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let start = 8 + length + header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    bytes[start..start + 4].copy_from_slice(&value.to_le_bytes());
    std::fs::write(file, bytes).unwrap();
    crate::change_header(file, |_| ());
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
                assert!(has_failed(code), "{command:?}: {said}");
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
    assert!(has_failed(code), "{said}");
    assert_snapshot!(redacted(&said), @r"
    note: weights `[folder]/experts` (network densetnt)
    error: `[sage]/examples/crossing.pkl`: scene `crossing`: mode 0 has log-probability NaN; the weights or the scene are broken
    error: the scene could not be attacked
    ");
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
    assert!(has_failed(code), "{said}");
    let mut refused = vec![("exchanged".to_owned(), said)];
    // One of them twice.
    std::fs::write(at("adversarial"), &adversarial).unwrap();
    let (code, said) = generate();
    assert!(has_failed(code), "{said}");
    refused.push(("the same twice".to_owned(), said));
    std::fs::write(at("realistic"), &realistic).unwrap();
    assert_eq!(generate().0, 0);
    // Tuned with other features than the prior's.
    let (parameters, header) = Parameters::load(&at("adversarial")).unwrap();
    let mut other = header.clone();
    let edges = if header.options["edges"] == "all" { "boundaries" } else { "all" };
    other.options["edges"] = edges.into();
    parameters.save(&other, &at("adversarial")).unwrap();
    let (code, said) = generate();
    assert!(has_failed(code), "{said}");
    refused.push(("other features".to_owned(), said));
    // Without a word of what it is, or of which prior.
    for note in ["expert", "prior"] {
        let mut header = header.clone();
        header.notes.remove(note);
        parameters.save(&header, &at("adversarial")).unwrap();
        let (code, said) = generate();
        assert!(has_failed(code), "{said}");
        refused.push((format!("no name of the {note}"), said));
    }
    let mut header = header;
    header.notes.insert("prior".to_owned(), "0000000000000000".to_owned());
    parameters.save(&header, &at("adversarial")).unwrap();
    let (code, said) = generate();
    assert!(has_failed(code), "{said}");
    refused.push(("another prior".to_owned(), said));
    assert_snapshot!("experts_in_the_wrong_place", messages(refused));
}

#[test]
fn weights_of_another_type_or_shape_are_told_in_a_few_words() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let out = folder.path().join("out").display().to_string();
    let generate = || quick(&["generate", &example(), "--weights", text(&experts), "--force", "--out", &out]);
    let mut refused = Vec::new();
    for name in ["adversarial", "prior"] {
        let path = experts.join(format!("{name}.safetensors"));
        let (parameters, header) = Parameters::load(&path).unwrap();
        parameters.to_dtype(sage_backbones::candle::DType::F64).unwrap().save(&header, &path).unwrap();
        let (code, said) = generate();
        assert!(has_failed(code), "{said}");
        refused.push((format!("{name} in F64"), said));
        parameters.save(&header, &path).unwrap();
    }
    let path = experts.join("prior.safetensors");
    let (parameters, mut header) = Parameters::load(&path).unwrap();
    header.options["hidden"] = 16.into();
    parameters.save(&header, &path).unwrap();
    let (code, said) = generate();
    assert!(has_failed(code), "{said}");
    refused.push(("prior of another width".to_owned(), said));
    assert_snapshot!("weights_of_another_type_or_shape", messages(refused));
}

#[test]
fn every_command_uses_the_same_weights_from_any_folder() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // A folder that holds other weights under the name `waymo`, and one that holds none.
    let weights = experts(folder.path());
    std::fs::create_dir_all(at("with/weights")).unwrap();
    std::fs::create_dir(at("without")).unwrap();
    std::fs::rename(&weights, at("with/weights/waymo")).unwrap();
    std::fs::create_dir(at("scenes")).unwrap();
    std::fs::copy(example(), at("scenes/recorded.pkl")).unwrap();
    stdout(&sage(&[
        "scenes",
        "--count",
        "1",
        "--kind",
        "four-way",
        "--format",
        "pickle",
        "--out",
        text(&at("made")),
    ]));
    std::fs::copy(at("made/four-way-1-0.pkl"), at("scenes/made.pkl")).unwrap();
    let scenes = at("scenes").display().to_string();
    let one = at("scenes/recorded.pkl").display().to_string();
    let small = ["--config", r#"{"td3": {"hidden": [8, 8], "batch": 16, "random_steps": 200}}"#];
    let method = ["--method", "sage", "--eval-method", "none"];
    let study = ["bench", "open-loop", &scenes, "--method", "sage", "--lambda", "1"];
    let commands: [&[&str]; 8] = [
        &["generate", &scenes, "--json"],
        &["simulate", &scenes, "--ego", "idm", "--method", "sage", "--json"],
        &["search", &scenes, "--ego", "idm", "--budget", "4", "--json"],
        &["predict", &one, "--k", "2", "--json"],
        &study,
        &["bench", "search", &scenes, "--ego", "idm", "--set", "search={budget: 2}", "--method", "pool"],
        &["calibrate", &scenes, "--procedural", "1"],
        &[&["train-ego", "--procedural", "6", "--updates", "300", "--evaluations", "1"], &small[..], &method]
            .concat(),
    ];
    for (number, command) in commands.into_iter().enumerate() {
        let run = |from: &str, variable: Option<&str>| -> (String, String) {
            let out = at(&format!("out-{number}-{from}-{}", variable.is_some()));
            let mut program = Command::new(env!("CARGO_BIN_EXE_sage"));
            program.args(command).current_dir(at(from)).env_remove("SAGE_WEIGHTS");
            if command[0] == "calibrate" {
                program.args(["--out", text(&out.with_extension("json"))]);
            } else if command[0] != "predict" {
                program.args(["--out", text(&out)]);
            }
            if let Some(folder) = variable {
                program.env("SAGE_WEIGHTS", at(folder));
            }
            let output = program.output().unwrap();
            let said = stderr(&output).to_owned();
            assert_eq!(output.status.code(), Some(0), "{command:?}: {said}");
            let without_times = |line: &str| line.split("\"seconds\"").next().unwrap_or_default().to_owned();
            (stdout(&output).lines().map(without_times).collect::<Vec<_>>().join("\n"), said)
        };
        let plain = run("without", None);
        assert!(plain.1.contains("note: weights `procedural`"), "{command:?}: {}", plain.1);
        for (from, variable) in [("with", None), ("without", Some("with/weights"))] {
            let other = run(from, variable);
            assert!(!other.1.contains("weights `waymo`"), "{command:?}: {}", other.1);
            if ["generate", "simulate", "search", "predict"].contains(&command[0]) {
                let hash = |text: &str| text.split("\"run_hash\"").skip(1).count();
                assert_eq!(hash(&other.0), hash(&plain.0));
                assert_eq!(masked_hash(&other.0), masked_hash(&plain.0), "{command:?}");
            }
        }
    }
    // By their name they are found in either place.
    for (from, variable) in [("with", None), ("without", Some("with/weights"))] {
        let mut program = Command::new(env!("CARGO_BIN_EXE_sage"));
        program
            .args(["predict", &one, "--weights", "waymo"])
            .current_dir(at(from))
            .env_remove("SAGE_WEIGHTS");
        if let Some(folder) = variable {
            program.env("SAGE_WEIGHTS", at(folder));
        }
        assert!(stderr(&program.output().unwrap()).contains("note: weights `waymo`"));
    }
}

/// Lines without the hash of the run, which holds the command.
fn masked_hash(text: &str) -> String {
    let line = |line: &str| match line.split_once("\"scene\"") {
        Some((_, rest)) => rest.to_owned(),
        None => line.to_owned(),
    };
    text.lines().map(line).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_variable_that_points_nowhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("nowhere");
    let out = folder.path().join("out").display().to_string();
    let mut said = Vec::new();
    for command in [
        vec!["generate", &example(), "--weights", "waymo", "--out", &out],
        vec!["predict", &example(), "--weights", "waymo"],
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(&command)
            .env("SAGE_WEIGHTS", &nowhere)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        said.push((command.join(" "), stderr(&output).to_owned()));
    }
    assert_snapshot!("a_variable_that_points_nowhere", messages(said));
}

#[test]
fn a_flipped_bit_of_weights_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let experts = experts(folder.path());
    let out = folder.path().join("out").display().to_string();
    let scene = example();
    for (number, name) in ["prior", "realistic", "adversarial"].into_iter().enumerate() {
        let path = experts.join(format!("{name}.safetensors"));
        let whole = std::fs::read(&path).unwrap();
        let header = 8 + u64::from_le_bytes(*whole.first_chunk().unwrap()) as usize;
        for share in 1..=10 {
            let mut flipped = whole.clone();
            let at = header + (whole.len() - header) * share / 11 + number;
            flipped[at] ^= 1 << (share % 8);
            std::fs::write(&path, flipped).unwrap();
            let (code, said) =
                quick(&["generate", &scene, "--lambda", "1", "--weights", text(&experts), "--out", &out]);
            let is_named =
                said.contains(&format!("{name}.safetensors")) && said.contains("hash in its header");
            assert!(code == 1 && is_named, "byte {at} of {name}: {said}");
        }
        std::fs::write(&path, whole).unwrap();
    }
    let (code, said) =
        quick(&["generate", &scene, "--lambda", "1", "--weights", text(&experts), "--out", &out]);
    assert_eq!(code, 0, "{said}");
    let path = experts.join("adversarial.safetensors");
    let whole = std::fs::read(&path).unwrap();
    let key = whole.windows(4).position(|bytes| bytes == b"hash").unwrap();
    std::fs::write(&path, [&whole[..key], b"hush", &whole[key + 4..]].concat()).unwrap();
    let (code, said) = quick(&["generate", &scene, "--weights", text(&experts), "--force", "--out", &out]);
    assert!(code == 1 && said.contains("it holds no hash of its content"), "{said}");
}
