//! Which files of the given ones a splits file and names of scenes select.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use advsage::WithContext as _;
use sage_data::{ReadOptions, folder};

use crate::{Error, Result};

/// Which of the given scenes a run takes.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// File of splits: an object of split names with lists of scene names.
    pub splits: Option<PathBuf>,
    /// Only the scenes of this split.
    pub split: Option<String>,
    /// Not the scenes of this split.
    pub without_split: Option<String>,
    /// Only the scenes with these names.
    pub scenes: Vec<String>,
    /// How they are read.
    pub reading: ReadOptions,
}

/// Files that match the splits file and the names of scenes.
pub(super) fn selected(mut files: Vec<PathBuf>, split: &Filter) -> Result<Vec<PathBuf>> {
    if split.splits.is_none() && split.scenes.is_empty() {
        return Ok(files);
    }
    let names: HashMap<PathBuf, String> = files
        .iter()
        .map(|file| Ok((file.clone(), folder::scene_name(file)?)))
        .collect::<Result<_, sage_data::Error>>()?;
    let is_named = |file: &Path, name: &String| names.get(file) == Some(name);
    let among = |names: &[String], file: &Path| names.iter().any(|name| is_named(file, name));
    if let Some(missing) = split.scenes.iter().find(|name| !files.iter().any(|file| is_named(file, name))) {
        return Err(Error::Refused(format!("no scene `{missing}` among the {} given", files.len())));
    }
    if let Some(file) = &split.splits {
        if split.split.is_none() && split.without_split.is_none() {
            return Err(Error::Refused("--splits needs --split or --without-split".to_owned()));
        }
        let with = names_in(file, split.split.as_deref())?;
        let without = names_in(file, split.without_split.as_deref())?;
        files.retain(|file| {
            with.as_ref().is_none_or(|names| among(names, file))
                && !without.as_ref().is_some_and(|names| among(names, file))
        });
    }
    if !split.scenes.is_empty() {
        files.retain(|file| among(&split.scenes, file));
    }
    match files.is_empty() {
        true => Err(Error::Refused("no scene matches --splits and --scenes".to_owned())),
        false => Ok(files),
    }
}

/// Names of the scenes of a split, if a split is given.
///
/// *Errors*: the file cannot be read or has no such split.
fn names_in(file: &Path, split: Option<&str>) -> Result<Option<Vec<String>>> {
    let Some(split) = split else { return Ok(None) };
    let mut known = sage_data::split::read_splits(file)?;
    let all = known.keys().cloned().collect::<Vec<_>>().join(", ");
    let found = known.remove(split);
    let missing = || format!("`{}` has no split `{split}`; known: {all}", file.display());
    Ok(Some(found.with_context(missing)?))
}
