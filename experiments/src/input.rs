//! Input files that the user names on the command line.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use sage_core::files;

/// Size limit of a configuration file, bytes.
const CONFIG_LIMIT: u64 = 1 << 20;

/// Reads a configuration file as text.
///
/// *Errors*: the file cannot be read, or exceeds the size limit.
pub(crate) fn read_config(path: &Path) -> Result<String> {
    files::read_argument_text(path, CONFIG_LIMIT).with_context(|| format!("cannot read `{}`", path.display()))
}

/// Path that a scene's outputs are named after: its file, or `stdin` for standard input.
pub(crate) fn scene_name(file: &Path) -> PathBuf {
    if file.to_str() == Some("-") { PathBuf::from("stdin") } else { file.to_owned() }
}
