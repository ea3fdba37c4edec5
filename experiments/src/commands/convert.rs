//! `sage convert`: converts scene files between two formats, in parallel.

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Result, bail};
use sage_data::{Recording, folder};

use crate::{
    Outcome,
    cli::{ConvertArgs, Format},
    input,
    output::{self, Folder},
    progress::{Progress, count},
};

/// An input file, and its output file relative to the output folder.
struct Pair {
    from: PathBuf,
    to: PathBuf,
}

pub(crate) fn run(args: &ConvertArgs) -> Result<Outcome> {
    let ending = match args.to {
        Format::Native => "safetensors",
        Format::Pickle => "pkl",
    };
    let mut pairs: Vec<Pair> = Vec::new();
    for path in &args.paths {
        let root = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        for from in folder::scene_files(path)? {
            let to = input::scene_name(&folder::name_below(root, &from)).with_extension(ending);
            pairs.push(Pair { from, to });
        }
    }
    let distinct: HashSet<&PathBuf> = pairs.iter().map(|pair| &pair.to).collect();
    if distinct.len() < pairs.len() {
        bail!("several inputs would become one file; convert them into separate folders");
    }
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    let (files, outputs): (Vec<_>, Vec<_>) =
        pairs.iter().map(|pair| (pair.from.clone(), pair.to.clone())).unzip();
    output::protect_inputs(&args.paths, &files, out.path(), &outputs)?;
    let folders: HashSet<&Path> = pairs.iter().filter_map(|pair| pair.to.parent()).collect();
    for folder in folders {
        out.inner(folder)?;
    }
    let targets: HashMap<&Path, PathBuf> =
        pairs.iter().map(|pair| (pair.from.as_path(), out.path().join(&pair.to))).collect();
    let is_full = AtomicBool::new(false);
    let convert = |from: &Path| -> Option<Result<()>> {
        if is_full.load(Ordering::Relaxed) {
            return None;
        }
        let done = Recording::read(from).and_then(|scene| scene.write(&targets[from]));
        let done = done.map_err(anyhow::Error::from);
        if done.as_ref().is_err_and(output::is_disk_full) {
            is_full.store(true, Ordering::Relaxed);
        }
        Some(done)
    };
    let mut progress = Progress::new("converted", files.len());
    let (mut whole, mut failed, mut full) = (0, 0, None);
    folder::in_order(&files, convert, |_, result| {
        progress.step();
        match result {
            Some(Ok(())) => whole += 1,
            Some(Err(error)) if output::is_disk_full(&error) => full = Some(error),
            Some(Err(error)) => {
                failed += 1;
                progress.say(&format!("error: {error:#}"));
            }
            None => {}
        }
        Ok::<(), anyhow::Error>(())
    })?;
    let destination = args.folder.out.display();
    if let Some(error) = full {
        let sum = format!(
            "{whole} of {} scenes are whole in `{destination}`; free space and start again with --force",
            files.len()
        );
        return Err(error.context(sum));
    }
    progress.finish(&format!("{} in `{destination}`, {failed} failed", count(whole, "scene")));
    Ok(if failed > 0 { Outcome::Partial } else { Outcome::Done })
}
