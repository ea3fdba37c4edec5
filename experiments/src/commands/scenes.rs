//! `sage scenes`: procedural scenes, in parallel.

use std::path::PathBuf;

use anyhow::{Context, Result};
use rayon::prelude::*;
use sage_data::{
    Recording,
    procedural::{self, Kind},
};

use crate::{
    Outcome,
    cli::{Format, ScenesArgs},
    output::Folder,
    progress::Progress,
};

/// Scenes made between two reports.
const WINDOW: u64 = 64;

pub(crate) fn run(args: &ScenesArgs) -> Result<Outcome> {
    let kinds = if args.kind.is_empty() { &Kind::ALL[..] } else { &args.kind };
    let out = Folder::make(&args.out, args.force)?;
    let ending = match args.format {
        Format::Native => "safetensors",
        Format::Pickle => "pkl",
    };
    let mut progress = Progress::new("made", args.count as usize);
    for first in (0..args.count).step_by(WINDOW as usize) {
        let last = (first + WINDOW).min(args.count);
        let made: Result<Vec<()>> = (first..last)
            .into_par_iter()
            .map(|number| {
                let kind = kinds[(number % kinds.len() as u64) as usize];
                let scene = procedural::generate(kind, args.seed, number).with_context(|| {
                    format!("no {} scene came of seed {} number {number}", kind.name(), args.seed)
                })?;
                let path: PathBuf = out.path().join(format!("{}.{ending}", scene.id));
                Ok(Recording::procedural(scene).write(&path)?)
            })
            .collect();
        for () in made? {
            progress.step();
        }
    }
    progress.finish(&format!("{} scenes in `{}`", args.count, args.out.display()));
    Ok(Outcome::Done)
}
