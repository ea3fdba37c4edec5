//! Writes scene files that are odd in many ways, for tests of other programs.
//!
//! ```sh
//! cargo run --release -p sage-data --example write_odd_scenes -- 50 scenes/
//! ```

#![allow(clippy::print_stdout, clippy::print_stderr, clippy::disallowed_methods)] // A command-line program.

#[path = "../tests/odd_scenes/mod.rs"]
mod odd_scenes;

use std::{path::Path, process::ExitCode};

use odd_scenes::OddScene;
use sage_core::seed::Rng;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [count, folder] = &arguments[..] else {
        eprintln!("usage: write_odd_scenes COUNT DIR");
        return ExitCode::from(2);
    };
    let Ok(count) = count.parse::<u64>() else {
        eprintln!("`{count}` is no number of scenes");
        return ExitCode::from(2);
    };
    for seed in 0..count {
        let scene = OddScene::draw(&mut Rng::new(seed, "odd scenes", "written"), 0.25);
        let file = Path::new(folder).join(format!("odd{seed:04}.{}", scene.ending()));
        let written = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, scene.bytes()));
        if let Err(error) = written {
            eprintln!("cannot write `{}`: {error}", file.display());
            return ExitCode::FAILURE;
        }
        println!("{} {}", file.display(), scene.describe());
    }
    ExitCode::SUCCESS
}
