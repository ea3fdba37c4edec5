//! Which files are scenarios of Argoverse 2, by their names and first bytes.

use std::path::{Path, PathBuf};

use sage_core::files;

use crate::Error;

/// True if a file is a Parquet file.
pub(crate) fn is_parquet(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PAR1")
}

/// What ends the bytes of a scenario that are followed by those of its map.
const WITH_MAP: &[u8; 16] = b"scenario and map";

/// The bytes of a scenario and then those of its map, so that one hash is of both.
pub(crate) fn with_map(mut scenario: Vec<u8>, map: &[u8]) -> Vec<u8> {
    scenario.reserve_exact(map.len() + 8 + WITH_MAP.len());
    scenario.extend_from_slice(map);
    scenario.extend((map.len() as u64).to_le_bytes());
    scenario.extend_from_slice(WITH_MAP);
    scenario
}

/// The bytes of a scenario, and those of its map if they follow.
#[cfg(feature = "argoverse2")]
pub(crate) fn without_map(mut bytes: Vec<u8>) -> (Vec<u8>, Option<Vec<u8>>) {
    let split = || {
        let body = bytes.strip_suffix(WITH_MAP)?;
        let (body, length) = body.split_last_chunk()?;
        body.len().checked_sub(usize::try_from(u64::from_le_bytes(*length)).ok()?)
    };
    let Some(at) = split() else { return (bytes, None) };
    let mut map = bytes.split_off(at);
    map.truncate(map.len() - 8 - WITH_MAP.len());
    (bytes, Some(map))
}

/// The map beside a scenario: by the id in its name.
pub(crate) fn map_beside(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_str()?;
    let id = stem.strip_prefix("scenario_").unwrap_or(stem);
    let map = path.with_file_name(format!("{MAP}{id}.json"));
    map.is_file().then_some(map)
}

/// How the name of a map begins.
const MAP: &str = "log_map_archive_";

/// True if a file is named like the map of a scenario.
pub(crate) fn is_map_name(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(MAP))
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

/// The map of a scenario of Argoverse 2. Real ones have 0.1 to 1 MB.
pub(crate) fn read_map(path: &Path) -> Result<Vec<u8>, Error> {
    const MOST: u64 = 64 << 20;
    files::read(path, MOST).map_err(|source| match source.kind() {
        std::io::ErrorKind::FileTooLarge => Error::TooLarge { path: path.to_owned(), limit: MOST },
        _ => Error::Read { path: path.to_owned(), source },
    })
}
