//! What the user names on the command line: scenes and files of options.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use sage_core::files;

/// Largest file of options that is read, bytes.
const CONFIG_LIMIT: u64 = 1 << 20;

/// Text of a file of options.
///
/// *Errors*: it cannot be read, or is larger than any.
pub(crate) fn read_config(path: &Path) -> Result<String> {
    files::read_argument_text(path, CONFIG_LIMIT).with_context(|| format!("cannot read `{}`", path.display()))
}

/// What a scene's output is named after: its file, and `stdin` for standard input.
pub(crate) fn scene_name(file: &Path) -> PathBuf {
    if file.to_str() == Some("-") { PathBuf::from("stdin") } else { file.to_owned() }
}
