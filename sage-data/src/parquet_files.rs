//! Which files are scenarios of Argoverse 2, by their names and first bytes.

use std::path::{Path, PathBuf};

/// True if a file is a Parquet file.
pub(crate) fn is_parquet(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PAR1")
}

/// True if a file is named like a scenario.
pub(crate) fn is_scenario_name(name: &str) -> bool {
    name.starts_with("scenario_") && name.ends_with(".parquet")
}

/// Path of a scenario for names of outputs: `<id>` for `<id>/scenario_<id>.parquet`.
pub(crate) fn plain_path(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let id = name.strip_suffix(".parquet").filter(|_| is_scenario_name(name))?.strip_prefix("scenario_")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    match folder.file_name().is_some_and(|folder| folder == id) {
        true => Some(folder.to_owned()),
        false => Some(folder.join(id)),
    }
}
