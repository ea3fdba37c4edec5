//! Scene files, data sets, weights and options from strangers: nothing runs, nothing is written outside of
//! the output folder, and what is wrong is said.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod far_paths;
#[path = "../hostile/mod.rs"]
mod hostile;
mod inputs;
mod names;
mod options;
#[path = "../program/mod.rs"]
mod program;
#[path = "../recipe/mod.rs"]
mod recipe;
mod scenes;
mod weights;

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use sage_core::content_hash::{HashedTensor, content_hash, split_hash, with_hash};
use serde_json::{Map, Value};

/// A run that must not take long or much; the exit code and what it said.
fn quick(arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new("timeout");
    command.arg("60").arg(env!("CARGO_BIN_EXE_sage")).args(arguments);
    let output = command.env_remove("SAGE_WEIGHTS").stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().unwrap_or(-1), said)
}

/// True for the exit codes of a command that failed: 1, or that of bad scenes.
fn has_failed(code: i32) -> bool {
    [1, program::BAD_SCENES].contains(&code)
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

/// Changes the header of weights or of a policy, with the hash of the content as it is now.
fn change_header(file: &Path, change: impl FnOnce(&mut Map<String, Value>)) {
    let bytes = std::fs::read(file).unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let mut header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let mut tensors = header.as_object().unwrap().clone();
    tensors.remove("__metadata__");
    let metadata = header["__metadata__"].as_object_mut().unwrap();
    let (_, text) = metadata.iter_mut().next().unwrap();
    let (json, _) = split_hash(text.as_str().unwrap());
    let mut fields: Map<String, Value> = serde_json::from_str(&json).unwrap();
    change(&mut fields);
    let json = Value::Object(fields).to_string();
    let data = &bytes[8 + length..];
    let hash =
        content_hash(&json, tensors.iter().map(|(name, tensor)| (name.as_str(), hashed(tensor, data))));
    *text = with_hash(&json, &hash).into();
    let mut header = header.to_string();
    header.extend(std::iter::repeat_n(' ', header.len().next_multiple_of(8) - header.len()));
    let changed = [&(header.len() as u64).to_le_bytes(), header.as_bytes(), data].concat();
    std::fs::write(file, changed).unwrap();
}

/// A tensor of a file, from its entry in the header.
fn hashed<'a>(tensor: &Value, data: &'a [u8]) -> HashedTensor<'a> {
    let numbers = |key: &str| serde_json::from_value::<Vec<usize>>(tensor[key].clone()).unwrap();
    let [start, end] = *numbers("data_offsets") else { panic!("{tensor}") };
    let dtype = tensor["dtype"].as_str().unwrap().to_owned();
    HashedTensor { dtype, shape: numbers("shape"), bytes: &data[start..end] }
}
