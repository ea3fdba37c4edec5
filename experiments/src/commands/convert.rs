//! `sage convert`: scene files of one format into the other, in parallel.

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

use anyhow::{Result, bail};
use sage_data::{Recording, folder};

use crate::{
    Outcome,
    cli::{ConvertArgs, Format},
    output,
    progress::Progress,
};

pub(crate) fn run(args: &ConvertArgs) -> Result<Outcome> {
    let ending = match args.to {
        Format::Native => "safetensors",
        Format::Pickle => "pkl",
    };
    let mut pairs: Vec<(PathBuf, PathBuf)> = Vec::new();
    for path in &args.paths {
        let root = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        for file in folder::scene_files(path)? {
            // What lies beside the folder keeps its name alone.
            let below = file.strip_prefix(root).map(Path::to_owned);
            let name = below.unwrap_or_else(|_| file.file_name().map(PathBuf::from).unwrap_or_default());
            pairs.push((file, args.folder.out.join(name).with_extension(ending)));
        }
    }
    let distinct: HashSet<&PathBuf> = pairs.iter().map(|(_, to)| to).collect();
    if distinct.len() < pairs.len() {
        bail!("several inputs would become one file; convert them into folders of their own");
    }
    output::make_folder(&args.folder.out, args.folder.force)?;
    let files: Vec<PathBuf> = pairs.iter().map(|(from, _)| from.clone()).collect();
    let targets: HashMap<&Path, &Path> =
        pairs.iter().map(|(from, to)| (from.as_path(), to.as_path())).collect();
    let convert = |from: &Path| -> Result<()> {
        let Some(to) = targets.get(from) else { return Ok(()) };
        if let Some(parent) = to.parent() {
            std::fs::create_dir_all(parent)?;
        }
        Ok(Recording::read(from)?.write(to)?)
    };
    let mut progress = Progress::new("converted", files.len());
    let mut failed = 0;
    folder::in_order(&files, convert, |_, result| {
        if let Err(error) = result {
            failed += 1;
            progress.say(&format!("error: {error:#}"));
        }
        progress.step();
        Ok::<(), anyhow::Error>(())
    })?;
    progress.finish(&format!(
        "{} scenes in `{}`, {failed} failed",
        files.len() - failed,
        args.folder.out.display()
    ));
    Ok(if failed > 0 { Outcome::Partial } else { Outcome::Done })
}
