//! Adds the hash of their content to weights and policies of earlier versions. Tensors and all other entries of the
//! header stay.
//!
//! ```sh
//! cargo run --release -p experiments --example add_content_hash -- experts/*.safetensors
//! ```

#![allow(clippy::print_stderr)] // A program of its own, read by a person.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use sage_backbones::{Error, Parameters};
use sage_sim::actor::{read_policy, write_policy};

fn main() -> ExitCode {
    let files: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if files.is_empty() {
        eprintln!("usage: add_content_hash FILE…");
        return ExitCode::from(2);
    }
    for file in files {
        match add(&file) {
            Ok(what) => eprintln!("`{}`: {what}", file.display()),
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::FAILURE;
            }
        }
    }
    ExitCode::SUCCESS
}

/// Rewrites a file. Returns what was done.
fn add(file: &Path) -> Result<&'static str, String> {
    match Parameters::load(file) {
        Ok((_, header)) if header.is_hashed => Ok("has a hash"),
        Ok((parameters, header)) => {
            parameters.save(&header, file).map_err(|error| error.to_string())?;
            Ok("weights, hash added")
        }
        Err(Error::NoNetwork { .. }) => match read_policy(file)? {
            (_, card) if card.is_hashed => Ok("has a hash"),
            (actor, card) => {
                write_policy(file, &actor, &card)
                    .map_err(|error| format!("cannot write `{}`: {error}", file.display()))?;
                Ok("policy, hash added")
            }
        },
        Err(error) => Err(error.to_string()),
    }
}
