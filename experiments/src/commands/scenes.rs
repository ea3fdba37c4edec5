//! `sage scenes`: generates procedural scenes in parallel.

use std::path::PathBuf;

use anyhow::{Context, Result};
use rayon::prelude::*;
use sage_data::{
    Recording,
    procedural::{self, Kind},
};
use sage_run::{
    Outcome,
    output::Folder,
    progress::{Progress, count},
};

use crate::cli::ScenesArgs;

/// Scenes generated between two progress reports.
const WINDOW: u64 = 64;

pub(crate) fn run(args: &ScenesArgs) -> Result<Outcome> {
    let kinds = if args.kind.is_empty() { &Kind::ALL[..] } else { &args.kind };
    let out = Folder::make(&args.out, args.force)?;
    let ending = args.format.ending();
    let mut progress = Progress::new("generated", args.count as usize);
    for first in (0..args.count).step_by(WINDOW as usize) {
        let last = (first + WINDOW).min(args.count);
        let written: Result<Vec<()>> = (first..last)
            .into_par_iter()
            .map(|number| {
                let kind = kinds[(number % kinds.len() as u64) as usize];
                let scene = procedural::generate(kind, args.seed, number).with_context(|| {
                    format!(
                        "no {} scene could be generated from seed {} and number {number}",
                        kind.name(),
                        args.seed
                    )
                })?;
                let path: PathBuf = out.path().join(format!("{}.{ending}", scene.id));
                Ok(Recording::procedural(scene).write(&path)?)
            })
            .collect();
        for () in written? {
            progress.step();
        }
    }
    out.finish()?;
    let scenes = count(args.count as usize, "scene");
    progress.finish(&format!("{scenes} in `{}`", args.out.display()));
    Ok(Outcome::Done)
}
