//! Reference files outside the project: `SAGE_REFERENCE` and `SAGE_DATA` name their folders. Tests without
//! them say so and pass.

use std::{env, fs, path::PathBuf};

use serde_json::Value;

/// A JSON fixture, or `None` without `SAGE_REFERENCE`.
pub fn json(name: &str) -> Option<Value> {
    let Ok(folder) = env::var("SAGE_REFERENCE") else {
        eprintln!("left out: SAGE_REFERENCE is not set");
        return None;
    };
    let path = PathBuf::from(folder).join("fixtures").join(name);
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    Some(serde_json::from_str(&text).unwrap())
}
